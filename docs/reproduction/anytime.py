"""What time buys: CRAL against the seconds that an agent decides in an episode, for the planners and the agents by rules.

Usage: python docs/reproduction/anytime.py [--episodes 100] [--out runs/anytime]

Flies the first validation episodes of the paper's scenarios: `planner` with searches from short to ten times the default,
`quick_planner`, `orienteering`, `boustrophedon` or `tsp`, and `greedy`. Points that ``anytime.csv`` in the folder ``--out`` has
are not flown again. Writes ``anytime.csv`` and ``anytime.png`` there, and prints the points. Nothing else should run meanwhile.
"""

import argparse
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import pandas as pd

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import AgentError, Job, evaluate

SCENARIOS = ("Manhattan32-CPP-v0", "Urban50-CPP-v0", "Manhattan32-DH-v0", "Urban50-DH-v0")
OTHERS = ("greedy", "boustrophedon", "tsp", "orienteering", "quick_planner")
# searches, changes for each action of the budget, plans that are improved
COVERAGE = ((1, 10, 0), (1, 20, 0), (1, 80, 0), (1, 250, 0), (3, 250, 1), (8, 250, 2), (20, 500, 4))
HARVESTING = ((1, 20, 0), (1, 140, 0), (6, 140, 0), (24, 140, 0), (60, 280, 0))


def points(scenario):
    """Return agents with their settings."""
    efforts = COVERAGE if scenario.mission.exact else HARVESTING
    planners = [("planner", dict(zip(("searches", "changes", "refined"), effort, strict=True))) for effort in efforts]
    return [*((name, {}) for name in OTHERS), *planners]


def fly(scenario, agent, settings, episodes):
    """Return a line of the table; None if the agent does not fly there."""
    job = Job(find_agent(agent), scenario, "validation", settings=settings or None)
    try:
        list(evaluate(job, [episodes]))  # compiles what it needs
        records = list(evaluate(job, range(episodes)))
    except AgentError:
        return None
    cral, seconds = (sum(getattr(record, name) for record in records) / episodes for name in ("cral", "seconds"))
    effort = " ".join(f"{value}" for value in settings.values())
    return {"scenario": scenario.id, "agent": agent, "effort": effort, "cral": 100 * cral, "seconds": seconds}


def draw(table, path):
    """Draw a panel for each scenario."""
    figure, axes = plt.subplots(1, 4, figsize=(14, 3.6), layout="constrained")
    for axis, name in zip(axes, SCENARIOS, strict=True):
        here = table[table["scenario"] == name]
        curve = here[here["agent"] == "planner"].sort_values("seconds")
        axis.plot(curve["seconds"], curve["cral"], "o-", label="planner")
        for row in here[here["agent"] != "planner"].itertuples():
            axis.plot(row.seconds, row.cral, "s")
            axis.annotate(row.agent, (row.seconds, row.cral), textcoords="offset points", xytext=(5, -9), fontsize=8)
        axis.set(xscale="log", xlabel="seconds for the decisions of an episode", title=name.removesuffix("-v0"))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("CRAL, %")
    axes[0].legend(loc="lower right")
    figure.savefig(path, dpi=110)


def main():
    """Fly, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path("runs/anytime"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "anytime.csv"
    rows = pd.read_csv(path, dtype={"effort": str}, keep_default_na=False).to_dict("records") if path.exists() else []
    known = {(row["scenario"], row["agent"], row["effort"]) for row in rows}
    for scenario in map(load_scenario, SCENARIOS):
        for agent, settings in points(scenario):
            if (scenario.id, agent, " ".join(f"{value}" for value in settings.values())) in known:
                continue
            row = fly(scenario, agent, settings, options.episodes)
            if row:
                rows.append(row)
                pd.DataFrame(rows).to_csv(path, index=False)
                print(f"{scenario.id} {agent} {row['effort']}: {row['cral']:.1f} in {row['seconds']:.3f} s", flush=True)
    draw(pd.DataFrame(rows), options.out / "anytime.png")


if __name__ == "__main__":
    main()
