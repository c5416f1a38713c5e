"""Which submissions their agents have flown again: ``reruns.csv`` beside ``submissions/``, written by the board's maintainer.

A replay proves a score, but not which agent took the actions. When the agent itself is run again and takes the same actions,
``reruns.csv`` records that, with the digests of the agent and of the actions, so that it counts for these alone.

An agent could take the same actions by playing them back: the test episodes and the flights are public. So it also flies fresh
episodes, which nobody has published, drawn from a key that the maintainer chooses. The score on them must agree with the
submitted one, as far as chance allows. An agent on the observation track runs in a process of its own
(`uavbench.agents.apart`).
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
from uavbench.evaluation.crew import Crew, evaluate_with
from uavbench.evaluation.evaluate import EpisodeRecord, Job
from uavbench.evaluation.metrics import variance_of_mean
from uavbench.leaderboard.submission import LARGEST, Submission, SubmissionError, check
from uavbench.world.cities import city_numbers
from uavbench.world.files import TABLE_BYTES, FileError, check_writable, read_bounded, read_text, write_atomic


@dataclass(frozen=True)
class Rerun:
    """A rerun: the agent was run again and took the same actions.

    Attributes
    ----------
    submission : str
        The folder of the submission, <name>/<scenario>.
    track : str
        What the agent saw.
    agent_sha256, actions_sha256 : str
        Digests of the agent's file and of ``actions.npz``.
    episodes : int
        How many episodes, from 0 on, were flown again.
    fresh : int
        How many fresh episodes, which nobody had published, the agent flew; may be 0.
    fresh_key : int
        The key that the fresh episodes were drawn from.
    fresh_cral : float
        The mean CRAL on the fresh episodes, in [0, 1].
    difference, difference_low, difference_high : float
        Mean CRAL on the fresh episodes − mean CRAL on the submitted ones, with its 99 % confidence interval.
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
        """Whether the score on fresh episodes agrees with the submitted one, as far as chance allows; True without them."""
        return self.difference_low <= 0.0 <= self.difference_high


class RerunInterrupted(KeyboardInterrupt):
    """A rerun was interrupted.

    Attributes
    ----------
    rerun : Rerun
        What was compared before the interrupt, from episode 0 on. If its ``episodes`` is 0, there is nothing to record.
    """

    def __init__(self, rerun: Rerun) -> None:
        super().__init__("interrupted")
        self.rerun = rerun


_COUNTS, _FIGURES = ("episodes", "fresh", "fresh_key"), ("fresh_cral", "difference", "difference_low", "difference_high")
_Z = NormalDist().inv_cdf(0.995)
_SAME = ("track", "agent_sha256", "actions_sha256")  # if equal, two reruns are of the same flights by the same agent


