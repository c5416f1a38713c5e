"""Everything that an evaluation needs on another machine, in one object that can be sent there.

An agent's Python files, its weights and a user's own scenario travel with it; built-in agents and shipped scenarios are those
of the other machine. On arrival, all digests must be the same.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import tomli_w

from uavbench.agents.agent import AgentSource
from uavbench.agents.agent_files import agent_files
from uavbench.errors import UavbenchError
from uavbench.evaluation.evaluate import Job
from uavbench.world.files import ARRAYS_BYTES, MODEL_BYTES, SOURCE_BYTES, read_bounded, read_toml
from uavbench.world.resources import baseline_paths, scenario_paths
from uavbench.world.scenario import Scenario, load_scenario

_SCENARIO = "scenario.toml"


_NONE: Any = None  # in place of the scenario
_FOLDERS: list[tempfile.TemporaryDirectory[str]] = []  # of what has been unpacked


class ParcelError(UavbenchError):
    """An evaluation cannot be sent to another machine, or has not arrived there as it was sent."""


@dataclass(frozen=True)
class ScenarioParcel:
    """A scenario as it is sent; `pack_scenario` makes it.

    Attributes
    ----------
    name, digest : str
        Its id, and the digest that it must have on arrival.
    files : tuple of (str, bytes)
        The names and the contents of its files; empty if it comes with uavbench.
    """

    name: str
    digest: str
    files: tuple[tuple[str, bytes], ...]


@dataclass(frozen=True)
class Parcel:
    """An evaluation as it is sent; `pack` makes it.

    Attributes
    ----------
    job : Job
        What is flown, with the places of files on the machine that sends it.
    facts : tuple of (str, str)
        What must be the same on arrival, with its value.
    agent, weights : tuple of (str, bytes)
        The names and the contents of files: the agent's own, of which the first is imported, and its weights. Empty for what
        the other machine has.
    scenario : ScenarioParcel
    """

    job: Job
    facts: tuple[tuple[str, str], ...]
    agent: tuple[tuple[str, bytes], ...]
    weights: tuple[tuple[str, bytes], ...]
    scenario: ScenarioParcel

    def __hash__(self) -> int:
        return hash((self.facts, self.agent, self.weights, self.scenario))


def pack_scenario(scenario: Scenario) -> ScenarioParcel:
    """Return a scenario as it is sent.

    Raises
    ------
    ParcelError
        When it is in no file.
    """
    shipped = scenario_paths().get(scenario.id) == scenario.path
    return ScenarioParcel(scenario.id, scenario.digest, () if shipped else _scenario_files(scenario))


@lru_cache(maxsize=4)
def unpack_scenario(parcel: ScenarioParcel) -> Scenario:
    """Return the scenario of a parcel, whose files are written to a folder that is there until this process ends.

    Raises
    ------
    ParcelError
        When it is not what was sent.
    """
    scenario = load_scenario(_written(parcel.files) / _SCENARIO if parcel.files else parcel.name)
    if scenario.digest != parcel.digest:
        raise ParcelError(_other(parcel.name, "scenario_digest", scenario.digest, parcel.digest))
    return scenario


def pack(job: Job) -> Parcel:
    """Return an evaluation as it is sent.

    Raises
    ------
    ParcelError
        When the agent is imported under the name of a module, or the scenario is in no file.
    """
    source, scenario = job.source, job.scenario
    if source.module_name is not None:
        raise ParcelError(
            f"{source.module_name}: a module cannot be sent to other machines: name the agent's file, {source.path}"
        )
    weights = ((source.weights.name, read_bounded(source.weights, MODEL_BYTES)),) if source.weights else ()
    return Parcel(
        # The scenario is left out: the class of a mission of one's own is not known on the other machine.
        replace(job, scenario=_NONE),
        tuple(_facts(job).items()),
        () if _is_shipped(source) else _own_files(source.path),
        weights,
        pack_scenario(scenario),
    )


@lru_cache(maxsize=4)
def unpack(parcel: Parcel) -> Job:
    """Return the evaluation of a parcel, whose files are written to a folder that is there until this process ends.

    Raises
    ------
    ParcelError
        When it is not what was sent.
    """
    known = dict(parcel.facts)
    path = _written(parcel.agent) / parcel.agent[0][0] if parcel.agent else _shipped(known["agent_file"])
    weights = _written(parcel.weights) / parcel.weights[0][0] if parcel.weights else None
    source = replace(parcel.job.source, path=path, weights=weights, given_name=known["agent"])
    job = replace(parcel.job, source=source, scenario=unpack_scenario(parcel.scenario))
    for name, value in _facts(job).items():
        if known[name] != value:
            raise ParcelError(_other(f"{known['agent']} on {parcel.scenario.name}", name, value, known[name]))
    return replace(job, agent_sha256=known["agent_sha256"])


def _written(files: tuple[tuple[str, bytes], ...]) -> Path:
    """Return a folder with these files."""
    folder = tempfile.TemporaryDirectory(prefix="uavbench-")
    _FOLDERS.append(folder)
    for name, content in files:
        path = Path(folder.name) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return Path(folder.name)


def _other(what: str, name: str, here: str, there: str) -> str:
    """Say that something is not the same on arrival."""
    return (
        f"{what}: its {name} is {here} on the machine where it arrived, and {there} where it was sent from: install the same "
        "version of uavbench on all machines"
    )


def _facts(job: Job) -> dict[str, str]:
    """Return what must be the same on all machines."""
    return {
        "uavbench": metadata.version("uavbench"),
        "agent": job.source.name,
        "agent_file": job.source.path.name,
        "agent_sha256": job.source.digest(job.scenario),
    }


def _is_shipped(source: AgentSource) -> bool:
    """Return whether an agent's Python file comes with uavbench."""
    return source.built_in or source.path == _onnx()


def _onnx() -> Path:
    """Return the file of the agent that flies ONNX models."""
    return Path(__file__).parents[1] / "agents" / "onnx_agent.py"


def _shipped(name: str) -> Path:
    """Return an agent's file that comes with uavbench."""
    return baseline_paths().get(Path(name).stem, _onnx())


def _own_files(path: Path) -> tuple[tuple[str, bytes], ...]:
    """Return an agent's own files, the one that is imported first."""
    folder = path.resolve().parent
    own = [each for each in agent_files(path) if each.is_relative_to(folder)]
    own.sort(key=lambda each: each != path.resolve())
    return tuple((str(each.relative_to(folder)), read_bounded(each, SOURCE_BYTES)) for each in own)


def _scenario_files(scenario: Scenario) -> tuple[tuple[str, bytes], ...]:
    """Return a scenario's file, in which all other files lie beside it under new names, and those files."""
    if not scenario.path.suffix:
        raise ParcelError(f"{scenario.id}: it is in no file: write it as a .toml file")
    values, folder = read_toml(scenario.path), scenario.path.parent
    files: list[tuple[str, bytes]] = []

    def carried(name: Any) -> str:
        path = folder / str(name)
        files.append((f"{len(files)}{path.suffix}", read_bounded(path, ARRAYS_BYTES)))
        return files[-1][0]

    tables: list[Mapping[str, Any]] = [values.get("mission", {}), values.get("cities", {}).get("frozen", {})]
    for table in (values, *tables, *values.get("splits", {}).values()):
        for key in ("map", "file"):
            if key in table:
                table[key] = carried(table[key])  # pyright: ignore[reportIndexIssue]
    maps = values.get("cities", {}).get("files", {})
    for split, names in maps.items():
        maps[split] = [carried(name) for name in names]
    return ((_SCENARIO, tomli_w.dumps(values).encode()), *files)
