"""Builds the leaderboard from a folder of submissions: replays all, names those that it refuses, and ranks the others."""

import contextlib
import multiprocessing
from collections.abc import Callable, Generator, Sequence
from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import joblib  # pyright: ignore[reportMissingTypeStubs]

from uavbench.evaluation.evaluate import EpisodeRecord
from uavbench.leaderboard.best_known import FOLDER as BEST_KNOWN
from uavbench.leaderboard.best_known import BestKnown, best_known_files, changes, improved, load_all, today
from uavbench.leaderboard.best_known_page import best_known_text
from uavbench.leaderboard.flown import FILE as FLOWN
from uavbench.leaderboard.flown import load_flown, safety
from uavbench.leaderboard.owners import FILE as OWNERS
from uavbench.leaderboard.owners import Owners, load_owners, owners_text, why_not_its_own, with_new_names
from uavbench.leaderboard.page import page_text
from uavbench.leaderboard.ranking import Entry, Row, rank
from uavbench.leaderboard.reruns import load_reruns
from uavbench.leaderboard.submission import MANIFEST, Submission, SubmissionError, check, load_submission
from uavbench.leaderboard.table import table_text
from uavbench.world.files import finish_moves, write_together
from uavbench.world.scenario import Scenario

_LONGEST = 300  # characters of a line that says why a submission is refused

#: A valid submission, with the records of its replay.
Held = tuple[Submission, list[EpisodeRecord]]


@dataclass(frozen=True)
class Board:
    """A built leaderboard: its rows, and a line for each refused submission and for each that takes the actions of another."""

    rows: list[Row]
    refused: list[str]
    alike: list[str]


def submission_folders(folder: Path) -> list[Path]:
    """Return the submissions in a folder: the folder itself, or what is one or two levels below it.

    Anything there that is not a submission is returned too, so that it is refused by name.

    Raises
    ------
    SubmissionError
        When there is none.
    """
    root = folder.resolve()  # but nothing inside it is resolved, so that links are noticed and refused
    if _is_one(root):
        return [root]
    found: list[Path] = []
    for outer in sorted(root.glob("*")):
        found += _inner(outer) or [outer]
    if not found:
        raise SubmissionError(f"{folder}: holds no submissions: folders <name>/<scenario> that uavbench submit wrote")
    return found


def _inner(outer: Path) -> list[Path]:
    """Return what is in an agent's folder; nothing if it is none or cannot be read: then it counts as a submission."""
    closed = outer.name.startswith(".") or outer.is_symlink() or not outer.is_dir() or _is_one(outer)
    if not closed:
        finish_moves(outer)
    with contextlib.suppress(OSError):
        return [] if closed else sorted(outer.iterdir())
    return []


def _is_one(folder: Path) -> bool:
    """Say whether a folder is itself a submission, rather than a folder of submissions."""
    with contextlib.suppress(OSError):
        return (folder / MANIFEST).is_file() and not any(path.is_dir() for path in folder.iterdir())
    return False


def verify(
    folders: Sequence[Path],
    workers: int = 1,
    on_checked: Callable[[Path], None] = lambda folder: None,
) -> tuple[list[Held], list[str]]:
    """Read and replay submissions; return the valid ones, and for each of the others a line that says why it is refused."""
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
    """Check submissions in several processes, and yield in their order. Only a submission that kills its process is refused.

    When a process dies, it is unknown which submission killed it. So the next one is checked in a process of its own.
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
    """Check a submission in a process of its own."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        try:
            return pool.submit(_look, folder).result()
        except BrokenProcessPool:
            return _line(f"{folder.parent.name}/{folder.name}: the process that read it died: it may take too much memory")


def build(submissions: Path, workers: int = 1, on_checked: Callable[[Path], None] = lambda folder: None) -> Board:
    """Replay all submissions, then write ``leaderboard.csv``, the pages and ``owners.toml`` beside their folder.

    Flights that are better than the best known ones are added to these; see `uavbench.leaderboard.best_known`. When all
    submissions are refused, the board has no rows and no file changes.

    Raises
    ------
    SubmissionError
        When there are no submissions, only one agent's folder is given, ``owners.toml``, ``reruns.csv``, ``flown.csv`` or
        a file of the best known flights is damaged, or the files cannot be written. No file changes then.
    ResultError
        When a scenario's table of upper bounds and best known scores is damaged.
    """
    folder, inner = submissions.resolve().parent, [path for path in submissions.glob("*") if path.is_dir()]
    if submissions.is_dir() and (_is_one(submissions) or (inner and all(_is_one(path) for path in inner))):
        raise SubmissionError(f"{submissions}: the submissions of one agent: give the folder of all submissions")
    finish_moves(folder)
    found, refused = verify(submission_folders(submissions), workers, on_checked)
    owners = with_new_names(load_owners(folder / OWNERS), [submission for submission, _ in found])
    held, others = _owned(found, owners)
    if not held:
        return Board([], [*refused, *others], [])
    reruns = load_reruns(folder / "reruns.csv")
    physics = load_flown(folder / FLOWN)
    entries = [
        Entry(submission, flown, reruns.get(submission.label), safety(physics, submission)) for submission, flown in held
    ]
    rows = rank(entries)
    best, new = _best_known(folder / BEST_KNOWN, held)
    texts = {
        "leaderboard.csv": table_text(rows),
        "index.html": page_text(rows, entries),
        "best_known.html": best_known_text(best, entries),
        OWNERS: owners_text(owners),
    }
    try:
        write_together({folder / name: text.encode() for name, text in texts.items()} | new)
    except OSError as error:
        raise SubmissionError(f"{error.filename or folder}: cannot write it: {error.strerror or error}") from None
    return Board(rows, [*refused, *others], _alike(held, list(owners)))


def _best_known(folder: Path, held: Sequence[Held]) -> tuple[dict[str, tuple[Scenario, BestKnown]], dict[Path, bytes]]:
    """Return the best known flights of all scenarios, and the contents of the files of those that submissions improve."""
    before = load_all(folder, [submission.scenario for submission, _ in held])
    after = dict(before)
    for submission, flown in held:
        scenario, known = after[submission.scenario.id]
        after[scenario.id] = scenario, improved(known, submission, flown, today())
    changed = [name for name in after if changes(before[name][1], after[name][1])]
    return after, {path: text for name in changed for path, text in best_known_files(folder, *after[name]).items()}


def _owned(held: Sequence[Held], owners: Owners) -> tuple[list[Held], list[str]]:
    """Return the submissions whose authors own the name, and a line that says why for each of the others."""
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
    """Return a line for each submission that took the same actions as another, of an older name, on all episodes.

    ``names`` are the folders of all names, the oldest name first.
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
    """Return a submission with the records of its replay, or a line that says why it is refused."""
    try:
        submission = load_submission(folder)
        return submission, check(submission)
    except SubmissionError as error:
        return _line(str(error))
    except Exception as error:  # one broken submission must not stop the others
        return _line(f"{folder.parent.name}/{folder.name}: cannot be read: {type(error).__name__}: {error}")


def _line(text: str) -> str:
    """Return text as one short line without control characters: parts of it may come from anybody."""
    seen = "".join(letter if letter.isprintable() else "?" for letter in " ".join(text.split()))
    return seen if len(seen) <= _LONGEST else f"{seen[:_LONGEST]}…"
