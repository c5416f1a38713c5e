"""What is known of test episodes: read and written to the last bit, improved by replayed results only, and compared with."""

import math
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.reference import (
    Known,
    bounded,
    gaps,
    gaps_of,
    improved,
    load_reference,
    reference_path,
    save_reference,
)
from uavbench.evaluation.results import ResultError
from uavbench.evaluation.run import run
from uavbench.world.resources import scenario_paths

CPP, DH = load_scenario("Block8-CPP-v0"), load_scenario("Block8-DH-v0")
N = 20


def fly(agent, folder, scenario=CPP, split="test"):
    return run(Job(find_agent(agent), scenario, split), N, folder)


@pytest.fixture
def own(tmp_path):
    """A scenario of one's own, to which a reference can be given."""
    source = scenario_paths()["Block8-CPP-v0"]
    folder = tmp_path / "own"
    shutil.copytree(source.parent / "maps", folder / "maps")
    shutil.copytree(source.parent / "episodes", folder / "episodes")
    shutil.copy(source, folder)
    return load_scenario(folder / source.name)


def test_what_is_written_is_read_to_the_last_bit(tmp_path):
    path = tmp_path / "new" / "known.csv"
    known = {
        3: Known(3, 1 / 3, "cuts", 20.0, 0.1 + 0.2, "me, myself", False),
        0: Known(0, 0.7, "reach", 0.5, 0.7, "greedy", True),
        5: Known(5, best_known=0.25, agent="tsp"),
        7: Known(7, 2 / 3, "cuts", 1.5),
    }
    save_reference(path, CPP, known)
    found = load_reference(path, CPP)
    assert list(found) == [0, 3, 5, 7]
    assert repr(found) == repr(dict(sorted(known.items())))  # by their text, as NaN differs from itself
    save_reference(path, CPP, found)
    assert path.read_text().splitlines()[0].startswith("episode,upper_bound,")
    assert load_reference(tmp_path / "none.csv", CPP) == {}


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("episode,", "number,", "columns"),
        ("0.5", "1.5", "1.5 is not in"),
        ("0.5", "nan", "nan is not in"),
        ("0.5", "half", "half"),
        ("\n0,", "\n1,", "episode 1"),
        ("\n0,", "\n1000,", "episode 1000"),
        ("\n0,", "\n-1,", "episode -1"),
        (CPP.digest[:12], "0" * 12, "scenario_digest"),
        (",1," + CPP.digest[:12] + "\n", "\n", "damaged"),
        ("20", "", "damaged"),
    ],
)
def test_a_damaged_file_is_refused_with_its_name_and_the_reason(old, new, reason, tmp_path):
    path = tmp_path / "known.csv"
    save_reference(path, CPP, {0: Known(0, 0.5, "cuts", 20.0, 0.5, "greedy", True), 1: Known(1, 0.75, "cuts", 20.0)})
    load_reference(path, CPP)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(ResultError, match=reason) as error:
        load_reference(path, CPP)
    assert str(path) in str(error.value)


def test_the_lower_bound_counts_and_meets_the_best_known():
    known = bounded(Known(0, best_known=0.5, agent="greedy"), CPP, 0.8, "reach", 1.0)
    assert (known.upper_bound, known.method, known.seconds, known.proved_optimal) == (0.8, "reach", 1.0, False)
    lower = bounded(known, CPP, 0.5, "cuts", 20.0)
    assert (lower.upper_bound, lower.method, lower.seconds, lower.proved_optimal) == (0.5, "cuts", 20.0, True)
    assert bounded(lower, CPP, 0.6, "cuts", 5.0) == lower
    # What is expected can be exceeded by luck: that proves nothing.
    assert not bounded(Known(0, best_known=0.9, agent="tsp"), DH, 0.8, "flow", 20.0).proved_optimal


def test_results_improve_what_is_known(tmp_path):
    greedy, random = fly("greedy", tmp_path), fly("random", tmp_path)
    known = improved({0: Known(0, 1.0, "reach", 20.0)}, CPP, [random])
    assert list(known) == list(range(N))
    both = improved(known, CPP, [greedy])
    assert repr(both) == repr(improved({0: Known(0, 1.0, "reach", 20.0)}, CPP, [random, greedy]))
    best = np.maximum(greedy.episodes()["cral"], random.episodes()["cral"])
    assert [k.best_known for k in both.values()] == best.tolist()
    assert {k.agent for k in both.values()} <= {"greedy", "random"}
    assert both[0].proved_optimal == (best[0] == 1.0)
    assert improved(both, CPP, [random]) == both


