"""What an agent is, and how one is loaded from a file or by the name of a built-in.

docs/agents.md describes the contract. A built-in baseline is loaded by the same code as a user's file.
"""

import hashlib
import inspect
import os
import re
import traceback
from dataclasses import dataclass, fields, replace
from functools import cached_property
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from uavbench.agents.agent_files import files_digest, import_agent
from uavbench.agents.weights import WeightsError, check_trained, is_transfer, load_weights, training_record
from uavbench.errors import UavbenchError, one_line
from uavbench.world import resources
from uavbench.world.files import MODEL_BYTES, SOURCE_BYTES, FileError, check_folder, check_name, check_plain, read_bounded
from uavbench.world.registry import SHIPPED
from uavbench.world.scenario import Scenario

Track = Literal["observation", "state"]
TRACKS: tuple[Track, ...] = ("observation", "state")
Call = Literal["act", "act_batch", "act_team"]
CALLS: tuple[Call, ...] = ("act", "act_batch", "act_team")


class AgentLoadError(UavbenchError, ValueError):
    """An agent cannot be loaded, or does not keep the contract; the message says what to change."""


#: Built-ins that fly any mission. This is said here and not in their files, because it would change their digests.
_ANY_MISSION = ("ddqn", "random")
#: Earlier names of built-ins.
_FORMER = {"pilot": "belief_planner"}
#: The scenario on which an agent is flown by default.
FIRST_SCENARIO = "Manhattan32-CPP-v0"
_ONNX = Path(__file__).with_name("onnx_agent.py")


