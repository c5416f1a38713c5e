"""Training a learned agent from beginning to end; a training may be interrupted and resumed, and shared by processes.

One checkpoint holds everything that is needed to resume the training. The weights that are kept are those with the
highest CRAL on validation episodes.
"""

import importlib
import math
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from uavbench.agents.weights import WeightsError, check_trained, load_weights, save_weights, training_record
from uavbench.errors import one_line
from uavbench.evaluation.interrupt import ignore_interrupts, interrupt_waits
from uavbench.learning.device import on_device
from uavbench.learning.group import Group, begun, group
from uavbench.learning.memory import keep_freed
from uavbench.learning.training import Point, TrainError, Training, differences, new_learner
from uavbench.learning.validation import EPISODES, Validation

_CHECKPOINT_SECONDS = 180.0
#: A checkpoint is written before a validation if the last one is older than this, since validations are often the longest step.
_BEFORE_VALIDATION_SECONDS = 30.0
_PLOT_UPDATES = 100


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
        if processes.size != training.processes:
            raise TrainError(f"torchrun has started {processes.size} processes, but the training is for {training.processes}")
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
        for name, there, here in differences(found.told(), training.identity):
            raise TrainError(f"process {found.rank + 1}: its {name} is {here}, not {there} as in the process that leads")
        learner, validation = new_learner(training), _validation(training, found, Path())
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
        self.learner = _Leader(new_learner(training), group)
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
    for name, found, value in differences({"processes": 1, **record}, training.identity):  # earlier versions had one process
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


def _board(folder: Path, done: int) -> Any:
    """Return a TensorBoard writer; what an interrupted training wrote after ``done`` updates is dropped."""
    from torch.utils.tensorboard.writer import SummaryWriter

    return SummaryWriter(str(folder), purge_step=done + 1)