def load_reruns(path: Path) -> dict[str, Rerun]:
    """Read the reruns, by submission; empty when there is no file.

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
            f"{path}: damaged{where} ({error}): restore an earlier version of the file, or delete the line and rerun that agent"
        ) from None
    return found


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is no number")
    return value


def check_reruns(path: Path) -> None:
    """Check, before the agent flies for hours, that its rerun can be recorded.

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
    """Record a rerun in place of an older one of the same submission.

    If both are of the same flights by the same agent, the larger number of compared episodes is kept, and the older result on
    fresh episodes if it has more of them.

    Raises
    ------
    SubmissionError
        When the file is damaged or cannot be written. It does not change then.
    """
    known = load_reruns(path)
    before = known.get(rerun.submission)
    of_the_same = before is not None and all(getattr(before, name) == getattr(rerun, name) for name in _SAME)
    if before is not None and of_the_same:
        rerun = replace(rerun, episodes=max(before.episodes, rerun.episodes))
        if rerun.fresh < before.fresh:  # the larger sample is kept, whether it speaks for or against the agent
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
    """Return in words how the score on fresh episodes compares with the submitted one."""
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
    workers: Crew,
    decision_timeout: float,
    on_record: Callable[[EpisodeRecord], None],
    fresh: int = 0,
    key: int | None = None,
) -> Rerun:
    """Run the agent on the first submitted episodes, compare every action, then let it fly fresh episodes.

    Parameters
    ----------
    submission : Submission
    source : AgentSource
        The agent. On the observation track it runs in a process of its own.
    episodes : int
        How many of the submitted episodes the agent flies again.
    workers : int or Cluster
        Processes, or a cluster.
    decision_timeout : float
        Seconds that one decision may take.
    on_record : callable
        Called with the record of every episode, the fresh ones last.
    fresh : int
        How many fresh episodes, which nobody has published, the agent flies.
    key : int, optional
        The key that the fresh episodes are drawn from; random by default.

    Raises
    ------
    SubmissionError
        When it is not the agent that the submission names, when it takes another action, or when the submission is not
        reproduced.
    AgentError, ApartError
        When the agent fails.
    RerunInterrupted
        When the user interrupts.
    """
    said = submission.manifest.result
    source = replace(source, transfer=bool(said.transfer))  # as the submission was flown
    apart = ApartSource.of(source, decision_timeout)
    for field, found in {"track": apart.track, "agent_sha256": source.digest(submission.scenario)}.items():
        if getattr(said, field) != found:
            hint = ": another file, or it flew with --weights that are not given" if field == "agent_sha256" else ""
            raise SubmissionError(f"{submission.label}: {field}: {source.name} has {found}, not {getattr(said, field)}{hint}")
    submitted = check(submission)
    job = Job(apart if apart.track == "observation" else source, submission.scenario, "test", decision_timeout)
    rerun = Rerun(submission.label, said.track, said.agent_sha256, actions_digest(submission), episodes)
    same: set[int] = set()
    secret = secrets.randbits(62) if key is None else key
    flown: list[EpisodeRecord] = []
    try:
        for record in evaluate_with(workers, job, range(episodes)):
            actions = submitted[record.episode].actions
            if not np.array_equal(record.actions, actions):
                first = _first_difference(record, actions)
                raise SubmissionError(
                    f"{submission.label}: episode {record.episode}: {source.name} takes other actions from step {first} on"
                )
            same.add(record.episode)
            on_record(record)
        if not fresh:
            return rerun
        for record in evaluate_with(workers, replace(job, fresh=secret), range(fresh)):
            flown.append(record)
            on_record(record)
    except KeyboardInterrupt:
        raise RerunInterrupted(replace(rerun, episodes=next(n for n in range(episodes + 1) if n not in same))) from None
    cral, before = np.array([record.cral for record in flown]), np.array([record.cral for record in submitted])
    difference = float(cral.mean() - before.mean())
    cities = city_numbers(submission.scenario, "test", np.arange(len(before)))  # fresh episodes have cities of their own
    half = _Z * math.sqrt(_squared_error(cral) + _squared_error(before, cities))
    return replace(
        rerun,
        fresh=fresh,
        fresh_key=secret,
        fresh_cral=float(cral.mean()),
        difference=difference,
        difference_low=difference - half,
        difference_high=difference + half,
    )


def _squared_error(values: NDArray[np.float64], cities: NDArray[np.int64] | None = None) -> float:
    """Return the variance of the mean; at least about that of one value differing by 1, since rare values may not be drawn.

    If episodes take place in many cities, ``cities`` says in which, shape (n,).
    """
    n = len(values)
    plain = max(float(values.var()), 1.0 / n) / n
    return plain if cities is None else max(plain, variance_of_mean(values, cities))


def _first_difference(record: EpisodeRecord, actions: np.ndarray) -> int:
    """Return the first step at which the actions of two flights differ."""
    shared = min(len(record.actions), len(actions))
    other = (record.actions[:shared] != actions[:shared]).any(axis=1)
    return int(other.argmax()) if other.any() else shared
