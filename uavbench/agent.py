"""What an agent is, and loading one from a file or by a built-in's name.

The contract is docs/agents.md; a built-in baseline is loaded by the same code as a user's file.
"""

import hashlib
import importlib.util
import inspect
import sys
import traceback
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from uavbench import resources
from uavbench.errors import UavbenchError, one_line
from uavbench.files import MODEL_BYTES, SOURCE_BYTES, FileError, check_plain, read_bounded
from uavbench.scenario import Scenario
from uavbench.weights import WeightsError, check_trained, load_weights, trained_on

Track = Literal["observation", "state"]
TRACKS: tuple[Track, ...] = ("observation", "state")
Call = Literal["act", "act_batch", "act_team"]
CALLS: tuple[Call, ...] = ("act", "act_batch", "act_team")


class AgentLoadError(UavbenchError, ValueError):
    """An agent that cannot be loaded, or does not keep the contract; the message says what to change."""


#: Where an agent is flown if nothing is said.
FIRST_SCENARIO = "Manhattan32-CPP-v0"
_ONNX = Path(__file__).with_name("onnx_agent.py")


@dataclass(frozen=True)
class AgentSource:
    """Where an agent comes from.

    Attributes
    ----------
    path : Path
        The Python file.
    class_name : str
        The class in it.
    weights : Path, optional
        What the class is given besides the scenario: a file that ``uavbench train`` wrote, or an ONNX model.
    """

    path: Path
    class_name: str = "Agent"
    weights: Path | None = None

    @property
    def name(self) -> str:
        """The file's stem, and the class when it is not ``Agent``: what results are filed under. With weights their stem."""
        if self.weights:
            return self.weights.stem
        return self.path.stem if self.class_name == "Agent" else f"{self.path.stem}.{self.class_name}"

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the Python file."""
        return hashlib.sha256(read_bounded(self.path, SOURCE_BYTES)).hexdigest()

    @property
    def built_in(self) -> bool:
        """Whether it comes with the suite."""
        return resources.baseline_paths().get(self.path.stem) == self.path

    def digest(self, scenario: Scenario) -> str:
        """Return the SHA-256 of what acts on ``scenario``.

        That of the Python file, of the ONNX model, or, where there are weights, that of the digests of file and weights, in
        hex, one after the other.
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
        """The id of the scenario that the weights were trained on; where that is not known, the suite's first."""
        if self.weights is None:
            return FIRST_SCENARIO
        found = self.load().trained_on(self.weights) if self.path == _ONNX else trained_on(self.weights)
        return found or FIRST_SCENARIO

    @property
    def track(self) -> Track:
        """What the agent may see."""
        return getattr(self.load(), "track", "observation")

    @property
    def calls(self) -> tuple[Call, ...]:
        """By which methods the agent decides."""
        return tuple(name for name in CALLS if callable(getattr(self.load(), name, None)))

    def call(self, scenario: Scenario) -> Call:
        """Return the method that decides on ``scenario``: for a team ``act_team``, for many at once, or one by one."""
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
            return _module(self.path.resolve(), self.sha256)
        except ModuleNotFoundError as error:
            hint = ": pip install 'uavbench[ddqn]'" if error.name in ("torch", "safetensors") else ""
            raise AgentLoadError(f"{self.path}: needs {error.name}, which is not installed{hint}") from error
        except (Exception, SystemExit) as error:
            raise AgentLoadError(f"{self.path}: importing it raised {type(error).__name__}: {one_line(error)}") from error

    def load(self) -> Any:
        """Return the agent's class.

        Raises
        ------
        AgentLoadError
            When the file has no such class, or the class does not keep the contract.
        """
        found = getattr(self.module(), self.class_name, None)
        if not inspect.isclass(found):
            raise AgentLoadError(f"{self.path}: has no class {self.class_name}; name yours as {self.path}:YourClass")
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
        self._check_signature(found)
        if callable(getattr(found, "act_team", None)) and track != "state":
            raise AgentLoadError(
                f"{self.path}: {self.class_name}.act_team decides by all that the team sees: set track = 'state', or "
                "decide with act, which is asked UAV by UAV"
            )
        return found

    def _check_signature(self, found: Any) -> None:
        """Refuse a class that cannot be made of a scenario and, where there are, weights."""
        given: tuple[Any, ...] = (None, None) if self.weights else (None,)
        try:
            signature = inspect.signature(found)
        except (TypeError, ValueError):  # of a class that is not written in Python
            return
        try:
            signature.bind(*given)
        except TypeError:
            wanted = "(scenario, weights)" if self.weights else "(scenario)"
            hint = f"{self.class_name}{signature} is not made of {wanted}"
            if self.weights:
                hint += f": {self.path.stem if self.built_in else self.path.name} takes no weights"
            elif len(signature.parameters) > 1:
                hint += ": weights are given by --weights FILE"
            raise AgentLoadError(f"{self.path}: {hint}; write __init__(self, {wanted[1:]}") from None

    def make(self, scenario: Scenario) -> Any:
        """Return a new agent for ``scenario``; what its ``__init__`` raises passes through.

        Raises
        ------
        WeightsError
            When the weights are damaged, or were trained on another map or mission.
        """
        if self.weights is None:
            return self.load()(scenario)
        if self.weights.suffix == ".safetensors":
            check_trained(self.weights, trained_on(self.weights), scenario)
        return self.load()(scenario, self.weights)

    def meant(self, error: Exception) -> bool:
        """Say whether the agent itself raised an error, to say what it needs: the user has no use for a traceback then."""
        if isinstance(error, WeightsError):
            return True
        frames = traceback.extract_tb(error.__traceback__)
        own = bool(frames) and Path(frames[-1].filename).resolve() == self.path.resolve()
        return isinstance(error, ValueError | ImportError) and own and (frames[-1].line or "").startswith("raise ")

    def declines(self, scenario: Scenario) -> str | None:
        """Return why the agent does not fly ``scenario``, by its own word; None where it does, or fails to be made."""
        try:
            self.make(scenario)
        except ValueError as error:
            return one_line(error) if self.meant(error) else None
        except Exception:  # which flying it will tell
            return None
        return None


