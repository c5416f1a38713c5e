"""The ranking: computes the rows of the leaderboard from replayed submissions."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uavbench.agents.agent import TRACKS
from uavbench.evaluation.evaluate import EpisodeRecord
from uavbench.evaluation.metrics import (
    ROUNDING,
    Interval,
    interquartile_mean,
    mean_interval,
    paired_p_value,
    proportion_interval,
    significant,
)
from uavbench.evaluation.reference import SPLIT, gaps_of
from uavbench.evaluation.results import table_of
from uavbench.leaderboard.claims import is_built_in
from uavbench.leaderboard.flown import Safety
from uavbench.leaderboard.published import AUTHORS, LINK, NAME, PAPER_SCENARIOS, TABLE_3
from uavbench.leaderboard.reruns import Rerun, actions_digest, fresh_text
from uavbench.leaderboard.submission import Submission
from uavbench.world.cities import city_numbers

if TYPE_CHECKING:
    import pandas as pd

#: Stands in place of a scenario's id for the paper's four scenarios together.
OVERALL = "overall"
#: How a score is known: it was taken from a paper, it was replayed, or the agent itself flew it again.
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
    track_known_by : str
        How that is known: "built-in" (an agent that comes with uavbench), "rerun", "published", or "claim": nobody knows.
    rank : int, optional
        The rank in its scenario and track. Agents whose difference is not significant share one. None for published figures,
        and where ``note`` says why.
    name, authors, link, method, training : str
        What the submission says about itself.
    tier : str
        One of `TIERS`.
    rerun_episodes : int
        The number of episodes on which the agent itself took the same actions again.
    fresh_episodes : int
        The number of fresh episodes, which nobody had published, that the agent flew in addition.
    fresh_difference : Interval, optional
        Mean CRAL on fresh episodes − mean CRAL on the submitted ones, with its 99 % confidence interval. None without fresh
        episodes, and overall.
    note : str
        Why the agent has no rank; empty if it has one, and for published figures.
    episodes : int
        The number of episodes that the scores are means of.
    landed, cr, cral : Interval
        With 95 % confidence intervals, which are NaN for published figures.
    iqm : float, optional
        The interquartile mean of CRAL.
    steps : float, optional
        The mean number of actions in an episode.
    decisions_per_second : float, optional
        As the submission claims: a replay cannot reproduce times.
    gap_to_best, gap_to_bound : float, optional
        How far CRAL is below the best known score, and below the upper bound: means over the episodes for which that is known.
    compared, bounded : int
        The numbers of these episodes.
    safety : tuple of Safety
        How many of its flights a simulated quadrotor survives, by speed; empty if they were not flown, or not in each scenario.
    """

    scenario: str
    track: str
    track_known_by: str
    rank: int | None
    name: str
    authors: str
    link: str
    method: str
    training: str
    tier: str
    rerun_episodes: int
    fresh_episodes: int
    fresh_difference: Interval | None
    note: str
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
    safety: tuple[Safety, ...] = ()


@dataclass(frozen=True)
class Entry:
    """A submission, the records of its replay, its rerun by the agent itself, if there is one, and what physics does to it.

    All scores are those of the replay: none is read from the submission.
    """

    submission: Submission
    flown: Sequence[EpisodeRecord]
    rerun: Rerun | None
    safety: tuple[Safety, ...] = ()

    @cached_property
    def table(self) -> "pd.DataFrame":
        """Its episodes."""
        return table_of(self.flown)

    def values(self, column: str) -> NDArray[np.float64]:
        """Return a column over the episodes."""
        return self.table[column].to_numpy(np.float64)

    @cached_property
    def confirmed(self) -> Rerun | None:
        """The rerun, if its actions, agent and track are those of this submission; else None."""
        found, manifest = self.rerun, self.submission.manifest
        same = found and (found.track, found.agent_sha256, found.actions_sha256) == (
            manifest.result.track,
            manifest.result.agent_sha256,
            actions_digest(self.submission),
        )
        return found if same else None

    @property
    def contradicted(self) -> bool:
        """Whether the agent's score on fresh episodes does not agree with the submitted one."""
        return self.confirmed is not None and not self.confirmed.agrees

    @property
    def rerun_episodes(self) -> int:
        """The number of episodes on which the agent took these actions again."""
        return self.confirmed.episodes if self.confirmed else 0

    @cached_property
    def track_known_by(self) -> str:
        """How it is known what the agent saw, as in `Row`."""
        if self.rerun_episodes == len(self.table) and not self.contradicted:
            return "rerun"
        return "built-in" if is_built_in(self.submission) else "claim"


