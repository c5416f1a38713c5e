"""The leaderboard from a folder of submissions: everything is replayed, what is refused is named, the rest is built."""

import contextlib
import multiprocessing
from collections.abc import Callable, Generator, Sequence
from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import joblib  # pyright: ignore[reportMissingTypeStubs]

from uavbench.evaluation.evaluate import EpisodeRecord
from uavbench.leaderboard.owners import FILE as OWNERS
from uavbench.leaderboard.owners import Owners, load_owners, owners_text, why_not_its_own, with_new_names
from uavbench.leaderboard.page import page_text
from uavbench.leaderboard.ranking import Entry, Row, rank
from uavbench.leaderboard.reruns import load_reruns
from uavbench.leaderboard.submission import MANIFEST, Submission, SubmissionError, check, load_submission
from uavbench.leaderboard.table import table_text
from uavbench.world.files import finish_moves, write_together

_LONGEST = 300  # characters of a line about what is refused

#: A submission that holds, with what came out when it was flown again.
Held = tuple[Submission, list[EpisodeRecord]]


@dataclass(frozen=True)
class Board:
    """What came out: the rows, what was refused, and what flies as another does; a line each."""

    rows: list[Row]
    refused: list[str]
    alike: list[str]


def submission_folders(folder: Path) -> list[Path]:
    """Return the submissions in a folder: itself, or those that are one or two levels down, and whatever else is there.

    Raises
    ------
    SubmissionError
        When there is none.
    """
    root = folder.resolve()  # what is in it is not resolved: a link is found out as one
    if _is_one(root):
        return [root]
    found: list[Path] = []
    for outer in sorted(root.glob("*")):
        found += _inner(outer) or [outer]
    if not found:
        raise SubmissionError(f"{folder}: holds no submissions: folders <name>/<scenario> that uavbench submit wrote")
    return found


def _inner(outer: Path) -> list[Path]:
    """Return what an agent's folder holds; nothing of what is none or cannot be read, which is refused as a submission then."""
    closed = outer.name.startswith(".") or outer.is_symlink() or not outer.is_dir() or _is_one(outer)
    if not closed:
        finish_moves(outer)
    with contextlib.suppress(OSError):
        return [] if closed else sorted(outer.iterdir())
    return []


def _is_one(folder: Path) -> bool:
    """Say whether a folder is a submission rather than holds some."""
    with contextlib.suppress(OSError):
        return (folder / MANIFEST).is_file() and not any(path.is_dir() for path in folder.iterdir())
    return False


def verify(
    folders: Sequence[Path],
    workers: int = 1,
    on_checked: Callable[[Path], None] = lambda folder: None,
) -> tuple[list[Held], list[str]]:
    """Read and replay submissions; return those that hold, and why the others are refused, a line each."""
    held: list[Held] = []
    refused: list[str] = []
    for folder, found in zip(folders, _looks(folders, workers), strict=True):
        if isinstance(found, str):
            refused.append(found)
        else:
            held.append(found)
        on_checked(folder)
    return held, refused


def _looks(folders: Sequence[Path], workers: int) -> Generator[Held | str]:
    """Look at submissions in several processes, in their order. One that kills its process is refused, and no other.

    When a process dies, nobody knows of which submission: so the first that is open is looked at in a process of its own.
    """
    look: Any = cast("Any", joblib).delayed(_look)
    done = 0
    while done < len(folders):
        parallel: Any = joblib.Parallel(n_jobs=workers, return_as="generator")
        try:
            for found in parallel(look(folder) for folder in folders[done:]):
                yield found
                done += 1
        except BrokenProcessPool:
            yield _look_alone(folders[done])
            done += 1


def _look_alone(folder: Path) -> Held | str:
    """Look at a submission in a process of its own."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        try:
            return pool.submit(_look, folder).result()
        except BrokenProcessPool:
            return _line(f"{folder.parent.name}/{folder.name}: the process that read it died: it may take too much memory")


def build(submissions: Path, workers: int = 1, on_checked: Callable[[Path], None] = lambda folder: None) -> Board:
    """Replay all submissions, then write ``leaderboard.csv``, ``index.html`` and ``owners.toml`` beside their folder.

    When all are refused the board has no rows, and what was there stays.

    Raises
    ------
    SubmissionError
        When there are no submissions, only one agent's folder is given, or the files cannot be written: what was there stays.
    ResultError
        When what is known of a scenario's episodes is damaged.
    """
    folder, inner = submissions.resolve().parent, [path for path in submissions.glob("*") if path.is_dir()]
    if submissions.is_dir() and (_is_one(submissions) or (inner and all(_is_one(path) for path in inner))):
        raise SubmissionError(f"{submissions}: one agent's submissions: give the folder of all, in which it is")
    finish_moves(folder)
    found, refused = verify(submission_folders(submissions), workers, on_checked)
    owners = with_new_names(load_owners(folder / OWNERS), [submission for submission, _ in found])
    held, others = _owned(found, owners)
    if not held:
        return Board([], [*refused, *others], [])
    reruns = load_reruns(folder / "reruns.csv")
    entries = [Entry(submission, flown, reruns.get(submission.label)) for submission, flown in held]
    rows = rank(entries)
    texts = {"leaderboard.csv": table_text(rows), "index.html": page_text(rows, entries), OWNERS: owners_text(owners)}
    try:
        write_together({folder / name: text.encode() for name, text in texts.items()})
    except OSError as error:
        raise SubmissionError(f"{error.filename or folder}: cannot write it: {error.strerror or error}") from None
    return Board(rows, [*refused, *others], _alike(held, list(owners)))


def _owned(held: Sequence[Held], owners: Owners) -> tuple[list[Held], list[str]]:
    """Return the submissions whose name is their authors', and a line for each of the others."""
    kept: list[Held] = []
    refused: list[str] = []
    for submission, flown in held:
        reason = why_not_its_own(submission.manifest, submission.folder.parent.name, owners)
        if reason:
            refused.append(_line(f"{submission.label}: {reason}"))
        else:
            kept.append((submission, flown))
    return kept, refused


def _alike(held: Sequence[Held], names: Sequence[str]) -> list[str]:
    """Return a line for each submission that took the same actions as another on all episodes: as one of an older name.

    ``names`` are those of all folders, the oldest first.
    """
    first: dict[tuple[str, bytes], str] = {}
    found: list[str] = []
    for submission, flown in sorted(held, key=lambda each: names.index(each[0].folder.parent.name)):
        actions = b"|".join(record.actions.tobytes() for record in flown)
        one = first.setdefault((submission.scenario.id, actions), submission.label)
        if one != submission.label:
            found.append(f"{submission.label} took the same actions as {one}")
    return found


def _look(folder: Path) -> Held | str:
    """Return a submission that holds, or why it does not."""
    try:
        submission = load_submission(folder)
        return submission, check(submission)
    except SubmissionError as error:
        return _line(str(error))
    except Exception as error:  # whatever one submission breaks, the others are built
        return _line(f"{folder.parent.name}/{folder.name}: cannot be read: {type(error).__name__}: {error}")


def _line(text: str) -> str:
    """Return text as a line that a terminal shows as it is, whoever wrote parts of it."""
    seen = "".join(letter if letter.isprintable() else "?" for letter in " ".join(text.split()))
    return seen if len(seen) <= _LONGEST else f"{seen[:_LONGEST]}…"