_MODULES: dict[tuple[Path, str], ModuleType] = {}


def _module(path: Path, sha256: str) -> ModuleType:
    """Import a file as a module of its own; its folder is searched for what it imports, as if it were run."""
    if (path, sha256) not in _MODULES:
        spec = importlib.util.spec_from_file_location(f"uavbench_agent_{path.stem}_{sha256[:8]}", path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        if str(path.parent) not in sys.path:
            sys.path.append(str(path.parent))
        sys.modules[spec.name] = module  # dataclasses and pickles look their module up by name
        spec.loader.exec_module(module)
        _MODULES[path, sha256] = module
    return _MODULES[path, sha256]


def find_agent(spec: str, weights: Path | None = None) -> AgentSource:
    """Find an agent: a built-in's name, ``path.py``, ``path.py:Class``, ``path.onnx``, or a built-in's ``path.safetensors``.

    Parameters
    ----------
    spec : str
        What it is.
    weights : Path, optional
        What a file or a built-in is to fly with.

    Raises
    ------
    AgentLoadError
        When there is none.
    """
    if weights is not None:
        source, weights = find_agent(spec), weights.expanduser()
        if source.weights is not None:
            raise AgentLoadError(f"agent {spec}: these are weights themselves: leave --weights out")
        _check("--weights", weights, MODEL_BYTES)
        return replace(source, weights=weights)
    built_in = resources.baseline_paths()
    if spec in built_in:
        return AgentSource(built_in[spec])
    if spec.endswith(".safetensors"):
        return _trained(Path(spec).expanduser(), built_in)
    if spec.endswith(".onnx"):
        model = Path(spec).expanduser()
        _check("agent", model, MODEL_BYTES)
        return AgentSource(_ONNX, weights=model)
    name, _, class_name = spec.partition(".py:")
    if class_name:
        name += ".py"
    path = Path(name).expanduser()
    if not name.endswith(".py"):
        raise AgentLoadError(
            f"agent {spec}: neither a .py, .onnx or .safetensors file nor a built-in; built in are {', '.join(built_in)}"
        )
    _check("agent", path, SOURCE_BYTES)
    return AgentSource(path, class_name or "Agent")


def _check(what: str, path: Path, most: int) -> None:
    """Refuse what is not a plain file that can be read, by an `AgentLoadError`."""
    try:
        check_plain(path, most)
    except FileError as error:
        raise AgentLoadError(f"{what} {error}") from None


def _trained(weights: Path, built_in: dict[str, Path]) -> AgentSource:
    """Return the built-in agent that weights are of."""
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
        When it is there already, does not end in ``.py``, or cannot be written.
    """
    if path.suffix != ".py":
        raise AgentLoadError(f"{path}: agents are files that end in .py")
    template = Path(__file__).with_name("templates") / "agent.py"
    try:
        with path.open("x", encoding="utf-8") as file:
            try:
                file.write(template.read_text(encoding="utf-8").replace("FILE", path.name))
                file.flush()
            except OSError:
                path.unlink()  # rather than an empty file, which the next try would take for an agent
                raise
    except FileExistsError:
        raise AgentLoadError(f"{path}: exists already; choose another name") from None
    except OSError as error:
        raise AgentLoadError(f"{path}: cannot write it: {error.strerror}") from None
