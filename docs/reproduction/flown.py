"""How recorded flights survive physics: the share flown safely, CR as flown, time and energy, by agent, scenario and speed.

Usage: python docs/reproduction/flown.py [--episodes 20] [--out runs/flown] [--workers 2]

Flies the first episodes of the leaderboard's entries of `planner`, `ddqn` and `greedy` at 2, 5 and 8 m/s without wind. Needs
the extra ``flight``. Flights that are in ``flown.csv`` in the folder ``--out`` are not flown again. Writes ``flown.csv``, a
line for each flight, and ``flown.png`` there, and prints a table.
"""

import argparse
from pathlib import Path

import joblib
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import pandas as pd

from uavbench.flight.flown import Conditions, fly
from uavbench.flight.route import recorded_flight
from uavbench.leaderboard.submission import load_submission

SUBMISSIONS = Path(__file__).parents[2] / "leaderboard" / "submissions"
SCENARIOS = (
    *("Manhattan32-CPP-v0", "Manhattan32-DH-v0", "Urban50-CPP-v0", "Urban50-DH-v0"),
    *("Helsinki50-CPP-v0", "Helsinki50-DH-v0"),
)
AGENTS = ("planner", "ddqn", "greedy")
SPEEDS = (2.0, 5.0, 8.0)


def flight(agent, name, episode, speed):
    """Fly one episode; return a line of the table."""
    found = recorded_flight(load_submission(SUBMISSIONS / agent / name).result, episode)
    row = {"agent": agent, "scenario": name, "episode": episode, "speed": speed, "landed": found.landed, "cr": found.cr}
    flown = fly(found, Conditions(speed=speed))
    (uav,) = flown.uavs
    return row | {
        "hit": uav.hit,
        "zone": uav.zone,
        "cr_flown": flown.cr,
        "seconds": uav.seconds,
        "energy_wh": uav.energy,
        "off_track": uav.off_track,
        "clearance": uav.clearance,
        "moves": found.routes[0].moves,
    }


def summary(table):
    """Return the means of each agent on each scenario at each speed."""
    table = table.assign(safe=~(table["hit"] | table["zone"]), difference=table["cr_flown"] - table["cr"])
    groups = table.groupby(["scenario", "agent", "speed"], sort=False)
    means = groups[["safe", "cr", "cr_flown", "difference", "seconds", "energy_wh"]].mean()
    means[["safe", "cr", "cr_flown", "difference"]] *= 100
    return means.join(groups["off_track"].max()).join(groups["clearance"].min()).round(1)


def draw(table, path):
    """Draw the share of safe flights and the energy against the speed."""
    means = summary(table).reset_index()
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for agent, rows in means.groupby("agent", sort=False):
        together = rows.groupby("speed")[["safe", "energy_wh"]].mean()
        axes[0].plot(together.index, together["safe"], "o-", label=agent)
        axes[1].plot(together.index, together["energy_wh"], "o-", label=agent)
    for axis, label in zip(axes, ("flown without a collision or zone entry, %", "energy, Wh"), strict=True):
        axis.set_xlabel("speed, m/s")
        axis.set_ylabel(label)
    axes[0].legend()
    figure.savefig(path, dpi=120)


def main():
    """Fly, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("runs/flown"))
    parser.add_argument("--workers", type=int, default=1, help="flights at the same time, each in its own process")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "flown.csv"
    rows = pd.read_csv(path).to_dict("records") if path.exists() else []
    known = {(row["agent"], row["scenario"], row["episode"], row["speed"]) for row in rows}
    there = [(agent, name) for name in SCENARIOS for agent in AGENTS if (SUBMISSIONS / agent / name).exists()]
    wanted = [(*pair, episode, speed) for pair in there for episode in range(options.episodes) for speed in SPEEDS]
    missing = [each for each in wanted if each not in known]
    one = joblib.delayed(flight)
    for count, row in enumerate(
        joblib.Parallel(n_jobs=options.workers, return_as="generator")(one(*each) for each in missing), 1
    ):
        rows.append(row)
        if count % 20 == 0 or count == len(missing):
            pd.DataFrame(rows).to_csv(path, index=False)
            print(f"{count} of {len(missing)} flights", flush=True)
    table = pd.DataFrame(rows)
    print(summary(table).to_string())
    draw(table, options.out / "flown.png")


if __name__ == "__main__":
    main()
