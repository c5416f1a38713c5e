"""Which submissions were flown again by their agent: ``reruns.csv`` beside ``submissions/``, kept by who keeps the board.

Replaying proves a score, not who made the actions. When the agent itself is executed again and takes the same actions, that is
written down here, with the digests of both, so that another file of actions is not taken for the one that was compared.

An agent can take the same actions because it plays them back: the test episodes are public, and so are the flights. So it also
flies episodes that nobody has published, drawn from a key that whoever reruns it chooses; the score there must be the same, as
far as chance allows. An agent on the observation track does all that in a process of its own (`uavbench.agents.apart`).
"""

import csv
import hashlib
import io
import math
import secrets
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from uavbench.agents.agent import AgentSource
from uavbench.agents.apart import ApartSource
from uavbench.evaluation.evaluate import EpisodeRecord, Job, evaluate
from uavbench.leaderboard.submission import LARGEST, Submission, SubmissionError, check
from uavbench.world.files import TABLE_BYTES, FileError, check_writable, read_bounded, read_text, write_atomic


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
    fresh : int
        How many episodes were flown that nobody had published; 0 for none.
    fresh_key : int
        The key that they were drawn from.
    fresh_cral : float
        Their mean CRAL, in [0, 1].
    difference, difference_low, difference_high : float
        Fresh − submitted mean CRAL, with its 99 % confidence interval.
    """

    submission: str
    track: str
    agent_sha256: str
    actions_sha256: str
    episodes: int
    fresh: int = 0
    fresh_key: int = 0
    fresh_cral: float = 0.0
    difference: float = 0.0
    difference_low: float = 0.0
    difference_high: float = 0.0

    @property
    def agrees(self) -> bool:
        """Whether the score on fresh episodes is the submitted one, as far as chance allows; True where there are none."""
        return self.difference_low <= 0.0 <= self.difference_high


class RerunInterrupted(KeyboardInterrupt):
    """A rerun was interrupted.

    Attributes
    ----------
    rerun : Rerun
        What had been compared, from episode 0 on; of 0 episodes where there is nothing to write down.
    """

    def __init__(self, rerun: Rerun) -> None:
        super().__init__("interrupted")
        self.rerun = rerun


_COUNTS, _FIGURES = ("episodes", "fresh", "fresh_key"), ("fresh_cral", "difference", "difference_low", "difference_high")
_Z = NormalDist().inv_cdf(0.995)
_SAME = ("track", "agent_sha256", "actions_sha256")  # of two reruns of the same flights by the same agent


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
            numbers = {name: int(row[name]) for name in _COUNTS if name in row}
            numbers |= {name: _finite(row[name]) for name in _FIGURES if name in row}
            found[row["submission"]] = Rerun(**{**row, **numbers})  # pyright: ignore[reportArgumentType]
    except FileError as error:
        raise SubmissionError(str(error)) from None
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        where = f" in line {reader.line_num}" if reader else ""
        raise SubmissionError(
            f"{path}: damaged{where} ({error}): take the file as it was before, or delete the line and rerun that agent"
        ) from None
    return found


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is no number")
    return value


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
    """Write down a rerun, in the place of an older one of the same submission; of two, the one of more episodes counts.

    Raises
    ------
    SubmissionError
        When the file is damaged or cannot be written; it is as it was then.
    """
    known = load_reruns(path)
    before = known.get(rerun.submission)
    of_the_same = before is not None and all(getattr(before, name) == getattr(rerun, name) for name in _SAME)
    if before is not None and of_the_same:
        rerun = replace(rerun, episodes=max(before.episodes, rerun.episodes))
        if rerun.fresh < before.fresh:  # more fresh episodes say more, be they for or against the agent
            rerun = replace(before, episodes=rerun.episodes)
    known[rerun.submission] = rerun
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(Rerun)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(known[name]) for name in sorted(known))
    try:
        write_atomic(path, text.getvalue().encode())
    except OSError as error:
        raise SubmissionError(f"{path}: {error.strerror}: nothing was written") from None


def fresh_text(rerun: Rerun) -> str:
    """Return in words how the fresh episodes went."""
    low, high = (f"{100 * value:+.2f}" for value in (rerun.difference_low, rerun.difference_high))
    verdict = "agrees" if rerun.agrees else "DOES NOT AGREE"
    score = f"CRAL {100 * rerun.fresh_cral:.2f} on {rerun.fresh} fresh episodes"
    return f"{score} {verdict} with the submitted one: {100 * rerun.difference:+.2f} [{low}, {high}]"


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
    fresh: int = 0,
    key: int | None = None,
) -> Rerun:
    """Execute the agent on the first episodes, compare every action, and let it fly fresh ones.

    Parameters
    ----------
    submission : Submission
    source : AgentSource
        The agent. On the observation track it runs in a process of its own.
    episodes : int
        How many of the submitted episodes it flies again.
    workers : int
        Processes.
    decision_timeout : float
        Seconds that one decision may take.
    on_record : callable
        Called with the record of every episode, the fresh ones last.
    fresh : int
        How many episodes it flies that nobody has published.
    key : int, optional
        What these are drawn from; by default a random number.

    Raises
    ------
    SubmissionError
        When it is another agent than the submission says, takes another action, or the submission does not hold.
    AgentError, ApartError
        When the agent fails.
    RerunInterrupted
        When the user interrupts.
    """
    said = submission.manifest.result
    source = replace(source, transfer=bool(said.transfer))  # as it flew
    apart = ApartSource.of(source, decision_timeout)
    for field, found in {"track": apart.track, "agent_sha256": source.digest(submission.scenario)}.items():
        if getattr(said, field) != found:
            hint = ": another file, or without the --weights it flew with" if field == "agent_sha256" else ""
            raise SubmissionError(f"{submission.label}: {field}: {source.name} has {found}, not {getattr(said, field)}{hint}")
    submitted = check(submission)
    job = Job(apart if apart.track == "observation" else source, submission.scenario, "test", decision_timeout)
    rerun = Rerun(submission.label, said.track, said.agent_sha256, actions_digest(submission), episodes)
    same: set[int] = set()
    secret = secrets.randbits(62) if key is None else key
    flown: list[EpisodeRecord] = []
    try:
        for record in evaluate(job, range(episodes), workers):
            actions = submitted[record.episode].actions
            if not np.array_equal(record.actions, actions):
                first = _first_difference(record, actions)
                raise SubmissionError(
                    f"{submission.label}: episode {record.episode}: {source.name} acts otherwise from step {first} on"
                )
            same.add(record.episode)
            on_record(record)
        if not fresh:
            return rerun
        for record in evaluate(replace(job, fresh=secret), range(fresh), workers):
            flown.append(record)
            on_record(record)
    except KeyboardInterrupt:
        raise RerunInterrupted(replace(rerun, episodes=next(n for n in range(episodes + 1) if n not in same))) from None
    cral, before = np.array([record.cral for record in flown]), np.array([record.cral for record in submitted])
    difference = float(cral.mean() - before.mean())
    half = _Z * math.sqrt(_squared_error(cral) + _squared_error(before))
    return replace(
        rerun,
        fresh=fresh,
        fresh_key=secret,
        fresh_cral=float(cral.mean()),
        difference=difference,
        difference_low=difference - half,
        difference_high=difference + half,
    )


def _squared_error(values: NDArray[np.float64]) -> float:
    """Return the variance of the values' mean: at least as if one of them differed, as a rare one may be missing."""
    n = len(values)
    return max(float(values.var()), 1.0 / n) / n


def _first_difference(record: EpisodeRecord, actions: np.ndarray) -> int:
    """Return the step at which two flights part."""
    shared = min(len(record.actions), len(actions))
    other = (record.actions[:shared] != actions[:shared]).any(axis=1)
    return int(other.argmax()) if other.any() else shared
