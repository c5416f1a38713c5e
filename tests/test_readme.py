"""What the README says is true."""

import re
from pathlib import Path

import numpy as np
import pytest

from uavbench import load_scenario
from uavbench.agent import find_agent
from uavbench.evaluate import Job, evaluate
from uavbench.replay import replay
from uavbench.results import load_result
from uavbench.run import run

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
SUBMISSIONS = sorted(path.parent for path in (ROOT / "leaderboard" / "submissions").glob("*/*/summary.json"))

RESTS = ("CPP-v0", "DH-v0", "CPP-Team-v0", "DH-Team-v0")


def check_row(result):
    """The README's row of a result shows its scores."""
    scenario, agent = result.summary["scenario"], result.summary["agent"]
    row = next(line for line in README.splitlines() if line.startswith(f"| {scenario} | `{agent}` |"))
    found = [
        f"{100 * interval.mean:.1f} [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
        for interval in result.metrics.values()
    ]
    assert [cell.strip() for cell in row.split("|")[3:6]] == found


@pytest.mark.slow
@pytest.mark.parametrize("agent", ["random", "greedy"])
@pytest.mark.parametrize("name", [f"{city}-{rest}" for city in ("Manhattan32", "Urban50") for rest in RESTS])
def test_the_scores_are_what_evaluate_prints(agent, name, tmp_path):
    result = run(Job(find_agent(agent), load_scenario(name), "test"), 1000, tmp_path)
    check_row(result)
    assert replay(result) == []


@pytest.mark.slow
@pytest.mark.parametrize("folder", SUBMISSIONS, ids=lambda folder: f"{folder.parent.name}-{folder.name}")
def test_the_scores_of_planners_are_replayed_and_flown_again(folder):
    """Flying all 1,000 episodes again takes hours: some of them are."""
    result = load_result(folder)
    scenario = load_scenario(result.summary["scenario"])
    assert result.summary["episodes"] == 1000
    check_row(result)
    assert replay(result) == []
    actions, cral = result.actions(), result.episodes()["cral"]
    for record in evaluate(Job(find_agent(result.summary["agent"]), scenario, "test"), [0, 500, 999]):
        if scenario.mission.exact:
            assert np.array_equal(record.actions, actions[record.episode])
        else:  # the last digit of another platform's logarithm may turn a choice
            assert record.cral == pytest.approx(cral[record.episode], abs=0.1)


def test_every_score_of_the_readme_has_its_test():
    rows = re.findall(r"^\| (\S+-v0) \| `(\w+)` \|", README, re.MULTILINE)
    kept = {(folder.name, folder.parent.name) for folder in SUBMISSIONS}
    assert kept
    assert kept <= set(rows)
    assert {row for row in rows if row not in kept} == {
        (f"{city}-{rest}", agent) for city in ("Manhattan32", "Urban50") for rest in RESTS for agent in ("random", "greedy")
    }


def test_its_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target
