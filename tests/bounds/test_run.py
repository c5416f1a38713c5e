"""Bounding test episodes: resumable, the same by several processes, valid beside what agents reach."""

import pytest
from typer.testing import CliRunner

from uavbench import ScenarioError, load_scenario
from uavbench.agents.agent import find_agent
from uavbench.bounds import harvesting
from uavbench.bounds import run as bounding
from uavbench.cli.app import app
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.reference import Known, load_reference, save_reference
from uavbench.evaluation.results import ResultError
from uavbench.evaluation.run import run

pytest.importorskip("highspy", reason="the bound needs highspy: pip install 'uavbench[planning]'")

CPP, DH = load_scenario("Block8-CPP-v0"), load_scenario("Block8-DH-v0")


def bound(scenario, episodes, out, *results, seconds=5.0, **more):
    return bounding.run_bounds(scenario, episodes, results, out, seconds=seconds, **more)


@pytest.mark.parametrize("scenario", [CPP, DH], ids=["CPP", "DH"])
def test_bounds_are_kept_and_not_computed_twice(scenario, tmp_path):
    starts, seen = [], []
    result = run(Job(find_agent("greedy"), scenario, "test"), 10, tmp_path)
    report = {"on_start": starts.append, "on_known": lambda known: seen.append(known.episode)}
    known = bound(scenario, 3, tmp_path, result, **report)
    assert list(known) == list(range(10))
    assert [k for k in known if known[k].upper_bound >= 0] == [0, 1, 2] == sorted(seen)
    assert repr(load_reference(tmp_path / f"{scenario.id}.csv", scenario)) == repr(known)
    again = bound(scenario, 4, tmp_path, **report)
    assert starts == [3, 1]
    assert seen[3:] == [3]
    assert [again[k] for k in range(3)] == [known[k] for k in range(3)]
    bound(scenario, 4, tmp_path, seconds=6.0, **report)  # more time may give better ones, except where they are proved
    assert starts[2] == sum(not again[k].proved_optimal for k in range(4))
    if scenario is CPP:
        assert all(known[k].upper_bound >= known[k].best_known for k in range(3))


def test_below_data_that_were_all_collected_no_bound_is_sought(tmp_path, monkeypatch):
    """The bound of all data is the best known score there, and no lower bound could make it more certain."""
    sought = []
    monkeypatch.setattr(harvesting, "_descend", lambda problem, *rest: sought.append(problem) or (float("inf"), 0))
    save_reference(tmp_path / f"{DH.id}.csv", DH, {k: Known(k, best_known=1.0 - k * 1e-7, agent="planner") for k in (0, 1)})
    known = bound(DH, 2, tmp_path)
    assert not sought
    assert [(known[k].upper_bound, known[k].method) for k in (0, 1)] == [(1.0, "data")] * 2
    bound(DH, 3, tmp_path)
    assert len(sought) == 1


def test_what_was_done_before_an_interruption_is_there(tmp_path):
    def interrupt(known):
        if known.episode == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bound(CPP, 5, tmp_path, on_known=interrupt)
    assert list(load_reference(tmp_path / f"{CPP.id}.csv", CPP)) == [0, 1, 2]
    assert list(bound(CPP, 5, tmp_path)) == [0, 1, 2, 3, 4]


def test_several_processes_find_the_same(tmp_path):
    one = bound(CPP, 4, tmp_path / "one", seconds=60.0)
    two = bound(CPP, 4, tmp_path / "two", seconds=60.0, workers=2)
    assert repr(one) == repr(dict(sorted(two.items())))


def test_refuses_what_has_no_bounds(tmp_path):
    with pytest.raises(ScenarioError, match="one UAV"):
        bound(load_scenario("Manhattan32-CPP-Team-v0"), 1, tmp_path)
    with pytest.raises(ResultError, match=r"1001.*1000 test episodes"):
        bound(CPP, 1001, tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultError, match="--out"):
        bound(CPP, 1, tmp_path / "file")
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


def test_the_command_prints_means_and_evaluate_the_gaps(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def call(*words):
        found = CliRunner().invoke(app, words)
        return found.exit_code, found.output

    call("evaluate", "--agent", "greedy", "--scenario", CPP.id, "--episodes", "5")
    code, text = call("bound", CPP.id, "--episodes", "2", "--result", f"results/{CPP.id}/greedy", "--seconds", "5")
    assert code == 0
    for word in ("upper bound", "best known", "gap", "proved optimal", f"reference/{CPP.id}.csv"):
        assert word in text
    assert call("bound", "Manhattan32-DH-Team-v0")[0] == 2
    code, text = call("bound", CPP.id, "--result", "results/nothing")
    assert code == 2
    assert "there is no such file" in text
