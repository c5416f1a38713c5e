"""The order of the planners on the paper's scenarios: each beats the one before on the same 100 test episodes.

Their bounds are those of ``scenarios/reference``.
"""

import numpy as np
import pytest

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.metrics import compare
from uavbench.evaluation.reference import load_reference, reference_path
from uavbench.evaluation.run import run

pytest.importorskip("pyvrp", reason="orienteering needs PyVRP: pip install 'uavbench[planning]'")

EPISODES = 100


@pytest.mark.slow
@pytest.mark.parametrize("mission", ["CPP", "DH"])
@pytest.mark.parametrize("city", ["Manhattan32", "Urban50"])
def test_each_planner_beats_the_one_before(city, mission, tmp_path):
    scenario = load_scenario(f"{city}-{mission}-v0")
    names = ["random", "boustrophedon" if mission == "CPP" else "tsp", "orienteering", "planner", "greedy", "quick_planner"]
    results = [run(Job(find_agent(name), scenario, "test"), EPISODES, tmp_path, workers=2) for name in names]
    for result in results[1:]:
        assert result.metrics["landed"].mean == 1.0
    cral = [result.episodes()["cral"].to_numpy(np.float64) for result in results]
    for k in (1, 2):
        assert compare(cral[k], cral[k - 1]).difference.low > 0, names[k]
    assert cral[3].mean() >= cral[2].mean()
    assert compare(cral[5], cral[4]).difference.low > 0
    assert cral[3].mean() >= cral[5].mean()

    known = load_reference(reference_path(scenario), scenario)
    bound = np.array([known[k].upper_bound for k in range(EPISODES)])
    there = ~np.isnan(bound)
    assert there.any()
    if mission == "CPP":
        assert there.all()
        assert (cral[3] <= bound).all()
    assert cral[3][there].mean() <= bound[there].mean()


@pytest.mark.slow
@pytest.mark.parametrize("mission", ["CPP", "DH"])
@pytest.mark.parametrize("city", ["Manhattan32", "Urban50"])
def test_teams_fly_better_by_planner_than_by_greedy(city, mission, tmp_path):
    scenario = load_scenario(f"{city}-{mission}-Team-v0")
    results = [run(Job(find_agent(name), scenario, "test"), 50, tmp_path, workers=2) for name in ("greedy", "planner")]
    worse, better = (result.episodes()["cral"].to_numpy(np.float64) for result in results)
    assert results[1].metrics["landed"].mean == 1.0
    assert compare(better, worse).difference.low > 0
