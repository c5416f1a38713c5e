"""Training a learned agent from beginning to end; a training may be interrupted and resumed.

An agent that can be trained has in its file, besides ``Agent``, a dictionary ``CONFIGS`` of dataclasses and a class ``Learner``
(see docs/agents.md). One checkpoint holds everything that is needed to resume the training. The weights that are kept are those
with the highest CRAL on validation episodes.
"""

import hashlib
import importlib
import math
import platform
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any, cast

from uavbench.agents.agent import AgentSource
from uavbench.agents.weights import WeightsError, check_trained, load_weights, save_weights, training_facts, training_record
from uavbench.errors import UavbenchError, one_line
from uavbench.evaluation.interrupt import ignore_interrupts, interrupt_waits
from uavbench.learning.device import on_device
from uavbench.learning.group import Group, begun, group
from uavbench.learning.memory import keep_freed
from uavbench.learning.validation import EPISODES, Validation
from uavbench.world.files import MODEL_BYTES, FileError, read_bounded, read_toml
from uavbench.world.scenario import Scenario

_CHECKPOINT_SECONDS = 180.0
#: A checkpoint is written before a validation if the last one is older than this, since validations are often the longest step.
_BEFORE_VALIDATION_SECONDS = 30.0
_PLOT_UPDATES = 100
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


def train(
    training: Training,
    out: Path,
    *,
    resume: bool = False,
    seconds: float = math.inf,
    threads: int = 1,
    device: str = "auto",
    on_start: Callable[[int, int], None] = lambda done, updates: None,
    on_update: Callable[[int], None] = lambda updates: None,
    on_point: Callable[[Point], None] = lambda point: None,
) -> Path:
    """Train, and return the file of the best weights in validation: ``out``/<scenario>/<agent>-<config>-<seed>.safetensors.

    Parameters
    ----------
    training : Training
    out : Path
        The folder of all trainings.
    resume : bool
        Continue from the checkpoint, if there is one.
    seconds : float
        Stop after this time; the training can be resumed later.
    threads : int
        Number of PyTorch's threads. Another number may change the last digits of the weights.
    device : str
        Where the network computes: "auto", "cpu", "cuda" or "mps"; see `on_device`.
    on_start, on_update, on_point : callable
        Called at the beginning with the numbers of updates done and wanted, after every update with the number done, and for
        every validation, those before a resume included.

    Raises
    ------
    DeviceError
        When there is no such device here.
    TrainError, WeightsError
        When a checkpoint exists and ``resume`` is not given, or it is damaged or of another training; when the agent cannot
        learn this scenario or start from the given weights; or when a library is missing.
    KeyboardInterrupt
        When the user interrupts the training; a checkpoint has been written.
    """
    _needed("safetensors", "tensorboard", "torch")
    if training.start is not None:
        check_trained(training.start, training_record(training.start), training.scenario)
    if training.processes > 1 and not getattr(training.source.module().Learner, "parallel", False):
        raise TrainError(f"{training.source.name} cannot be trained in several processes: its Learner has no `parallel = True`")
    with begun(training.processes, _follow, training, threads, device) as processes:
        if processes.rank:
            _follow(training, threads, device)
            return training.files(out)[0]
        with _computing(threads, device), interrupt_waits() as interrupted:
            processes.told(training.identity)
            run = _Run(training, processes, out, resume)
            on_start(run.learner.updates, training.config.updates)
            for point in run.points:
                on_point(point)
            while not (run.ended or interrupted) and time.perf_counter() - run.started < seconds:
                if not run.validation_due:
                    run.advance()
                    on_update(run.learner.updates)
                elif run.validate(lambda: bool(interrupted)):
                    on_point(run.points[-1])
            run.close()
            processes.told(None)
    if interrupted:
        raise KeyboardInterrupt(f"interrupted; --resume goes on from {run.checkpoint}")
    return run.kept


def _computing(threads: int, device: str) -> AbstractContextManager[Any]:
    """Prepare this process for a training; return the context in which it computes."""
    _needed("torch").set_num_threads(threads)
    keep_freed()
    return on_device(device)


def _follow(training: Training, threads: int, device: str) -> None:
    """Do what the process that leads tells, until it tells None."""
    ignore_interrupts()
    with _computing(threads, device):
        found = group()
        for name, there, here in _differences(found.told(), training.identity):
            raise TrainError(f"process {found.rank + 1}: its {name} is {here}, not {there} as in the process that leads")
        learner, validation = _learner(training), _validation(training, found, Path())
        while (order := found.told()) is not None:
            name, *arguments = order
            getattr(validation if name == "fly" else learner, name)(*arguments)


class _Leader:
    """The learner of the process that leads: what it does, the other processes do with theirs."""

    def __init__(self, learner: Any, group: Group) -> None:
        self._learner, self._group = learner, group

    def __getattr__(self, name: str) -> Any:
        return getattr(self._learner, name)

    def advance(self) -> dict[str, float]:
        """Make an update together."""
        self._group.told(("advance",))
        return self._learner.advance()

    def snapshot(self) -> Mapping[str, Any]:
        """Return what changes in all processes."""
        self._group.told(("snapshot",))
        return self._learner.snapshot()

    def resume(self, arrays: Mapping[str, Any]) -> None:
        """Let all processes continue from a snapshot."""
        self._learner.resume(arrays)  # what does not fit is noticed here first
        self._group.told(("resume", arrays))


