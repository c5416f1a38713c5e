"""What it changes in the air if `planner` counts turns: moves, turns, CR, and the time and energy of a simulated quadrotor.

Usage: python docs/reproduction/turn_cost.py [--episodes 10] [--speed 5] [--out runs/turn_cost] [--workers 2]

Plans the first test episodes with turns by 90° that count as 0, 0.5, 1 and 2 moves, and flies them without wind. Needs the
extra ``flight``. Flights that are in ``turn_cost.csv`` in the folder ``--out`` are not flown again. Writes ``turn_cost.csv``, a
line for each flight, and prints a table.
"""

import argparse
from itertools import pairwise
from pathlib import Path

import joblib
import pandas as pd

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.flight.flown import Conditions, fly
from uavbench.flight.route import flight_along

SCENARIOS = ("Manhattan32-CPP-v0", "Urban50-CPP-v0", "Manhattan32-DH-v0")
COSTS = (0.0, 0.5, 1.0, 2.0)


def flight(name, episode, cost, speed):
    """Plan and fly one episode; return a line of the table."""
    scenario = load_scenario(name)
    job = Job(find_agent("planner"), scenario, "test", None, settings={"turn_cost": cost})
    (record,) = evaluate(job, [episode])
    planned = flight_along(scenario, "test", episode, record.actions, "planner", {})
    flown = fly(planned, Conditions(speed=speed))
    (uav,) = flown.uavs
    actions = record.actions[:, 0].astype(int)
    moves = [(first, then) for first, then in pairwise(actions) if max(first, then) < 4]
    turns = sum((0, 1, 2, 1)[(then - first) % 4] for first, then in moves)
    return {
        "scenario": name,
        "turn_cost": cost,
        "episode": episode,
        "speed": speed,
        "cr": 100 * record.cr,
        "cr_flown": 100 * flown.cr,
        "safe": 100 * (not (uav.hit or uav.zone)),
        "moves": int((actions < 4).sum()),
        "turns": turns,
        "seconds": uav.seconds,
        "energy_wh": uav.energy,
    }


def main():
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--speed", type=float, default=5.0, help="m/s")
    parser.add_argument("--out", type=Path, default=Path("runs/turn_cost"))
    parser.add_argument("--workers", type=int, default=1, help="flights at the same time, each in its own process")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "turn_cost.csv"
    rows = pd.read_csv(path).to_dict("records") if path.exists() else []
    known = {(row["scenario"], row["episode"], row["turn_cost"], row["speed"]) for row in rows}
    wanted = [(name, n, cost, options.speed) for n in range(options.episodes) for name in SCENARIOS for cost in COSTS]
    missing = [each for each in wanted if each not in known]
    one = joblib.delayed(flight)
    flights = joblib.Parallel(n_jobs=options.workers, return_as="generator")(one(*each) for each in missing)
    for count, row in enumerate(flights, 1):
        rows.append(row)
        pd.DataFrame(rows).to_csv(path, index=False)
        print(f"{count} of {len(missing)} flights", flush=True)
    means = pd.DataFrame(rows).drop(columns="episode").groupby(["scenario", "turn_cost", "speed"], sort=False).mean()
    print(means.round(1).to_string())


if __name__ == "__main__":
    main()