def rank(entries: Iterable[Entry]) -> list[Row]:
    """Return all rows, the overall ones first: for each scenario and track the best agent first, then the published figures."""
    found = sorted(entries, key=lambda entry: entry.submission.label)
    rows: list[Row] = []
    for scenario in (OVERALL, *PAPER_SCENARIOS, *sorted({e.submission.scenario.id for e in found} - set(PAPER_SCENARIOS))):
        parts = PAPER_SCENARIOS if scenario == OVERALL else (scenario,)
        for track in TRACKS:
            groups = _complete(found, parts, track)
            ordered = sorted(groups, key=lambda group: -round(_together(group, "cral").mean() / ROUNDING))
            ranked = [group for group in ordered if not _why_unranked(group)]
            ranks = {id(group): number for number, group in zip(_ranks(ranked), ranked, strict=True)}
            rows += [_row(scenario, ranks.get(id(group)), group) for group in ordered]
        if scenario in (OVERALL, *TABLE_3):
            rows.append(_published(scenario, parts))
    return rows


def _complete(entries: Sequence[Entry], scenarios: Sequence[str], track: str) -> list[list[Entry]]:
    """Return, for each agent of a track that has an entry on every scenario, its entries in the order of the scenarios."""
    agents: dict[str, dict[str, Entry]] = {}
    for entry in entries:
        if entry.submission.manifest.result.track == track:
            agents.setdefault(entry.submission.manifest.name, {})[entry.submission.scenario.id] = entry
    return [[there[name] for name in scenarios] for there in agents.values() if all(name in there for name in scenarios)]


def _together(group: Sequence[Entry], column: str) -> NDArray[np.float64]:
    """Return an agent's means over its scenarios, one for each episode number.

    Episodes with the same number are drawn from the same key: where the budget is long on one map, it is long on all. So they
    are not independent, and count as one episode.
    """
    return np.mean([entry.values(column) for entry in group], axis=0)


def _cities(group: Sequence[Entry]) -> NDArray[np.int64] | None:
    """Return the city of each episode, if the agent flew in one scenario and it has many cities."""
    return city_numbers(group[0].submission.scenario, SPLIT, group[0].table["episode"].to_numpy()) if len(group) == 1 else None


def _ranks(ordered: Sequence[Sequence[Entry]]) -> list[int]:
    """Return the ranks of agents in the order of their means.

    A new rank begins where every agent above is significantly better than every agent below (paired, Holm-corrected over all
    pairs). So any two agents whose difference is not significant share a rank.
    """
    pairs = list(itertools.combinations(range(len(ordered)), 2))
    cral = [_together(group, "cral") for group in ordered]
    cities = _cities(ordered[0]) if ordered else None
    tests = [paired_p_value(cral[i] - cral[j], clusters=cities) for i, j in pairs]
    apart = dict(zip(pairs, significant(tests), strict=True))
    ranks: list[int] = []
    for k in range(len(ordered)):
        splits = all(apart[i, j] for i in range(k) for j in range(k, len(ordered)))
        ranks.append(k + 1 if splits else ranks[-1])
    return ranks


