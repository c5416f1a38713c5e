"""Ranks: ties share one, tracks are apart, the overall score is the mean of four; aggregates agree with rliable."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from uavbench import load_scenario
from uavbench.evaluation.metrics import interquartile_mean, mean_interval, paired_p_value, proportion_interval, significant
from uavbench.evaluation.results import Result
from uavbench.leaderboard.published import PAPER_SCENARIOS
from uavbench.leaderboard.ranking import OVERALL, Entry, rank
from uavbench.leaderboard.reruns import Rerun
from uavbench.leaderboard.submission import Manifest, Submission, Summary
from uavbench.leaderboard.table import COLUMNS, table_text

RANDOM = np.random.default_rng(7)
BASE = {name: RANDOM.random(1000) for name in PAPER_SCENARIOS}


def entry(name, scenario, cral, track="state", folder=None, training="", known_by="rerun"):
    """An entry of made-up scores, in which every episode landed."""
    table = pd.DataFrame({"episode": range(1000), "landed": 1, "cr": cral, "cral": cral, "steps": 50})
    told = {"agent": name, "agent_sha256": "", "decisions_per_second": 100.0, "split": "test", "scenario": scenario}
    said = Summary.model_construct(track=track, **told)
    manifest = Manifest.model_construct(name=name, authors=("A",), training=training, result=said)
    made = Entry(Submission(folder, manifest, Result(folder, {}), load_scenario(scenario)), [], None)
    made.__dict__.update(table=table, track_known_by=known_by)
    return made


@pytest.fixture(autouse=True)
def _labels(monkeypatch):
    monkeypatch.setattr(Submission, "label", property(lambda self: f"{self.manifest.name}/{self.scenario.id}"))


def agent(name, gain, noise=0.05, scenarios=PAPER_SCENARIOS, track="state"):
    random = np.random.default_rng(len(name) + int(1000 * gain))
    return [entry(name, each, 0.5 * BASE[each] + gain + noise * random.standard_normal(1000), track) for each in scenarios]


def ranks(rows, scenario, track="state"):
    return {row.name: row.rank for row in rows if row.scenario == scenario and row.track == track and row.rank is not None}


def test_agents_are_ranked_by_cral_and_ties_share_a_rank():
    rows = rank([*agent("worst", 0.1), *agent("good", 0.3), *agent("better", 0.3002), *agent("best", 0.4)])
    for scenario in (OVERALL, *PAPER_SCENARIOS):
        assert ranks(rows, scenario) == {"best": 1, "good": 2, "better": 2, "worst": 4}
        scores = [row.cral.mean for row in rows if row.scenario == scenario and row.rank]
        assert scores == sorted(scores, reverse=True)


def test_tracks_are_apart_and_overall_needs_all_four_scenarios():
    rows = rank(
        [*agent("all", 0.3), *agent("half", 0.4, scenarios=PAPER_SCENARIOS[:2]), *agent("blind", 0.1, track="observation")]
    )
    assert ranks(rows, OVERALL) == {"all": 1}
    assert ranks(rows, OVERALL, "observation") == {"blind": 1}
    assert ranks(rows, PAPER_SCENARIOS[0]) == {"half": 1, "all": 2}
    overall = next(row for row in rows if row.scenario == OVERALL and row.name == "all")
    means = [row.cral.mean for row in rows if row.name == "all" and row.scenario != OVERALL]
    assert overall.cral.mean == pytest.approx(np.mean(means), abs=1e-12)
    assert overall.episodes == 4000


def test_a_claimed_track_has_no_rank_and_changes_no_other():
    """On the observation track: who sees the state sees everything, and claims nothing."""
    claimed = agent("claimed", 0.5, track="observation")
    for each in claimed[1:]:
        each.__dict__["track_known_by"] = "claim"
    others = [*agent("best", 0.4, track="observation"), *agent("good", 0.3, track="observation")]
    rows = rank([*claimed, *others])
    first = PAPER_SCENARIOS[0]
    assert ranks(rows, first, "observation") == {"claimed": 1, "best": 2, "good": 3}
    for scenario in (OVERALL, *PAPER_SCENARIOS[1:]):
        assert ranks(rows, scenario, "observation") == {"best": 1, "good": 2}
        shown = [row for row in rows if row.scenario == scenario and row.tier != "published"]
        assert [(row.name, row.track_known_by) for row in shown] == [("claimed", "claim"), ("best", "rerun"), ("good", "rerun")]
        assert "is a claim, until the agent is run again: " in shown[0].note
        assert shown[1].note == ""
    for each in claimed:
        each.submission.manifest.result.__dict__["track"] = "state"
    assert ranks(rank([*claimed, *others]), OVERALL) == {"claimed": 1}


def test_a_score_that_fresh_episodes_contradict_has_no_rank(monkeypatch):
    monkeypatch.setattr("uavbench.leaderboard.ranking.actions_digest", lambda submission: "2")
    entries = [*agent("copy", 0.5), *agent("good", 0.3)]
    entries[0] = replace(entries[0], rerun=Rerun("copy/x", "state", "", "2", 1000, 200, 1, 0.4, -0.3, -0.4, -0.2))
    entries[0].__dict__["table"] = pd.DataFrame(
        dict.fromkeys(("landed", "cr", "cral", "steps", "episode"), BASE[PAPER_SCENARIOS[0]])
    )
    rows = rank(entries)
    assert ranks(rows, PAPER_SCENARIOS[0]) == ranks(rows, OVERALL) == {"good": 1}
    row = next(row for row in rows if row.name == "copy" and row.scenario == PAPER_SCENARIOS[0])
    assert (row.tier, row.fresh_episodes, row.fresh_difference.mean) == ("replayed", 200, -0.3)
    assert "CRAL 40.00 on 200 fresh episodes DOES NOT AGREE with the submitted one: -30.00 [-40.00, -20.00]" in row.note


def test_what_is_said_of_training_stands_by_scenario_where_it_differs():
    def overall(*said):
        entries = [entry("a", name, BASE[name], training=text) for name, text in zip(PAPER_SCENARIOS, said, strict=True)]
        return next(row.training for row in rank(entries) if row.scenario == OVERALL)

    first, second, third, fourth = PAPER_SCENARIOS
    assert overall(*["seed 0"] * 4) == "seed 0"
    assert overall("seed 0", "seed 1", "", "seed 0") == f"{first}, {fourth}: seed 0; {second}: seed 1; {third}: none"


def test_any_two_whose_difference_is_not_significant_share_a_rank():
    one = PAPER_SCENARIOS[:1]
    entries = list(itertools.chain(*(agent(f"a{k}", 0.3 + 0.0005 * k * k, 0.02, one) for k in range(8))))
    rows = [row for row in rank(entries) if row.scenario == PAPER_SCENARIOS[0] and row.rank]
    values = {
        each.submission.manifest.name: each.values("cral")
        for each in entries
        if each.submission.scenario.id == PAPER_SCENARIOS[0]
    }
    pairs = list(itertools.combinations([row.name for row in rows], 2))
    apart = significant([paired_p_value(values[a] - values[b]) for a, b in pairs])
    number = {row.name: row.rank for row in rows}
    assert any(apart)
    assert not all(apart)
    assert 1 < len(set(number.values())) < 8
    for (a, b), found in zip(pairs, apart, strict=True):
        assert found or number[a] == number[b]


def test_the_papers_figures_stand_beside_without_a_rank():
    rows = [row for row in rank(agent("a", 0.1)) if row.tier == "published"]
    assert [row.scenario for row in rows] == [OVERALL, *PAPER_SCENARIOS]
    assert rows[0].cral.mean == pytest.approx(np.mean([0.703, 0.801, 0.825, 0.742]))
    assert all(row.rank is None and math.isnan(row.cral.low) for row in rows)


def test_the_same_rows_give_the_same_text_and_text_cannot_be_a_formula():
    rows = rank(agent("a", 0.1))
    assert table_text(rows) == table_text(rank(agent("a", 0.1)))
    lines = table_text([replace(rows[0], training='=cmd|"x"!A1', gap_to_bound=-1e-9)]).splitlines()
    assert lines[0].split(",") == list(COLUMNS)
    assert "'=cmd" in lines[1]
    assert lines[1].endswith(",0.00,4000,3212,")


# Statistics.


@pytest.mark.parametrize("count", [8, 10, 997, 1000])
def test_iqm_and_its_kin_agree_with_rliable(count):
    metrics = pytest.importorskip("rliable.metrics", reason="rliable is the oracle: pip install 'uavbench[dev]'")
    scores = np.random.default_rng(count).random((count, 4))
    assert interquartile_mean(scores) == pytest.approx(metrics.aggregate_iqm(scores), abs=1e-12)


def overall(entries):
    return next(row for row in rank(entries) if row.scenario == OVERALL and row.rank == 1)


def test_episodes_of_one_number_count_as_one_over_scenarios():
    values, landed = RANDOM.random(1000), RANDOM.random(1000) < 0.9
    entries = [entry("a", name, values) for name in PAPER_SCENARIOS]
    for each in entries:
        each.table["landed"] = landed
    found, alone = overall(entries), mean_interval(values)
    assert (found.cral.low, found.cral.high) == pytest.approx((alone.low, alone.high))
    assert found.landed == proportion_interval(landed)
    assert found.episodes == 4000


def test_the_overall_interval_is_that_of_the_mean_however_scenarios_depend():
    common = RANDOM.random(1000)
    for weight in (0.0, 0.5, 1.0):
        scores = [0.8 * (weight * common + (1 - weight) * RANDOM.random(1000)) for _ in PAPER_SCENARIOS]
        found = overall([entry("a", name, values) for name, values in zip(PAPER_SCENARIOS, scores, strict=True)]).cral
        covariance = np.cov(scores) / 1000
        assert found.mean == pytest.approx(np.mean(scores))
        assert (found.high - found.low) / 2 == pytest.approx(1.96 * math.sqrt(covariance.sum()) / 4, rel=0.04)


def test_overall_ties_count_episodes_of_one_number_once():
    gain = 0.05 * RANDOM.standard_normal(1000)
    gain += 0.0025 - gain.mean()  # 1.6 standard errors of 1,000 episodes, 3.2 of 4,000
    entries = [entry(name, each, BASE[each] + add) for name, add in (("a", gain), ("b", 0.0)) for each in PAPER_SCENARIOS]
    assert ranks(rank(entries), OVERALL) == {"a": 1, "b": 1}


def test_p_values_are_those_of_the_paired_t_test_for_many_episodes():
    stats = pytest.importorskip("scipy.stats", reason="SciPy is the oracle")
    random = np.random.default_rng(5)
    for gain in (0.0, 0.005, 0.02):
        first, second = random.random(1000) + gain, random.random(1000)
        assert paired_p_value(first - second) == pytest.approx(stats.ttest_rel(first, second).pvalue, abs=0.001)
    assert paired_p_value(np.zeros(10)) == 1.0
    assert paired_p_value(np.ones(10)) == 0.0
    last_digit = np.zeros(1000)
    last_digit[:30] = 1e-12
    assert paired_p_value(last_digit) == 1.0


def test_holm_rejects_step_by_step():
    assert significant([0.01, 0.04, 0.03, 0.005]) == [True, False, False, True]
    assert significant([0.04]) == [True]
    assert significant([0.03, 0.03]) == [False, False]
    assert significant([0.0, 0.049]) == [True, True]
    assert significant([]) == []
