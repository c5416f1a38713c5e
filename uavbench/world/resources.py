"""Paths of the shipped scenarios, baselines and weights, in a wheel and in a checkout."""

import tomllib
from functools import lru_cache
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def _folder(name: str) -> Path:
    """Return the folder ``name``: inside the installed package, or beside it in a checkout."""
    for root in (_PACKAGE, _PACKAGE.parent):
        if (root / name).is_dir():
            return root / name
    raise FileNotFoundError(f"{name}/ is neither in {_PACKAGE} nor beside it: the installation is incomplete")


def scenario_paths() -> dict[str, Path]:
    """Return the file of every shipped scenario, by id, in alphabetical order."""
    return {path.stem: path for path in sorted(_folder("scenarios").glob("*.toml"))}


def baselines_folder() -> Path:
    """Return the folder of the shipped baseline agents."""
    return _folder("baselines")


def baseline_paths() -> dict[str, Path]:
    """Return the file of every shipped baseline agent, by name, in alphabetical order."""
    return {path.stem: path for path in sorted(_folder("baselines").glob("*.py"))}


@lru_cache
def earlier_digests() -> dict[str, dict[str, list[str]]]:
    """Return the digests of earlier versions of the built-in agents: by ``same_actions`` or ``other_actions``, and by agent."""
    return tomllib.loads((_folder("baselines") / "earlier.toml").read_text(encoding="utf-8"))


def shipped_weights(agent: str) -> dict[str, Path]:
    """Return the shipped files of weights of a built-in agent, by scenario id."""
    found = sorted((_folder("baselines") / "weights").glob(f"{agent}-*.safetensors"))
    return {path.stem.removeprefix(f"{agent}-"): path for path in found}
