"""What the README says is true."""

import re
from pathlib import Path

import pytest

from uavbench import load_scenario
from uavbench.agent import find_agent
from uavbench.evaluate import Job
from uavbench.replay import replay
from uavbench.run import run

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


RESTS = ("CPP-v0", "DH-v0", "CPP-Team-v0", "DH-Team-v0")


@pytest.mark.slow
@pytest.mark.parametrize("agent", ["random", "greedy"])
@pytest.mark.parametrize("name", [f"{city}-{rest}" for city in ("Manhattan32", "Urban50") for rest in RESTS])
def test_the_scores_are_what_evaluate_prints(agent, name, tmp_path):
    result = run(Job(find_agent(agent), load_scenario(name), "test"), 1000, tmp_path)
    row = next(line for line in README.splitlines() if line.startswith(f"| {name} | `{agent}` |"))
    found = [
        f"{100 * interval.mean:.1f} [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
        for interval in result.metrics.values()
    ]
    assert [cell.strip() for cell in row.split("|")[3:6]] == found
    assert replay(result) == []


def test_its_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (Path(__file__).parent.parent / target).exists(), target
