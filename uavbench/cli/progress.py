"""Progress of long commands: a bar in a terminal, plain lines elsewhere."""

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from uavbench.evaluation.evaluate import EpisodeRecord
from uavbench.evaluation.metrics import NAMES
from uavbench.learning.training import Point

_LINE_SECONDS = 30.0  # between two plain lines


class _Bar(Progress):
    """A progress bar. Without a terminal, it prints a plain line at most every 30 seconds instead."""

    def __init__(self, *columns: Any, console: Console) -> None:
        super().__init__(*columns, console=console)
        self._told = time.monotonic()

    def update(self, task_id: TaskID, **changes: Any) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Change a task, and print a line if one is due."""
        super().update(task_id, **changes)
        self._tell(task_id)

    def advance(self, task_id: TaskID, advance: float = 1) -> None:
        """Advance a task, and print a line if one is due."""
        super().advance(task_id, advance)
        self._tell(task_id)

    def _tell(self, task_id: TaskID) -> None:
        """Print a line if there is no terminal and the last line is 30 seconds old."""
        if self.console.is_terminal or time.monotonic() - self._told < _LINE_SECONDS:
            return
        self._told = time.monotonic()
        task = self._tasks[task_id]
        parts = [f"{task.completed:,.0f} of {task.total or 0:,.0f}", task.fields["mean"], f"{_clock(task.elapsed)} so far"]
        if task.time_remaining is not None:
            parts.append(f"about {_clock(task.time_remaining)} to go")
        self.console.print(
            f"{task.description}: {', '.join(filter(None, parts))}", markup=False, highlight=False, soft_wrap=True
        )


def _clock(seconds: float | None) -> str:
    """Return a time as hours, minutes and seconds."""
    minutes, rest = divmod(round(seconds or 0), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{rest:02}"


@contextmanager
def _bar(console: Console) -> Generator[Progress]:
    """Provide a bar, which is not shown before it is started."""
    progress = _Bar(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[mean]}"),
        console=console,
    )
    try:
        yield progress
    finally:
        if progress.live.is_started:
            progress.stop()


@contextmanager
def working(console: Console, label: str, total: int | None = None) -> Generator[Callable[[object], None]]:
    """Show the progress of ``total`` pieces of work, if known; call the yielded function when each of them is done."""
    with _bar(console) as progress:
        task = progress.add_task(label, total=total, mean="")
        progress.start()
        yield lambda _: progress.advance(task)


class EpisodesProgress:
    """The bar that runs while episodes are flown or bounded, with the mean of their values so far."""

    def __init__(self, progress: Progress, label: str, name: str) -> None:
        self._progress = progress
        self._task = progress.add_task(label, total=None, mean="starting (the first run compiles)")
        self._name = name
        self._sum = 0.0
        self._count = 0

    def show(self, total: int) -> None:
        """Show the bar for ``total`` episodes, if there are any."""
        self._progress.update(self._task, total=total)
        if total:
            self._progress.start()

    def note(self, record: EpisodeRecord) -> None:
        """Count a finished episode, with its CRAL."""
        self.advance(record.cral)

    def advance(self, value: float) -> None:
        """Count a finished episode, with its ``value`` in [0, 1]."""
        self._sum += value
        self._count += 1
        self._progress.update(self._task, advance=1, mean=f"{self._name} {100 * self._sum / self._count:.1f} %")


@contextmanager
def episodes_progress(console: Console, label: str, name: str) -> Generator[EpisodesProgress]:
    """Show the progress of a run over episodes, from the call of `show` to the end of the block."""
    with _bar(console) as progress:
        yield EpisodesProgress(progress, label, name)


class TrainingProgress:
    """The bar that runs while an agent learns, and a line for every validation."""

    def __init__(self, progress: Progress, label: str) -> None:
        self._progress = progress
        self._task = progress.add_task(label, total=None, mean="starting (the first run compiles)")

    def show(self, done: int, updates: int) -> None:
        """Show the bar, with ``done`` of ``updates`` updates done."""
        self._progress.update(self._task, total=updates, completed=done, mean="")
        self._progress.start()

    def advance(self, updates: int) -> None:
        """Show that ``updates`` are done."""
        self._progress.update(self._task, completed=updates)

    def add_point(self, point: Point) -> None:
        """Print the scores of a validation, in per cent."""
        scores = ", ".join(f"{NAMES[name]} {100 * getattr(point, name):.1f}" for name in NAMES)
        self._progress.console.print(
            f"{point.updates:>9,} updates {point.samples / 1e6:6.2f} M samples {point.seconds / 60:6.1f} min   {scores}",
            highlight=False,
        )


@contextmanager
def training_progress(console: Console, label: str) -> Generator[TrainingProgress]:
    """Show the progress of a training, from the call of `show` to the end of the block."""
    with _bar(console) as progress:
        yield TrainingProgress(progress, label)
