"""The leaderboard from a folder of submissions: everything is replayed, what is refused is named, the rest is built."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import joblib  # pyright: ignore[reportMissingTypeStubs]

from uavbench.files import write_whole
from uavbench.leaderboard.page import page_text
from uavbench.leaderboard.ranking import Entry, Row, rank
from uavbench.leaderboard.reruns import load_reruns
from uavbench.leaderboard.submission import MANIFEST, Submission, SubmissionError, check, load_submission
from uavbench.leaderboard.table import table_text


@dataclass(frozen=True)
class Board:
    """What came out: the rows, and what was refused, a line each."""

    rows: list[Row]
    refused: list[str]


def submission_folders(folder: Path) -> list[Path]:
    """Return the submissions in a folder: itself, or those that are one or two levels down.

    Raises
    ------
    SubmissionError
        When there is none.
    """
    root = folder.resolve()  # what is in it is not resolved: a link is found out as one, or by its name
    if (root / MANIFEST).is_file():
        return [root]
    outer = [path for path in sorted(root.glob("*")) if path.is_dir() and not path.name.startswith(".")]
    found = [path for each in outer for path in ([each] if (each / MANIFEST).is_file() else sorted(each.iterdir()))]
    if not found:
        raise SubmissionError(f"{folder}: holds no submissions: folders <name>/<scenario> that uavbench submit wrote")
    return found


def verify(
    folders: Sequence[Path],
    workers: int = 1,
    on_checked: Callable[[Path], None] = lambda folder: None,
) -> tuple[list[Submission], list[str]]:
    """Read and replay submissions; return those that hold, and why the others are refused, a line each."""
    held: list[Submission] = []
    refused: list[str] = []
    parallel: Any = joblib.Parallel(n_jobs=workers, return_as="generator")
    look: Any = cast("Any", joblib).delayed(_look)
    for folder, found in zip(folders, parallel(look(folder) for folder in folders), strict=True):
        if isinstance(found, Submission):
            held.append(found)
        else:
            refused.append(found)
        on_checked(folder)
    return held, refused


def build(submissions: Path, workers: int = 1, on_checked: Callable[[Path], None] = lambda folder: None) -> Board:
    """Replay all submissions, then write ``leaderboard.csv`` and ``index.html`` beside their folder.

    Raises
    ------
    SubmissionError
        When there are no submissions, or only one agent's folder is given. What was there stays then.
    """
    folder = submissions.resolve().parent
    if any((path / MANIFEST).is_file() for path in (submissions, *submissions.glob("*"))):
        raise SubmissionError(f"{submissions}: one agent's submissions: give the folder of all, in which it is")
    held, refused = verify(submission_folders(submissions), workers, on_checked)
    reruns = load_reruns(folder / "reruns.csv")
    entries = [Entry(submission, reruns.get(submission.label)) for submission in held]
    rows = rank(entries)
    write_whole(folder / "leaderboard.csv", table_text(rows).encode())
    write_whole(folder / "index.html", page_text(rows, entries).encode())
    return Board(rows, refused)


def _look(folder: Path) -> Submission | str:
    """Return a submission that holds, or why it does not."""
    try:
        submission = load_submission(folder)
        check(submission)
    except SubmissionError as error:
        return " ".join(str(error).split())
    except Exception as error:  # whatever one submission breaks, the others are built
        return " ".join(f"{folder.parent.name}/{folder.name}: cannot be read: {type(error).__name__}: {error}".split())[:500]
    return submission
