"""What the README says is true."""

import re
from pathlib import Path

import numpy as np
import pytest

from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.leaderboard.submission import load_submission

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
SUBMISSIONS = sorted(path.parent for path in (ROOT / "leaderboard" / "submissions").glob("*/*/manifest.toml"))


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
@pytest.mark.parametrize("folder", SUBMISSIONS, ids=lambda folder: f"{folder.parent.name}-{folder.name}")
def test_official_flights_are_flown_again(folder):
    """Flying all 1,000 episodes again takes hours: some of them are. All are replayed when the leaderboard is built."""
    submission = load_submission(folder)
    agent, scenario = find_agent(submission.manifest.name), submission.scenario
    actions, cral = submission.result.actions(), submission.result.episodes()["cral"]
    for record in evaluate(Job(agent, scenario, "test"), [0, 500, 999]):
        if scenario.mission.exact:
            assert np.array_equal(record.actions, actions[record.episode])
        else:  # the last digit of another platform's logarithm may turn a choice
            assert record.cral == pytest.approx(cral[record.episode], abs=0.1)


def test_its_scores_are_those_of_the_leaderboard():
    rows = re.findall(r"^\| (\S+-v0) \| `(\w+)` \|", README, re.MULTILINE)
    assert len(rows) > 20
    for scenario, agent in rows:
        check_row(load_submission(ROOT / "leaderboard" / "submissions" / agent / scenario).result)


def test_its_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target
