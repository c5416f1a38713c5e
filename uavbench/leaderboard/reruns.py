"""Which submissions were flown again by their agent: ``reruns.csv`` beside ``submissions/``, kept by who keeps the board.

Replaying proves a score, not who made the actions. When the agent itself is executed again and takes the same actions, that is
written down here, with the digests of both, so that another file of actions is not taken for the one that was compared.
"""

import csv
import hashlib
import io
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np

from uavbench.agent import AgentSource
from uavbench.evaluate import EpisodeRecord, Job, evaluate
from uavbench.files import TABLE_BYTES, FileError, check_writable, read_bounded, read_text, write_whole
from uavbench.leaderboard.submission import LARGEST, Submission, SubmissionError, check


@dataclass(frozen=True)
class Rerun:
    """An agent that took the same actions again.

    Attributes
    ----------
    submission : str
        Its folder, <name>/<scenario>.
    track : str
        What the agent saw.
    agent_sha256, actions_sha256 : str
        Digests of the agent's file and of ``actions.npz``.
    episodes : int
        How many episodes, from 0 on, were flown again.
    """

    submission: str
    track: str
    agent_sha256: str
    actions_sha256: str
    episodes: int


def load_reruns(path: Path) -> dict[str, Rerun]:
    """Read what has been flown again, by submission; nothing when there is no file.

    Raises
    ------
    SubmissionError
        When the file is damaged.
    """
    if not path.exists():
        return {}
    found: dict[str, Rerun] = {}
    reader = None
    try:
        reader = csv.DictReader(read_text(path, TABLE_BYTES).splitlines(), strict=True)
        for row in reader:
            found[row["submission"]] = Rerun(**{**row, "episodes": int(row["episodes"])})  # pyright: ignore[reportArgumentType]
    except FileError as error:
        raise SubmissionError(str(error)) from None
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        where = f" in line {reader.line_num}" if reader else ""
        raise SubmissionError(
            f"{path}: damaged{where} ({error}): take the file as it was before, or delete the line and rerun that agent"
        ) from None
    return found


def check_reruns(path: Path) -> None:
    """Find out before hours of flying whether a rerun can be written down.

    Raises
    ------
    SubmissionError
        When the file is damaged, or cannot be written.
    """
    load_reruns(path)
    try:
        check_writable(path.parent)
    except OSError as error:
        raise SubmissionError(f"{path}: {error.strerror}") from None


def save_rerun(path: Path, rerun: Rerun) -> None:
    """Write down a rerun, in the place of an older one of the same submission, unless that was of more episodes.

    Raises
    ------
    SubmissionError
        When the file is damaged or cannot be written; it is as it was then.
    """
    known = load_reruns(path)
    before = known.get(rerun.submission)
    if before is None or replace(before, episodes=rerun.episodes) != rerun or before.episodes < rerun.episodes:
        known[rerun.submission] = rerun
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(Rerun)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(known[name]) for name in sorted(known))
    try:
        write_whole(path, text.getvalue().encode())
    except OSError as error:
        raise SubmissionError(f"{path}: {error.strerror}: nothing was written") from None


def actions_digest(submission: Submission) -> str:
    """Return the digest of a submission's actions."""
    return hashlib.sha256(read_bounded(submission.folder / "actions.npz", LARGEST["actions.npz"])).hexdigest()


def fly_again(
    submission: Submission,
    source: AgentSource,
    episodes: int,
    workers: int,
    decision_timeout: float,
    on_record: Callable[[EpisodeRecord], None],
) -> Rerun:
    """Execute the agent on the first episodes, and compare every action.

    Raises
    ------
    SubmissionError
        When it is another agent than the submission says, takes another action, or the submission does not hold.
    """
    said = submission.manifest.result
    for field, found in {"track": source.track, "agent_sha256": source.digest(submission.scenario)}.items():
        if getattr(said, field) != found:
            hint = ": another file, or without the --weights it flew with" if field == "agent_sha256" else ""
            raise SubmissionError(f"{submission.label}: {field}: {source.name} has {found}, not {getattr(said, field)}{hint}")
    recorded = [record.actions for record in check(submission)]
    for record in evaluate(Job(source, submission.scenario, "test", decision_timeout), range(episodes), workers):
        if not np.array_equal(record.actions, recorded[record.episode]):
            first = _first_difference(record, recorded[record.episode])
            raise SubmissionError(
                f"{submission.label}: episode {record.episode}: {source.name} acts otherwise from step {first} on"
            )
        on_record(record)
    return Rerun(submission.label, said.track, said.agent_sha256, actions_digest(submission), episodes)


def _first_difference(record: EpisodeRecord, actions: np.ndarray) -> int:
    """Return the step at which two flights part."""
    shared = min(len(record.actions), len(actions))
    other = (record.actions[:shared] != actions[:shared]).any(axis=1)
    return int(other.argmax()) if other.any() else shared