def _why_unranked(group: Sequence[Entry]) -> str:
    """Return why an agent has no rank; an empty text if it may have one."""
    for entry in group:
        if entry.confirmed and entry.contradicted:
            return f"not ranked: {entry.submission.scenario.id}: {fresh_text(entry.confirmed)}"
    claimed = [entry.submission.scenario.id for entry in group if entry.track_known_by == "claim"]
    if group[0].submission.manifest.result.track == "observation" and claimed:
        return f"not ranked: that it sees the observation alone is a claim, until the agent is run again: {', '.join(claimed)}"
    return ""


def _row(scenario: str, number: int | None, group: Sequence[Entry]) -> Row:
    """Return the row of an agent: its means over its scenarios."""
    first = group[0].submission.manifest
    known_by = {entry.track_known_by for entry in group}
    reruns = [entry.confirmed for entry in group if entry.confirmed]
    apart = reruns[0] if len(group) == 1 and reruns and reruns[0].fresh else None
    count = [len(entry.table) for entry in group]
    known = [gaps_of(entry.submission.scenario, entry.table) for entry in group]
    cities = _cities(group)
    return Row(
        scenario=scenario,
        track=first.result.track,
        track_known_by=next(each for each in ("claim", "built-in", "rerun") if each in known_by),
        rank=number,
        name=first.name,
        authors=", ".join(first.authors),
        link=first.link,
        method=_said(group, "method"),
        training=_said(group, "training"),
        tier="rerun" if known_by == {"rerun"} else "replayed",
        rerun_episodes=sum(entry.rerun_episodes for entry in group),
        fresh_episodes=sum(rerun.fresh for rerun in reruns),
        fresh_difference=apart and Interval(apart.difference, apart.difference_low, apart.difference_high),
        note=_why_unranked(group),
        episodes=sum(count),
        landed=proportion_interval(_together(group, "landed"), clusters=cities),
        cr=mean_interval(_together(group, "cr"), clusters=cities),
        cral=mean_interval(_together(group, "cral"), clusters=cities),
        iqm=interquartile_mean(np.concatenate([entry.values("cral") for entry in group])),
        steps=float(_together(group, "steps").mean()),
        decisions_per_second=_harmonic([entry.submission.manifest.result.decisions_per_second for entry in group]),
        gap_to_best=_mean([each and each.to_best and each.to_best.mean for each in known]),
        gap_to_bound=_mean([each and each.to_bound and each.to_bound.mean for each in known]),
        compared=sum(each.compared for each in known if each),
        bounded=sum(each.bounded for each in known if each),
        safety=_safety(group),
    )


def _safety(group: Sequence[Entry]) -> tuple[Safety, ...]:
    """Return how many flights are safe at each speed that was flown in all scenarios."""
    found = [{each.speed: each for each in entry.safety} for entry in group]
    speeds = sorted(set(found[0]).intersection(*found[1:]))
    return tuple(Safety(v, sum(each[v].safe for each in found), sum(each[v].flown for each in found)) for v in speeds)


def _said(group: Sequence[Entry], field: str) -> str:
    """Return what the manifests say in a field about an agent; if that differs between scenarios, with their ids."""
    said: dict[str, list[str]] = {}
    for entry in group:
        said.setdefault(getattr(entry.submission.manifest, field), []).append(entry.submission.scenario.id)
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
        track_known_by="published",
        rank=None,
        name=NAME,
        authors=AUTHORS,
        link=LINK,
        method="policy",
        training="",
        tier="published",
        rerun_episodes=0,
        fresh_episodes=0,
        fresh_difference=None,
        note="",
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
    """Return the mean of the values, or None if one of them is None."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if len(known) == len(values) else None


def _harmonic(speeds: Sequence[float]) -> float:
    """Return the harmonic mean: the mean speed when each scenario has the same number of decisions."""
    return len(speeds) / sum(1 / max(speed, 1e-9) for speed in speeds)
