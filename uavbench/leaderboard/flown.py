"""Which flights of submissions survive physics: ``flown.csv`` beside ``submissions/``, written by the board's maintainer.

A simulated quadrotor flies recorded episodes (`uavbench.flight.flown`), without wind, at several speeds. A line of the file
counts for the actions whose digest it has, and for these alone. The board shows how many flights were safe, but does not rank
by it.
"""

import csv
import io
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, cast

import joblib  # pyright: ignore[reportMissingTypeStubs]

from uavbench.flight.flown import Conditions, fly
from uavbench.flight.route import recorded_flight
from uavbench.leaderboard.reruns import actions_digest
from uavbench.leaderboard.submission import Submission, SubmissionError, load_submission
from uavbench.world.files import TABLE_BYTES, FileError, check_writable, read_text, write_atomic

#: The name of the file beside the folder of submissions.
FILE = "flown.csv"
#: In m/s.
SPEEDS = (2.0, 5.0, 8.0)
_SECONDS = 30.0  # between two times that the file is written


@dataclass(frozen=True)
class FlownEpisode:
    """A recorded episode, flown with physics. Of a team, the worst of its UAVs counts, and the energy is that of all.

    Attributes
    ----------
    submission : str
        The folder of the submission, <name>/<scenario>.
    actions_sha256 : str
        Digest of ``actions.npz``.
    episode : int
    speed : float
        The largest one over ground, in m/s.
    hit, zone : bool
        Whether the quadrotor hit something, and whether it entered a no-fly zone.
    cr, cr_flown : float
        CR on the grid and as flown, in [0, 1].
    seconds, energy : float
        From take-off to landing; the energy is in Wh.
    off_track : float
        The largest distance from the path on the grid, in metres.
    clearance : float
        The least distance to a building, in metres; infinite if there is none.
    """

    submission: str
    actions_sha256: str
    episode: int
    speed: float
    hit: bool
    zone: bool
    cr: float
    cr_flown: float
    seconds: float
    energy: float
    off_track: float
    clearance: float

    @property
    def safe(self) -> bool:
        """Whether nothing was hit and no no-fly zone entered."""
        return not (self.hit or self.zone)


@dataclass(frozen=True)
class Safety:
    """How many of the episodes that were flown at a speed were safe."""

    speed: float
    safe: int
    flown: int


def file_beside(submissions: Sequence[Submission]) -> Path:
    """Return the file of the board that all submissions are on.

    Raises
    ------
    SubmissionError
        When they are on several.
    """
    boards = sorted({each.folder.parent.parent.parent for each in submissions})
    if len(boards) > 1:
        raise SubmissionError(f"{boards[0]} and {boards[1]} are two boards: give the submissions of one")
    return boards[0] / FILE


def load_flown(path: Path) -> list[FlownEpisode]:
    """Read the file; empty when there is none.

    Raises
    ------
    SubmissionError
        When it is damaged.
    """
    if not path.exists():
        return []
    found: list[FlownEpisode] = []
    reader = None
    try:
        reader = csv.DictReader(read_text(path, TABLE_BYTES).splitlines(), strict=True)
        found += [_read(row) for row in reader]
    except FileError as error:
        raise SubmissionError(str(error)) from None
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        where = f" in line {reader.line_num}" if reader else ""
        raise SubmissionError(
            f"{path}: damaged{where} ({error}): restore an earlier version of the file, or delete the line and fly it again"
        ) from None
    return found


def _read(row: dict[str, str]) -> FlownEpisode:
    """Return a line of the file; raise an error if it is none."""
    values: dict[str, Any] = {}
    for field in fields(FlownEpisode):
        text = row[field.name]
        if field.type is bool:
            if text not in ("True", "False"):
                raise ValueError(f"{field.name} is {text}")
            values[field.name] = text == "True"
        elif field.type is float:
            values[field.name] = float(text)
            if math.isnan(values[field.name]) or (math.isinf(values[field.name]) and field.name != "clearance"):
                raise ValueError(f"{field.name} is {text}")
        else:
            values[field.name] = int(text) if field.type is int else text
    return FlownEpisode(**values)