def test_what_another_platform_rounds_otherwise_is_no_record(tmp_path):
    """In DH a replay accepts differences of up to 1e-6, so a score that is higher by less is not a better one."""
    result = fly("greedy", tmp_path, DH)
    cral, moved = result.episodes()["cral"].to_numpy(), DH.model_copy(update={"path": tmp_path / "moved.toml"})
    less = np.where(np.arange(N) < 3, 2e-6, 9e-7)
    known = {k: Known(k, best_known=cral[k] - less[k], agent="random") for k in range(N)}
    assert [k.agent for k in improved(known, DH, [result]).values()] == ["greedy"] * 3 + ["random"] * (N - 3)
    save_reference(reference_path(moved), DH, {k: each for k, each in known.items() if each.best_known > 0})
    assert gaps_of(moved, result.episodes()).better == (cral[:3] > 0).sum() > 0


def test_every_target_counts_in_coverage(tmp_path):
    """CPP is exact on every platform."""
    result = fly("greedy", tmp_path)
    known = {k: Known(k, best_known=cral - 1e-9, agent="random") for k, cral in enumerate(result.episodes()["cral"])}
    assert {k.agent for k in improved(known, CPP, [result]).values()} == {"greedy"}


def test_a_result_that_is_not_reproduced_improves_nothing(tmp_path):
    result = fly("greedy", tmp_path)
    path = result.folder / "episodes.csv"
    lines = path.read_text().splitlines()
    cells = lines[1].split(",")
    cells[5] = cells[6] = "1.0" if cells[5] != "1.0" else "0.5"
    path.write_text("\n".join([lines[0], ",".join(cells), *lines[2:]]) + "\n")
    with pytest.raises(ResultError, match="not reproduced: episode 0"):
        improved({}, CPP, [result])


def test_results_of_other_episodes_are_refused(tmp_path):
    with pytest.raises(ResultError, match="split: validation, expected test"):
        improved({}, CPP, [fly("random", tmp_path, split="validation")])
    with pytest.raises(ResultError, match="scenario: Block8-DH-v0, expected Block8-CPP-v0"):
        improved({}, CPP, [fly("random", tmp_path, DH)])


def test_gaps_are_means_over_the_episodes_that_are_known(own, tmp_path):
    result = fly("greedy", tmp_path, own)
    assert gaps(result, own) is None
    cral = result.episodes()["cral"].to_numpy()
    known = {k: Known(k, 1.0, "reach", 20.0) for k in range(10)}
    known[15] = Known(15, best_known=cral[15] - 0.25, agent="random")
    known[N + 1] = Known(N + 1, 0.0, "reach", 20.0)
    save_reference(reference_path(own), own, known)
    found = gaps(result, own)
    assert found.to_bound.mean == pytest.approx(1 - cral[:10].mean())
    assert found.to_best.mean == pytest.approx(-0.25)
    assert (found.bounded, found.compared, found.better) == (10, 1, 1)
    assert found.optimal == (cral[:10] == 1.0).sum()
    save_reference(reference_path(own), own, {N + 1: Known(N + 1, 0.0, "reach", 20.0)})
    assert gaps(result, own) is None
    assert gaps(fly("greedy", tmp_path / "validation", own, "validation"), own) is None


def test_shipped_references_are_of_their_scenarios_and_hold_together():
    for path in Path(scenario_paths()["Block8-CPP-v0"].parent, "reference").glob("*.csv"):
        scenario = load_scenario(path.stem)
        known = load_reference(path, scenario)
        assert known
        for k in known.values():
            assert k.agent or math.isnan(k.best_known)
            if scenario.mission.exact:
                assert not k.best_known > k.upper_bound
                assert k.proved_optimal == (k.best_known == k.upper_bound)
            else:
                assert not k.proved_optimal


def test_shipped_best_known_scores_are_those_of_the_submissions():
    submissions = Path(__file__).parents[2] / "leaderboard" / "submissions"
    for path in Path(scenario_paths()["Block8-CPP-v0"].parent, "reference").glob("*.csv"):
        scores = [pd.read_csv(table)["cral"].to_numpy() for table in submissions.glob(f"*/{path.stem}/episodes.csv")]
        known = load_reference(path, load_scenario(path.stem))
        assert [known[number].best_known for number in range(1000)] == pytest.approx(np.max(scores, axis=0), abs=1e-6)
