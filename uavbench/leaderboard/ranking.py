"""Who is how good: the rows of the leaderboard, from submissions that have been replayed."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uavbench.agent import TRACKS
from uavbench.evaluate import EpisodeRecord
from uavbench.leaderboard.published import AUTHORS, LINK, NAME, PAPER_SCENARIOS, TABLE_3
from uavbench.leaderboard.reruns import Rerun, actions_digest
from uavbench.leaderboard.submission import Submission
from uavbench.metrics import (
    ROUNDING,
    Interval,
    interquartile_mean,
    mean_interval,
    paired_p_value,
    proportion_interval,
    significant,
)
from uavbench.reference import gaps_of
from uavbench.results import table_of

if TYPE_CHECKING:
    import pandas as pd

#: What stands for all four of the paper's scenarios together.
OVERALL = "overall"
#: How much is known of a score: read in a paper, replayed, or flown again by the agent itself.
TIERS = ("published", "replayed", "rerun")


@dataclass(frozen=True)
class Row:
    """One line of the leaderboard. Scores are fractions; None where there is none.

    Attributes
    ----------
    scenario : str
        Its id, or `OVERALL`.
    track : str
        What the agent saw.
    rank : int, optional
        In its scenario and track; agents whose difference is not significant share one. None for published figures.
    name, authors, link, training : str
        What the submission says of itself.
    tier : str
        One of `TIERS`.
    rerun_episodes : int
        On how many episodes the agent itself took the same actions again.
    episodes : int
        How many it is the mean of.
    landed, cr, cral : Interval
        Published figures have no interval: NaN.
    iqm : float, optional
        Interquartile mean of CRAL.
    steps : float, optional
        Mean of the actions that an episode took.
    decisions_per_second : float, optional
        As measured where it was flown.
    gap_to_best, gap_to_bound : float, optional
        Mean of what CRAL falls short of the best known flight, and of the upper bound, over the episodes that have one.
    compared, bounded : int
        How many have one.
    """

    scenario: str
    track: str
    rank: int | None
    name: str
    authors: str
    link: str
    training: str
    tier: str
    rerun_episodes: int
    episodes: int
    landed: Interval
    cr: Interval
    cral: Interval
    iqm: float | None
    steps: float | None
    decisions_per_second: float | None
    gap_to_best: float | None
    gap_to_bound: float | None
    compared: int
    bounded: int


@dataclass(frozen=True)
class Entry:
    """A submission, what came out when it was replayed, and how much of it the agent has flown again.

    All numbers are of the replay: none is read from the submission.
    """

    submission: Submission
    flown: Sequence[EpisodeRecord]
    rerun: Rerun | None

    @cached_property
    def table(self) -> "pd.DataFrame":
        """Its episodes."""
        return table_of(self.flown)

    def values(self, column: str) -> NDArray[np.float64]:
        """Return a column over the episodes."""
        return self.table[column].to_numpy(np.float64)

    @property
    def rerun_episodes(self) -> int:
        """On how many episodes these very actions were taken again."""
        found, manifest = self.rerun, self.submission.manifest
        same = found and (found.track, found.agent_sha256, found.actions_sha256) == (
            manifest.result.track,
            manifest.result.agent_sha256,
            actions_digest(self.submission),
        )
        return found.episodes if found and same else 0


def rank(entries: Iterable[Entry]) -> list[Row]:
    """Return the rows of all scenarios and the overall ones, best first, published figures among them."""
    found = sorted(entries, key=lambda entry: entry.submission.label)
    rows: list[Row] = []
    for scenario in (OVERALL, *PAPER_SCENARIOS, *sorted({e.submission.scenario.id for e in found} - set(PAPER_SCENARIOS))):
        parts = PAPER_SCENARIOS if scenario == OVERALL else (scenario,)
        for track in TRACKS:
            groups = _complete(found, parts, track)
            ordered = sorted(groups, key=lambda group: -round(_together(group, "cral").mean() / ROUNDING))
            rows += [_row(scenario, number, group) for number, group in zip(_ranks(ordered), ordered, strict=True)]
        if scenario in (OVERALL, *TABLE_3):
            rows.append(_published(scenario, parts))
    return rows


def _complete(entries: Sequence[Entry], scenarios: Sequence[str], track: str) -> list[list[Entry]]:
    """Return the entries of each agent of a track that has all the scenarios, in their order."""
    agents: dict[str, dict[str, Entry]] = {}
    for entry in entries:
        if entry.submission.manifest.result.track == track:
            agents.setdefault(entry.submission.manifest.name, {})[entry.submission.scenario.id] = entry
    return [[there[name] for name in scenarios] for there in agents.values() if all(name in there for name in scenarios)]


def _together(group: Sequence[Entry], column: str) -> NDArray[np.float64]:
    """Return an agent's mean over its scenarios, by number of episode.

    Episodes of one number are drawn from one key: where the budget is long on one map, it is on all. They are not independent,
    and count as one.
    """
    return np.mean([entry.values(column) for entry in group], axis=0)


def _ranks(ordered: Sequence[Sequence[Entry]]) -> list[int]:
    """Return the ranks of agents in the order of their means.

    A new rank begins where everyone above is significantly better than everyone below (paired, Holm-corrected over all pairs):
    so any two whose difference is not significant share one.
    """
    pairs = list(itertools.combinations(range(len(ordered)), 2))
    cral = [_together(group, "cral") for group in ordered]
    apart = dict(zip(pairs, significant([paired_p_value(cral[i] - cral[j]) for i, j in pairs]), strict=True))
    ranks: list[int] = []
    for k in range(len(ordered)):
        splits = all(apart[i, j] for i in range(k) for j in range(k, len(ordered)))
        ranks.append(k + 1 if splits else ranks[-1])
    return ranks


def _row(scenario: str, number: int, group: Sequence[Entry]) -> Row:
    """Return the row of an agent: the mean over its scenarios."""
    first = group[0].submission.manifest
    again = [entry.rerun_episodes for entry in group]
    count = [len(entry.table) for entry in group]
    known = [gaps_of(entry.submission.scenario, entry.table) for entry in group]
    return Row(
        scenario=scenario,
        track=first.result.track,
        rank=number,
        name=first.name,
        authors=", ".join(first.authors),
        link=first.link,
        training=_training(group),
        tier="rerun" if again == count else "replayed",
        rerun_episodes=sum(again),
        episodes=sum(count),
        landed=proportion_interval(_together(group, "landed")),
        cr=mean_interval(_together(group, "cr")),
        cral=mean_interval(_together(group, "cral")),
        iqm=interquartile_mean(np.concatenate([entry.values("cral") for entry in group])),
        steps=float(_together(group, "steps").mean()),
        decisions_per_second=_harmonic([entry.submission.manifest.result.decisions_per_second for entry in group]),
        gap_to_best=_mean([each and each.to_best and each.to_best.mean for each in known]),
        gap_to_bound=_mean([each and each.to_bound and each.to_bound.mean for each in known]),
        compared=sum(each.compared for each in known if each),
        bounded=sum(each.bounded for each in known if each),
    )


def _training(group: Sequence[Entry]) -> str:
    """Return what is said of an agent's training, and of which scenarios where it is not the same of all."""
    said: dict[str, list[str]] = {}
    for entry in group:
        said.setdefault(entry.submission.manifest.training, []).append(entry.submission.scenario.id)
    if len(said) == 1:
        return next(iter(said))
    return "; ".join(f"{', '.join(scenarios)}: {text or 'none'}" for text, scenarios in said.items())


def _published(scenario: str, parts: Sequence[str]) -> Row:
    """Return the row of the paper's figures."""

    def mean(figure: Callable[[str], float]) -> Interval:
        return Interval(float(np.mean([figure(part) for part in parts])), np.nan, np.nan)

    return Row(
        scenario=scenario,
        track="observation",
        rank=None,
        name=NAME,
        authors=AUTHORS,
        link=LINK,
        training="",
        tier="published",
        rerun_episodes=0,
        episodes=1000 * len(parts),
        landed=mean(lambda part: TABLE_3[part].landed),
        cr=mean(lambda part: TABLE_3[part].cr),
        cral=mean(lambda part: TABLE_3[part].cral),
        iqm=None,
        steps=None,
        decisions_per_second=None,
        gap_to_best=None,
        gap_to_bound=None,
        compared=0,
        bounded=0,
    )


def _mean(values: Sequence[float | None]) -> float | None:
    """Return the mean, if all are known."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if len(known) == len(values) else None


def _harmonic(speeds: Sequence[float]) -> float:
    """Return the mean speed over as many decisions of each."""
    return len(speeds) / sum(1 / max(speed, 1e-9) for speed in speeds)