def save_flown(path: Path, rows: Iterable[FlownEpisode]) -> None:
    """Write the file, completely or not at all.

    Raises
    ------
    SubmissionError
        When it cannot be written.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(FlownEpisode)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in sorted(rows, key=lambda row: (row.submission, row.speed, row.episode)))
    try:
        write_atomic(path, text.getvalue().encode())
    except OSError as error:
        raise SubmissionError(f"{path}: {error.strerror}: nothing was written") from None


def missing_flights(
    submissions: Sequence[Submission], episodes: int, speeds: Sequence[float], known: Iterable[FlownEpisode]
) -> list[tuple[Submission, int, float]]:
    """Return which of the first ``episodes`` of submissions, at which speeds, have not been flown yet, by episode."""
    done = {(row.submission, row.actions_sha256, row.episode, row.speed) for row in known}
    digests = {each.label: actions_digest(each) for each in submissions}
    return [
        (each, number, speed)
        for number in range(episodes)
        for each in submissions
        for speed in dict.fromkeys(speeds)
        if number < each.manifest.result.episodes and (each.label, digests[each.label], number, speed) not in done
    ]


def fly_missing(
    flights: Sequence[tuple[Submission, int, float]],
    path: Path,
    workers: int = 1,
    on_flown: Callable[[FlownEpisode], None] = lambda row: None,
) -> None:
    """Fly recorded episodes with physics, without wind, and add them to the file; if something fails, what was flown is kept.

    Parameters
    ----------
    flights : sequence of (Submission, int, float)
        A submission, an episode, and the largest speed over ground in m/s.
    path : Path
        The file.
    workers : int
        The number of processes.
    on_flown : callable
        Called with each flight.

    Raises
    ------
    FlightError
        When a speed is out of range, or a library is missing.
    SubmissionError
        When a submission or the file is damaged, or the file cannot be written.
    ResultError
        When the recorded actions are not those of a whole episode.
    """
    rows = {(row.submission, row.episode, row.speed): row for row in load_flown(path)}
    try:
        check_writable(path.parent)  # before hours of flights
    except OSError as error:
        raise SubmissionError(f"{path}: {error.strerror}") from None
    new = False
    one: Any = cast("Any", joblib).delayed(_flown)
    parallel: Any = joblib.Parallel(n_jobs=workers, return_as="generator_unordered")
    saved = time.monotonic()
    try:
        for row in parallel(one(each.folder, number, speed) for each, number, speed in flights):
            rows[row.submission, row.episode, row.speed] = row  # instead of one of other actions
            new = True
            on_flown(row)
            if time.monotonic() - saved > _SECONDS:
                save_flown(path, rows.values())
                saved = time.monotonic()
    finally:
        if new:
            save_flown(path, rows.values())


def _flown(folder: Path, episode: int, speed: float) -> FlownEpisode:
    """Fly one recorded episode."""
    submission = load_submission(folder)
    flight = recorded_flight(submission.result, episode)
    flown = fly(flight, Conditions(speed=speed))
    return FlownEpisode(
        submission=submission.label,
        actions_sha256=actions_digest(submission),
        episode=episode,
        speed=speed,
        hit=any(uav.hit for uav in flown.uavs),
        zone=any(uav.zone for uav in flown.uavs),
        cr=flight.cr,
        cr_flown=flown.cr,
        seconds=max(uav.seconds for uav in flown.uavs),
        energy=sum(uav.energy for uav in flown.uavs),
        off_track=max(uav.off_track for uav in flown.uavs),
        clearance=min(uav.clearance for uav in flown.uavs),
    )


def safety(rows: Iterable[FlownEpisode], submission: Submission) -> tuple[Safety, ...]:
    """Return how safe the flights of a submission were, by their speed. Flights of other actions do not count."""
    digest = actions_digest(submission)
    found: dict[float, list[bool]] = {}
    for row in rows:
        if (row.submission, row.actions_sha256) == (submission.label, digest):
            found.setdefault(row.speed, []).append(row.safe)
    return tuple(Safety(speed, sum(found[speed]), len(found[speed])) for speed in sorted(found))