@dataclass(frozen=True)
class AgentSource:
    """Where an agent comes from.

    Attributes
    ----------
    path : Path
        The Python file; absolute.
    class_name : str
        The class in it.
    weights : Path, optional
        The file that the class is given besides the scenario: one that ``uavbench train`` wrote, or an ONNX model; absolute.
    module_name : str, optional
        The name ``package.module`` under which the file is imported; by default it is a module without a package.
    given_name : str, optional
        The name of the agent in results, if it is not to be that of a file.
    transfer : bool
        Allow weights on another map than they were trained on.
    """

    path: Path
    class_name: str = "Agent"
    weights: Path | None = None
    module_name: str | None = None
    given_name: str | None = None
    transfer: bool = False

    def __reduce__(self) -> tuple[Any, ...]:
        """Leave out cached values when this is pickled for another process, which loads the agent's file itself."""
        return type(self), tuple(getattr(self, field.name) for field in fields(self))

    @property
    def name(self) -> str:
        """The name in results: by default the stem of the weights, or of the file, with the class when it is not ``Agent``."""
        if self.given_name is not None:
            return self.given_name
        if self.weights:
            return self.weights.stem
        return self.path.stem if self.class_name == "Agent" else f"{self.path.stem}.{self.class_name}"

    @property
    def file(self) -> Path | None:
        """The file of the agent's weights or, without weights, its Python file; None for a built-in without weights."""
        return self.weights or (None if self.built_in else self.path)

    @property
    def sha256(self) -> str:
        """SHA-256 of the Python file and its own imported modules: see `uavbench.agents.agent_files.files_digest`."""
        return files_digest(self.path)

    @property
    def built_in(self) -> bool:
        """Whether the agent comes with the suite."""
        found = resources.baseline_paths().get(self.path.stem)
        return found is not None and found.resolve() == self.path.resolve()

    def digest(self, scenario: Scenario) -> str:
        """Return the SHA-256 of all files that decide on ``scenario``, as they are now.

        This is the digest of the Python files (`sha256`) or of the ONNX model; with weights, that of the hexadecimal digests
        of the Python files and of the weights, one after the other.
        """
        weights = self.weights
        if weights is None and self.built_in:
            weights = resources.shipped_weights(self.path.stem).get(scenario.id)
        if weights is None:
            return self.sha256
        found = hashlib.sha256(read_bounded(weights, MODEL_BYTES)).hexdigest()
        return found if self.path == _ONNX else hashlib.sha256((self.sha256 + found).encode()).hexdigest()

    @cached_property
    def trained_on(self) -> str:
        """The scenario that the weights were trained on, as an id or a user's file; if it is not known, the suite's first.

        Raises
        ------
        AgentLoadError
            When it is a user's own scenario and its file is no longer there.
        """
        record = {} if self.weights is None else training_record(self.weights)
        name = str(record.get("scenario", FIRST_SCENARIO))
        if name in resources.scenario_paths():
            return name
        file = Path(str(record.get("scenario_file", "")))
        if file.suffix == ".toml" and file.is_file():
            return str(file)
        raise AgentLoadError(f"{self.weights}: trained on {name}, a scenario of your own: name its file with --scenario FILE")

    def transferred(self, scenario: Scenario) -> bool:
        """Return whether weights are used on another map than they were trained on."""
        return self.transfer and self.weights is not None and is_transfer(training_record(self.weights), scenario)

    @property
    def track(self) -> Track:
        """What the agent may see."""
        return getattr(self.load(), "track", "observation")

    @property
    def safe_mask(self) -> bool:
        """Whether the agent is told which actions are safe."""
        return getattr(self.load(), "safe_mask", False)

    @property
    def calls(self) -> tuple[Call, ...]:
        """The methods by which the agent decides."""
        return tuple(name for name in CALLS if callable(getattr(self.load(), name, None)))

    def call(self, scenario: Scenario) -> Call:
        """Return the method that decides on ``scenario``: the first that the agent has of those for this number of UAVs."""
        team_first = ("act_team", "act_batch", "act") if scenario.team else ("act_batch", "act", "act_team")
        return next(name for name in team_first if name in self.calls)

    def module(self) -> ModuleType:
        """Return the file as a module.

        Raises
        ------
        AgentLoadError
            When it cannot be imported.
        """
        try:
            key = (self.path, self.module_name, self.sha256)
            if key not in _MODULES:
                _MODULES[key] = import_agent(self.path, self.module_name)
            return _MODULES[key]
        except ModuleNotFoundError as error:
            hint = ": pip install 'uavbench[ddqn]'" if error.name in ("torch", "safetensors") else ""
            raise AgentLoadError(f"{self.path}: needs {error.name}, which is not installed{hint}") from error
        except (Exception, SystemExit) as error:
            raise AgentLoadError(f"{self.path}: importing it raised {type(error).__name__}: {one_line(error)}") from error

    def load(self) -> Any:
        """Return the agent's class; it is loaded and checked only once.

        Raises
        ------
        AgentLoadError
            When the file has no such class, or the class does not keep the contract.
        """
        return self._class

    @cached_property
    def _class(self) -> Any:
        """The agent's class, as `load` returns it."""
        found = getattr(self.module(), self.class_name, None)
        if not inspect.isclass(found):
            raise AgentLoadError(f"{self.path}: has no class {self.class_name}; name yours as {self.path}:YourClass")
        self._check_contract(found)
        self._check_signature(found)
        return found

    def _check_contract(self, found: Any) -> None:
        """Refuse what has no method that decides, or another track than there are."""
        if not any(callable(getattr(found, name, None)) for name in CALLS):
            raise AgentLoadError(
                f"{self.path}: {self.class_name} has neither act(self, observation, info) nor "
                "act_batch(self, observations, infos) nor act_team(self, observations, infos)"
            )
        track = getattr(found, "track", "observation")
        if track not in TRACKS:
            raise AgentLoadError(
                f"{self.path}: {self.class_name}.track is {one_line(track, repr)}; use 'observation' or 'state'"
            )
        safe_mask = getattr(found, "safe_mask", False)
        if not isinstance(safe_mask, bool):
            raise AgentLoadError(f"{self.path}: {self.class_name}.safe_mask is {one_line(safe_mask, repr)}; use True or False")
        if callable(getattr(found, "act_team", None)) and track != "state":
            raise AgentLoadError(
                f"{self.path}: {self.class_name}.act_team decides by all that the team sees: set track = 'state', or "
                "decide with act, which is called for each UAV"
            )

    def _check_signature(self, found: Any) -> None:
        """Raise an AgentLoadError if the class cannot be called with a scenario and, if there are any, weights."""
        given: tuple[Any, ...] = (None, None) if self.weights else (None,)
        try:
            signature = inspect.signature(found)
        except (TypeError, ValueError):  # the class is not written in Python
            return
        try:
            signature.bind(*given)
        except TypeError:
            wanted = "(scenario, weights)" if self.weights else "(scenario)"
            hint = f"{self.class_name}{signature} cannot be called with {wanted}"
            if self.weights:
                hint += f": {self.path.stem if self.built_in else self.path.name} takes no weights"
            elif len(signature.parameters) > 1:
                hint += ": weights are given by --weights FILE"
            raise AgentLoadError(f"{self.path}: {hint}; write __init__(self, {wanted[1:]}") from None

    def make(self, scenario: Scenario) -> Any:
        """Return a new agent for ``scenario``; exceptions of its ``__init__`` are passed on.

        Raises
        ------
        WeightsError
            When the weights are damaged, or were trained for another mission, other observations, or, without
            ``transfer``, another map.
        AgentLoadError
            When it is a built-in for the shipped missions only, and the scenario has another mission.
        """
        if self.built_in and self.path.stem not in _ANY_MISSION and scenario.mission.kind not in SHIPPED:
            known = " and ".join(SHIPPED)
            raise AgentLoadError(f"{self.path.stem} flies {known}, not {scenario.mission.kind} ({scenario.id})")
        if self.weights is None:
            return self.load()(scenario)
        check_trained(self.weights, training_record(self.weights), scenario, self.transfer)
        return self.load()(scenario, self.weights)

    def meant(self, error: Exception) -> bool:
        """Return whether the agent raised an error on purpose to say what it needs; then the user needs no traceback."""
        if isinstance(error, UavbenchError):
            return True
        frames = traceback.extract_tb(error.__traceback__)
        own = bool(frames) and Path(frames[-1].filename).resolve() == self.path.resolve()
        return isinstance(error, ValueError | ImportError) and own and (frames[-1].line or "").startswith("raise ")


