"""What the README and the page of all scores say is true."""

import re
from pathlib import Path

import numpy as np
import pytest

from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.leaderboard.submission import load_submission
from uavbench.world.resources import earlier_digests

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
SCORES = (ROOT / "docs" / "scores.md").read_text(encoding="utf-8")
SUBMISSIONS = sorted(path.parent for path in (ROOT / "leaderboard" / "submissions").glob("*/*/manifest.toml"))
OTHERS = {digest for digests in earlier_digests()["other_actions"].values() for digest in digests}
TODAYS = [path for path in SUBMISSIONS if not OTHERS & set((path / "manifest.toml").read_text(encoding="utf-8").split('"'))]


def check_row(result):
    """The row of a result shows its scores."""
    scenario, agent = result.summary["scenario"], result.summary["agent"]
    row = next(line for line in SCORES.splitlines() if line.startswith(f"| {scenario} | `{agent}` |"))
    found = [
        f"{100 * interval.mean:.1f} [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
        for interval in result.metrics.values()
    ]
    assert [cell.strip() for cell in row.split("|")[3:6]] == found


@pytest.mark.slow
@pytest.mark.parametrize("folder", TODAYS, ids=lambda folder: f"{folder.parent.name}-{folder.name}")
def test_official_flights_are_flown_again(folder):
    """Flying all episodes again takes hours: some of them are. All are replayed when the leaderboard is built."""
    submission = load_submission(folder)
    agent, scenario = find_agent(submission.manifest.name), submission.scenario
    actions, cral = submission.result.actions(), submission.result.episodes()["cral"]
    last = len(actions) - 1
    is_large = scenario.shape[0] > 64  # where some agents take a minute for an episode
    for record in evaluate(Job(agent, scenario, "test"), [last] if is_large else [0, (last + 1) // 2, last]):
        if scenario.mission.exact:
            assert np.array_equal(record.actions, actions[record.episode])
        else:  # the last digit of another platform's logarithm may turn a choice
            assert record.cral == pytest.approx(cral[record.episode], abs=0.1)


def test_all_scores_are_those_of_the_leaderboard():
    rows = re.findall(r"^\| (\S+-v0) \| `(\w+)` \|", SCORES, re.MULTILINE)
    assert len(rows) > 20
    for scenario, agent in rows:
        check_row(load_submission(ROOT / "leaderboard" / "submissions" / agent / scenario).result)


COLUMNS = ("Manhattan32-CPP-v0", "Manhattan32-DH-v0", "Urban50-CPP-v0", "Urban50-DH-v0")


def rows(text):
    """Return the rows of the tables in a text, each as a list of cells."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| ")]


def names(cell):
    """Return of whom a row is: agents, the upper bound, or the paper's DDQN."""
    return re.findall(r"`(\w+)`", cell) or [cell.split(",")[0]]


def test_the_compact_table_says_the_same():
    long = {(row[0], name): row[4].split()[0] for row in rows(SCORES)[2:] for name in names(row[1])}
    table = {row[0]: row[1:] for row in rows(README) if row[0] not in ("CRAL", "---")}
    assert len(table) == 9
    for label, cells in table.items():
        for column, cell in zip(COLUMNS, cells, strict=True):
            assert [cell.strip("*").split()[0]] == [long[column, name] for name in names(label) if (column, name) in long]
    for cells in zip(*(table[label] for label in table if label.startswith("`")), strict=True):
        scores = [float(cell.strip("*")) for cell in cells]
        assert [cell for cell in cells if "**" in cell] == [f"**{max(scores):.1f}**"]


def test_its_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target
