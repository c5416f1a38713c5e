"""What a training is: its agent, scenario, configuration and seed, its learner at the beginning, and the points of its curve.

An agent that can be trained has in its file, besides ``Agent``, a dictionary ``CONFIGS`` of dataclasses and a class ``Learner``
(see docs/agents.md).
"""

import hashlib
import platform
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any, cast

from uavbench.agents.agent import AgentSource
from uavbench.agents.weights import WeightsError, training_facts
from uavbench.errors import UavbenchError
from uavbench.world.files import MODEL_BYTES, FileError, read_bounded, read_toml
from uavbench.world.scenario import Scenario

#: The attributes that a configuration and a learner must have.
_FIELDS = ("updates", "validation")
_LEARNER = ("updates", "samples", "advance", "weights", "snapshot", "resume")


class TrainError(UavbenchError, ValueError):
    """A training cannot begin or be resumed; the message says what to change."""


@dataclass(frozen=True)
class Training:
    """What is trained, and how.

    Attributes
    ----------
    source : AgentSource
        The agent's file.
    scenario : Scenario
    name : str
        The configuration's name, or the stem of its file.
    config : dataclass
        The settings of the training.
    seed : int
    start : Path, optional
        Weights to start from.
    processes : int
        How many processes share the training. Another number gives other weights.
    """

    source: AgentSource
    scenario: Scenario
    name: str
    config: Any
    seed: int
    start: Path | None = None
    processes: int = 1

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what another process makes it from; the configuration's class is in the agent's file."""
        kind, values = type(self.config).__name__, asdict(self.config)
        return _again, (self.source, self.scenario, self.name, kind, values, self.seed, self.start, self.processes)

    @property
    def label(self) -> str:
        """The stem of the names of the training's files."""
        return f"{self.source.name}-{self.name}-{self.seed}"

    def files(self, out: Path) -> tuple[Path, Path]:
        """Return the paths of the weights that are kept and of the checkpoint; ``out`` is the folder of all trainings."""
        folder = out / self.scenario.id
        return folder / f"{self.label}.safetensors", folder / f"{self.label}.checkpoint"

    @property
    def identity(self) -> dict[str, Any]:
        """The facts that identify a training: a checkpoint with other ones is of another training."""
        return {
            "agent": self.source.name,
            "scenario": self.scenario.id,
            "scenario_digest": self.scenario.digest,
            "config_name": self.name,
            "config": asdict(self.config),
            "seed": self.seed,
            "start_sha256": self._start_sha256,
            "processes": self.processes,
        }

    @cached_property
    def _start_sha256(self) -> str | None:
        """The digest of the weights to start from, as they were when the training began."""
        try:
            return None if self.start is None else hashlib.sha256(read_bounded(self.start, MODEL_BYTES)).hexdigest()
        except FileError as error:
            raise WeightsError(str(error)) from None

    def record(self, curve: list["Point"], seconds: float | None = None) -> dict[str, Any]:
        """Return the record that is saved with arrays and says how they were made."""
        versions = {name: metadata.version(name) for name in ("uavbench", "numpy", "numba", "torch")}
        spent = seconds if seconds is not None else curve[-1].seconds if curve else 0.0
        curve_values = [asdict(point) for point in curve]
        return {
            **self.identity,
            **training_facts(self.scenario),
            "built_in": self.source.built_in,
            "agent_sha256": self.source.sha256,  # not in identity: it may change before a resume
            "curve": curve_values,
            "seconds": spent,
            "versions": {"python": platform.python_version(), **versions},
        }


def _again(source: AgentSource, scenario: Scenario, name: str, kind: str, values: dict[str, Any], *rest: Any) -> Training:
    """Return a `Training` in another process."""
    return Training(source, scenario, name, getattr(source.module(), kind)(**values), *rest)


@dataclass(frozen=True)
class Point:
    """One point of the training's curve: scores on validation episodes, in [0, 1].

    Attributes
    ----------
    updates, samples : int
        Number of updates and of samples so far.
    seconds : float
        Time spent so far, including validation.
    landed, cr, cral : float
        Means over the first validation episodes: 200, or ``validation_episodes`` of the configuration, or all if there are
        fewer.
    """

    updates: int
    samples: int
    seconds: float
    landed: float
    cr: float
    cral: float


def read_config(source: AgentSource, config: str) -> tuple[str, Any]:
    """Return the name and the values of a configuration: one of the agent's ``CONFIGS``, or a TOML file.

    A file changes fields of one of ``CONFIGS``, which it may name: ``base = "fast"``, the default.

    Raises
    ------
    TrainError
        When the agent cannot be trained, there is no such configuration, or a field is unknown or of a wrong type.
    """
    configs = getattr(source.module(), "CONFIGS", None)
    if configs is None or not hasattr(source.module(), "Learner"):
        raise TrainError(f"{source.name} cannot be trained: {source.path} has no CONFIGS and Learner")
    for name, each in configs.items():
        lacking = [field for field in _FIELDS if not is_dataclass(each) or not hasattr(each, field)]
        if lacking:
            raise TrainError(f"{source.path}: CONFIGS: {name}: it has no field {lacking[0]}")
    if config in configs:
        return config, configs[config]
    path = Path(config)
    if path.suffix != ".toml":
        raise TrainError(f"--config {config}: neither a .toml file nor one of {', '.join(configs)}")
    try:
        values = read_toml(path)
    except FileError as error:
        raise TrainError(f"--config: {error}") from None
    base = values.pop("base", "fast")
    if base not in configs:
        raise TrainError(f"{path}: base: {base!r} is not one of {', '.join(configs)}")
    known: dict[str, Any] = {field.name: type(getattr(configs[base], field.name)) for field in fields(configs[base])}
    for name, value in values.items():
        if name not in known:
            raise TrainError(f"{path}: {name}: unknown; known are {', '.join(known)}")
        if not (type(value) is known[name] or (known[name] is float and type(value) is int)):
            raise TrainError(f"{path}: {name}: {value!r} is not of type {known[name].__name__}")
    try:
        return path.stem, replace(configs[base], **{name: known[name](value) for name, value in values.items()})
    except ValueError as error:
        raise TrainError(f"{path}: {error}") from None


def new_learner(training: Training) -> Any:
    """Return the learner at its beginning."""
    if training.source.weights is not None:
        raise TrainError(f"{training.source.weights} are weights: name their agent; --from starts from weights")
    try:
        learner = training.source.module().Learner(training.scenario, training.config, training.seed)
    except ValueError as error:
        raise TrainError(f"{training.source.name}: {error}") from None
    lacking = [name for name in _LEARNER if not hasattr(learner, name)]
    if lacking:
        raise TrainError(f"{training.source.path}: Learner: it has no {lacking[0]}")
    if training.start is not None:
        if not hasattr(learner, "start_from"):
            raise TrainError(f"{training.source.name} cannot begin from weights: its Learner has no start_from(path)")
        learner.start_from(training.start)
    return learner


def differences(found: Mapping[str, Any], expected: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the differences of two nested tables: the dotted name, the value found, and the value expected."""
    for name, value in expected.items():
        other: Any = found.get(name)
        if isinstance(value, Mapping) and isinstance(other, Mapping):
            yield from differences(cast("Mapping[str, Any]", other), cast("Mapping[str, Any]", value), f"{prefix}{name}.")
        elif other != value:
            yield f"{prefix}{name}", other, value