_MODULES: dict[tuple[Path, str | None, str], ModuleType] = {}


def find_agent(spec: str, weights: Path | None = None, name: str | None = None) -> AgentSource:
    """Find an agent.

    Parameters
    ----------
    spec : str
        A built-in's name, ``path.py``, ``path.py:Class``, ``package.module:Class``, ``path.onnx``, or a built-in's
        ``path.safetensors``.
    weights : Path, optional
        Weights for the agent of a file or for a built-in.
    name : str, optional
        The name of the agent in results, if it is not to be that of the file.

    Raises
    ------
    AgentLoadError
        When there is no such agent, or its name cannot be used in results.

    Examples
    --------
    >>> import uavbench
    >>> uavbench.find_agent("greedy").track
    'state'
    """
    source = _find(spec)
    if weights is not None:
        if source.weights is not None:
            raise AgentLoadError(f"agent {spec}: it is a file of weights itself: leave --weights out")
        source = replace(source, weights=_there("--weights", weights, MODEL_BYTES))
    source = replace(source, given_name=name)
    try:
        check_name(source.name)
    except ValueError as error:
        what = "--name" if name is not None else f"agent {one_line(spec)}"
        raise AgentLoadError(f"{what}: {error}: results are filed under it: give another name with --name NAME") from None
    return source


