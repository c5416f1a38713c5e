"""How recorded flights survive physics: the share flown safely, CR as flown, time and energy, by agent, scenario and speed.

Usage: python docs/reproduction/flown.py [--board leaderboard] [--out runs/flown.png]

Reads what `uavbench leaderboard fly` has recorded in ``flown.csv`` of a board, prints a table, and draws the figure of
docs/flight.md. Only episodes that all agents of a scenario flew at all speeds count.
"""

import argparse
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import pandas as pd

from uavbench.leaderboard.flown import FILE, load_flown

MARKS = {"planner": "o-", "ddqn": "s-", "greedy": "^-"}


def flights(board):
    """Return the recorded flights as a table; those of episodes that an agent of the scenario did not fly are left out."""
    table = pd.DataFrame([vars(row) | {"safe": row.safe} for row in load_flown(board / FILE)])
    table[["agent", "scenario"]] = table["submission"].str.split("/", expand=True)
    flown = table.groupby(["scenario", "episode"])["safe"].transform("size")
    return table[flown == flown.groupby(table["scenario"]).transform("max")]


def means(table):
    """Return the means of each agent on each scenario at each speed, and the extremes of the distances."""
    table = table.assign(difference=table["cr_flown"] - table["cr"], safe=table["safe"].astype(float))
    groups = table.groupby(["scenario", "agent", "speed"])
    found = groups[["safe", "cr", "cr_flown", "difference", "seconds", "energy"]].mean()
    found[["safe", "cr", "cr_flown", "difference"]] *= 100
    found = found.join(groups["off_track"].max()).join(groups["clearance"].min())
    return found.join(groups.size().rename("flights"))


def markdown(found):
    """Return the table of docs/flight.md: a line for each agent on each scenario, with a value for each speed."""
    speeds = " / ".join(f"{speed:g}" for speed in found.index.unique("speed"))
    heads = [f"safe, % at {speeds} m/s", "CR, %", "CR as flown − CR, points", "time, s", "energy, Wh", "least clearance, m"]
    lines = [f"| scenario | agent | {' | '.join(heads)} |", f"| --- | --- |{' ---: |' * len(heads)}"]
    for (scenario, agent), rows in found.groupby(level=["scenario", "agent"]):
        columns = {"safe": 0, "cr": 1, "difference": 1, "seconds": 0, "energy": 1, "clearance": 1}
        cells = [" / ".join(f"{value + 0.0:.{digits}f}" for value in rows[name]) for name, digits in columns.items()]
        cells[1] = cells[1].split(" / ")[0]  # on the grid there is no speed
        lines.append(f"| {scenario.removesuffix('-v0')} | {agent} | {' | '.join(cells).replace('-0.0', '0.0')} |")
    return "\n".join(lines)


def draw(found, path):
    """Draw safe flights, CR as flown less CR on the grid, and energy against the speed, a line for each agent."""
    by_agent = found.reset_index().groupby(["agent", "speed"])[["safe", "difference", "energy"]].mean()
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
    titles = {"safe": "safe flights, %", "difference": "CR as flown − CR on the grid, points", "energy": "energy, Wh"}
    for axis, (name, title) in zip(axes, titles.items(), strict=True):
        for agent, mark in MARKS.items():
            if agent in by_agent.index:
                values = by_agent.loc[agent, name]
                axis.plot(values.index, values, mark, label=agent)
        axis.set(xlabel="speed, m/s", title=title)
        axis.grid(alpha=0.3)
    axes[0].legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)


def main():
    """Print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--board", type=Path, default=Path("leaderboard"), help="the folder that holds flown.csv")
    parser.add_argument("--out", type=Path, default=Path("runs/flown.png"))
    options = parser.parse_args()
    found = means(flights(options.board))
    print(markdown(found))
    print(f"\n{int(found['flights'].sum())} flights, largest distance off the path {found['off_track'].max():.1f} m")
    draw(found, options.out)


if __name__ == "__main__":
    main()