class _Run:
    """A training that runs: its learner, its curve so far, and its files."""

    def __init__(self, training: Training, group: Group, out: Path, resume: bool) -> None:
        self.kept, self.checkpoint = training.files(out)
        self._training, folder = training, self.kept.parent
        self.learner = _Leader(_learner(training), group)
        _ = training.identity  # digests are computed now, since files may change later
        self.points, self._spent = _begin(training, self.learner, self.checkpoint, resume)
        if self.points and not self.kept.exists():
            raise TrainError(
                f"{self.kept}: the best weights so far are gone: put them back, or delete {self.checkpoint} to start over"
            )
        self._validation = _validation(training, group, folder)
        self.started = self._saved = time.perf_counter()
        self._board = _board(folder / f"{training.label}.tensorboard", self.learner.updates)

    @property
    def validation_due(self) -> bool:
        """Whether the present network is one to validate, and was not yet."""
        done = self.points[-1].updates if self.points else 0
        config, updates = self._training.config, self.learner.updates
        return updates > done and (updates % config.validation == 0 or updates >= config.updates)

    @property
    def ended(self) -> bool:
        """Whether everything is done, the last validation too."""
        return self.learner.updates >= self._training.config.updates and not self.validation_due

    def advance(self) -> None:
        """Make one update."""
        scalars = self.learner.advance()
        if self.learner.updates % _PLOT_UPDATES == 0:
            self._plot("training", scalars)
        self._save(_BEFORE_VALIDATION_SECONDS if self.validation_due else _CHECKPOINT_SECONDS)

    def validate(self, stopped: Callable[[], bool]) -> bool:
        """Validate the present network, and keep its weights if they are the best so far; return False if it was stopped."""
        arrays = self.learner.weights()
        scores = self._validation.scores(arrays, self._training.record([]), stopped)
        if scores is None:
            return False
        point = Point(self.learner.updates, self.learner.samples, round(self._seconds(), 1), **scores)
        if point.cral >= max((each.cral for each in self.points), default=0.0):
            save_weights(self.kept, arrays, self._training.record([*self.points, point]))
        self.points.append(point)
        self._plot("validation", asdict(point))
        self._save(_BEFORE_VALIDATION_SECONDS)
        return True

    def close(self) -> None:
        """Write the last checkpoint."""
        self._save(0.0)
        self._board.close()

    def _seconds(self) -> float:
        """Return the time spent so far, before earlier interruptions too."""
        return self._spent + time.perf_counter() - self.started

    def _save(self, age: float) -> None:
        """Write a checkpoint, unless the last one is younger than so many seconds."""
        if time.perf_counter() - self._saved >= age:
            self._saved = time.perf_counter()
            save_weights(self.checkpoint, self.learner.snapshot(), self._training.record(self.points, self._seconds()))

    def _plot(self, group: str, scalars: Mapping[str, float]) -> None:
        """Write numbers for TensorBoard."""
        for name, value in scalars.items():
            self._board.add_scalar(f"{group}/{name}", value, self.learner.updates)


def _learner(training: Training) -> Any:
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


def _validation(training: Training, group: Group, folder: Path) -> Validation:
    """Return how the training validates."""
    wanted = getattr(training.config, "validation_episodes", EPISODES)
    return Validation(training.source, training.scenario, folder, training.label, wanted, group)


def _needed(*libraries: str) -> Any:
    """Return the last of some libraries; raise a TrainError that says how to install a missing one."""
    try:
        return [importlib.import_module(name) for name in libraries][-1]
    except ImportError as error:
        raise TrainError(f"training needs {error.name}: pip install 'uavbench[ddqn]'") from error


def _begin(training: Training, learner: Any, checkpoint: Path, resume: bool) -> tuple[list[Point], float]:
    """Restore the learner from the checkpoint, if there is one; return the curve and the time so far."""
    if not checkpoint.exists():
        return [], 0.0
    if not resume:
        raise TrainError(f"{checkpoint} is there already: go on with --resume, or delete it to start over")
    for left in checkpoint.parent.glob(f".{checkpoint.name}.*"):
        left.unlink()  # left by a process that was killed while it wrote
    arrays, record = load_weights(checkpoint)
    for name, found, value in _differences({"processes": 1, **record}, training.identity):  # earlier versions had one process
        raise TrainError(f"{checkpoint}: it is of another training: its {name} is {found}, not {value}")
    try:
        learner.resume(arrays)
        again = learner.snapshot()
        for name in sorted(arrays.keys() | again.keys()):  # what was not restored exactly is wrong
            if arrays[name].shape != again[name].shape or arrays[name].tobytes() != again[name].tobytes():
                raise ValueError(f"{name} does not fit")
        points = [Point(**point) for point in record["curve"]]
        for value in (record["seconds"], *(value for point in points for value in asdict(point).values())):
            if type(value) not in (int, float):
                raise ValueError(f"its curve holds {value!r}, which is no number")
        return points, float(record["seconds"])
    except (AttributeError, KeyError, IndexError, TypeError, ValueError, OverflowError, RuntimeError) as error:
        reason = one_line(error) or one_line(repr(error))
        raise WeightsError(f"{checkpoint}: damaged, or of another version: {reason}; delete it to start over") from None


def _differences(found: Mapping[str, Any], expected: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the differences of two nested tables: the dotted name, the value found, and the value expected."""
    for name, value in expected.items():
        other: Any = found.get(name)
        if isinstance(value, Mapping) and isinstance(other, Mapping):
            yield from _differences(cast("Mapping[str, Any]", other), cast("Mapping[str, Any]", value), f"{prefix}{name}.")
        elif other != value:
            yield f"{prefix}{name}", other, value


def _board(folder: Path, done: int) -> Any:
    """Return a TensorBoard writer; what an interrupted training wrote after ``done`` updates is dropped."""
    from torch.utils.tensorboard.writer import SummaryWriter

    return SummaryWriter(str(folder), purge_step=done + 1)