def _find(spec: str) -> AgentSource:
    """Find an agent by the user's ``--agent``."""
    built_in = resources.baseline_paths()
    spec = _FORMER.get(spec, spec)
    if spec in built_in:
        return AgentSource(built_in[spec])
    if spec.endswith(".safetensors"):
        return _trained(_there("agent", Path(spec), MODEL_BYTES), built_in)
    if spec.endswith(".onnx"):
        return AgentSource(_ONNX, weights=_there("agent", Path(spec), MODEL_BYTES))
    name, _, class_name = spec.partition(".py:")
    if class_name:
        name += ".py"
    if not name.endswith(".py") and re.fullmatch(r"\w+(\.\w+)*:\w+", spec):
        return _in_module(*spec.split(":"))
    if not name.endswith(".py"):
        raise AgentLoadError(
            f"agent {spec}: neither a .py, .onnx or .safetensors file, nor package.module:Class, nor a built-in; built in are "
            f"{', '.join(built_in)}"
        )
    return AgentSource(_there("agent", Path(name), SOURCE_BYTES), class_name or "Agent")


def _there(what: str, path: Path, most: int) -> Path:
    """Return a file's absolute path, as an agent may change the current folder; raise AgentLoadError if it cannot be read."""
    try:
        path = path.expanduser()
    except RuntimeError:  # an unknown user after "~"
        raise AgentLoadError(f"{what} {one_line(path)}: there is no such file") from None
    _check(what, path, most)
    return Path(os.path.abspath(path))  # noqa: PTH100  # resolve() would follow links


def _in_module(module: str, class_name: str) -> AgentSource:
    """Find the file of a module, from the current folder or installed, without executing it."""
    folders: list[str] | None = None
    spec = None
    for k, _ in enumerate(parts := module.split(".")):
        spec = PathFinder.find_spec(".".join(parts[: k + 1]), folders or [str(Path.cwd())]) or (
            PathFinder.find_spec(parts[0]) if k == 0 else None
        )
        folders = list(spec.submodule_search_locations or ()) if spec else []
        if spec is None or (k + 1 < len(parts) and not folders):
            raise AgentLoadError(f"agent {module}:{class_name}: there is no module {'.'.join(parts[: k + 1])}")
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        raise AgentLoadError(f"agent {module}:{class_name}: {module} is no Python file")
    return AgentSource(Path(spec.origin), class_name, module_name=module)


def _check(what: str, path: Path, most: int) -> None:
    """Raise an AgentLoadError unless ``path`` is a readable plain file of at most ``most`` bytes."""
    try:
        check_plain(path, most)
    except FileError as error:
        raise AgentLoadError(f"{what} {error}") from None


def _trained(weights: Path, built_in: dict[str, Path]) -> AgentSource:
    """Return the built-in agent that a file of weights belongs to."""
    try:
        record = load_weights(weights)[1]
    except WeightsError as error:
        raise AgentLoadError(f"agent {error}") from None
    except ImportError:
        raise AgentLoadError(f"agent {weights}: needs safetensors: pip install 'uavbench[ddqn]'") from None
    agent = record.get("agent")
    if record.get("built_in") is False:
        raise AgentLoadError(f"agent {weights}: weights of your own {agent}: --agent {agent}.py --weights {weights}")
    if agent not in built_in:
        raise AgentLoadError(f"agent {weights}: weights of {agent}, which is not built in")
    return AgentSource(built_in[agent], weights=weights)


def write_template(path: Path) -> None:
    """Write a template of an agent to ``path``.

    Raises
    ------
    AgentLoadError
        When ``path`` exists already, does not end in ``.py``, or cannot be written.
    """
    if path.suffix != ".py":
        raise AgentLoadError(f"{path}: agents are files that end in .py")
    template = Path(__file__).with_name("templates") / "agent.py"
    try:
        check_folder(path.parent)
        with path.open("x", encoding="utf-8") as file:
            try:
                file.write(template.read_text(encoding="utf-8").replace("FILE", path.name))
                file.flush()
            except OSError:
                path.unlink()  # an incomplete file would be in the way of the next try
                raise
    except FileExistsError:
        raise AgentLoadError(f"{path}: exists already; choose another name") from None
    except OSError as error:
        raise AgentLoadError(f"{path}: cannot write it: {error.strerror}") from None
