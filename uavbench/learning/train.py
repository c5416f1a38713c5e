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
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any, cast

import numpy as np

from uavbench.agents.agent import AgentSource
from uavbench.agents.weights import WeightsError, check_trained, load_weights, save_weights, training_facts, training_record
from uavbench.errors import UavbenchError, one_line
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.evaluation.interrupt import interrupt_waits
from uavbench.evaluation.metrics import METRICS
from uavbench.learning.memory import keep_freed
from uavbench.world.files import MODEL_BYTES, FileError, read_bounded, read_toml
from uavbench.world.scenario import Scenario

_CHECKPOINT_SECONDS = 180.0
_PLOT_UPDATES = 100
_VALIDATION_EPISODES = 200
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
    """

    source: AgentSource
    scenario: Scenario
    name: str
    config: Any
    seed: int
    start: Path | None = None

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
        }

    @cached_property
    def _start_sha256(self) -> str | None:
        """The digest of the weights to start from, as they were when the training began."""
        return None if self.start is None else hashlib.sha256(read_bounded(self.start, MODEL_BYTES)).hexdigest()

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
    on_start, on_update, on_point : callable
        Called at the beginning with the numbers of updates done and wanted, after every update with the number done, and for
        every validation, those before a resume included.

    Raises
    ------
    TrainError, WeightsError
        When a checkpoint exists and ``resume`` is not given, or it is damaged or of another training; when the agent cannot
        learn this scenario or start from the given weights; or when a library is missing.
    KeyboardInterrupt
        When the user interrupts the training; a checkpoint has been written.
    """
    kept, checkpoint = training.files(out)
    folder = kept.parent
    _needed("safetensors", "tensorboard", "torch").set_num_threads(threads)
    keep_freed()
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
        check_trained(training.start, training_record(training.start), training.scenario)
        learner.start_from(training.start)
    _ = training.identity  # digests are computed now, since files may change later
    points, spent = _begin(training, learner, checkpoint, resume)
    if points and not kept.exists():
        raise TrainError(f"{kept}: the best weights so far are gone: put them back, or delete {checkpoint} to start over")
    started, saved = time.perf_counter(), time.perf_counter()
    updates, every = training.config.updates, training.config.validation
    board = _board(folder / f"{training.label}.tensorboard", learner.updates)
    on_start(learner.updates, updates)
    for point in points:
        on_point(point)
    with interrupt_waits() as interrupted:
        while learner.updates < updates and not interrupted and time.perf_counter() - started < seconds:
            scalars = learner.advance()
            on_update(learner.updates)
            if learner.updates % _PLOT_UPDATES == 0:
                _plot(board, "training", scalars, learner.updates)
            if learner.updates % every == 0 or learner.updates == updates:
                point = _validate(training, learner, folder, spent + time.perf_counter() - started)
                if point.cral >= max((each.cral for each in points), default=0.0):
                    save_weights(kept, learner.weights(), training.record([*points, point]))
                points.append(point)
                _plot(board, "validation", asdict(point), learner.updates)
                on_point(point)
            if time.perf_counter() - saved > _CHECKPOINT_SECONDS:
                saved = time.perf_counter()
                save_weights(checkpoint, learner.snapshot(), training.record(points, spent + saved - started))
        save_weights(checkpoint, learner.snapshot(), training.record(points, spent + time.perf_counter() - started))
    board.close()
    if interrupted:
        raise KeyboardInterrupt(f"interrupted; --resume goes on from {checkpoint}")
    return kept


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
    for name, found, value in _differences(record, training.identity):
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


def _validate(training: Training, learner: Any, folder: Path, seconds: float) -> Point:
    """Evaluate the present network, in the same way as weights on disk are evaluated."""
    latest = folder / f".{training.label}.latest.safetensors"
    save_weights(latest, learner.weights(), training.record([]))
    job = Job(replace(training.source, weights=latest), training.scenario, "validation")
    wanted = getattr(training.config, "validation_episodes", _VALIDATION_EPISODES)
    count = min(wanted, training.scenario.splits.validation.episodes)
    try:
        records = list(evaluate(job, range(count)))
    finally:
        latest.unlink(missing_ok=True)
    scores = {name: float(np.mean([getattr(record, name) for record in records])) for name in METRICS}
    return Point(learner.updates, learner.samples, round(seconds, 1), **scores)


def _board(folder: Path, done: int) -> Any:
    """Return a TensorBoard writer; what an interrupted training wrote after ``done`` updates is dropped."""
    from torch.utils.tensorboard.writer import SummaryWriter

    return SummaryWriter(str(folder), purge_step=done + 1)


def _plot(board: Any, group: str, scalars: Mapping[str, float], updates: int) -> None:
    """Write numbers for TensorBoard."""
    for name, value in scalars.items():
        board.add_scalar(f"{group}/{name}", value, updates)
