"""Small evaluations, and the parts of a result that do not depend on the time it took."""

import json
from pathlib import Path

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job

AGENTS = Path(__file__).parent / "agents.py"
N = 20


def job(name="One", scenario="Block8-DH-v0", **changes):
    source = find_agent(name if name in ("random", "greedy") else f"{AGENTS}:{name}")
    return Job(source, load_scenario(scenario), "test", **changes)


def files(folder):
    """Return the contents of a result's files, without entries that depend on the time or the number of workers."""
    summary = json.loads((folder / "summary.json").read_text())
    for name in ("wall_time", "decisions_per_second", "workers"):
        del summary[name]
    return summary, (folder / "episodes.csv").read_bytes(), (folder / "actions.npz").read_bytes()
