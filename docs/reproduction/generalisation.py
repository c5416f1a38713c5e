"""How well agents fly in cities that they have not seen: the tables of docs/generalisation.md.

Usage: python docs/reproduction/generalisation.py [--mission CPP] [--agents ddqn-Manhattan32 ...] [--out results] [--workers 2].
Episodes that already have results in the folder are not flown again.

Two DDQN agents of the same configuration are compared, one trained on Manhattan32 alone and one in the cities of Cities32, with
built-in agents beside them. All scenarios have 32×32 cells, so that the same network fits all of them.
"""

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.metrics import variance_of_mean
from uavbench.evaluation.run import run
from uavbench.world.cities import city_numbers
from uavbench.world.resources import baselines_folder

#: The columns: scenario and split, of which 1,000 episodes are flown.
PLACES = (("Manhattan32", "test"), ("Cities32", "train"), ("Cities32", "test"), ("Helsinki32", "test"))
TRAINED = ("Manhattan32", "Cities32")
AGENTS = (*(f"ddqn-{name}" for name in TRAINED), "greedy", "orienteering", "planner")


def source_of(agent, mission):
    """Return the source of an agent of `AGENTS`."""
    kind, _, trained = agent.partition("-")
    if not trained:
        return find_agent(kind)
    weights = baselines_folder() / "weights" / f"{kind}-{trained}-{mission}-v0.safetensors"
    return replace(find_agent(kind, weights, agent), transfer=True)


def flown(agent, mission, place, options):
    """Return the result of an agent in one of `PLACES`."""
    name, split = place
    job = Job(source_of(agent, mission), load_scenario(f"{name}-{mission}-v0"), split)
    return run(job, 1000, options.out / split, workers=options.workers, resume=True)


def shown(result, metric):
    """Return a metric with its interval, in %."""
    mean, low, high = (100 * each for each in vars(result.metrics[metric]).values())
    return f"{mean:.1f} [{low:.1f}, {high:.1f}]"


def gap(seen, unseen, mission):
    """Return by how much CRAL is higher on train episodes of Cities32 than on its test episodes, with its interval, in %.

    The two are independent samples, so their variances add up; both are over cities.
    """
    means, variance = [], 0.0
    for result, split in ((seen, "train"), (unseen, "test")):
        table = result.episodes()
        scores = table["cral"].to_numpy()
        cities = city_numbers(load_scenario(f"Cities32-{mission}-v0"), split, table["episode"].to_numpy().astype(np.int64))
        means.append(scores.mean())
        variance += variance_of_mean(scores, cities)
    difference, half = means[0] - means[1], 1.96 * math.sqrt(variance)
    low, mean, high = (100 * each for each in (difference - half, difference, difference + half))
    return f"{mean:+.1f} [{low:+.1f}, {high:+.1f}]"


def main():
    """Fly and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--mission", choices=("CPP", "DH"), default="CPP")
    parser.add_argument("--agents", nargs="+", choices=AGENTS, default=AGENTS)
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    columns = [f"{name}, {split}" for name, split in PLACES]
    print(f"CRAL in {options.mission}, in % with 95 % intervals; below it the share of flights that landed.\n")
    print(f"| agent | {' | '.join(columns)} | Cities32, train − test |\n| --- |{' ---: |' * (len(columns) + 1)}")
    for agent in options.agents:
        results = [flown(agent, options.mission, place, options) for place in PLACES]
        difference = gap(results[1], results[2], options.mission)
        print(f"| {agent} | {' | '.join(shown(result, 'cral') for result in results)} | {difference} |")
        print(f"| landed | {' | '.join(shown(result, 'landed') for result in results)} | |", flush=True)


if __name__ == "__main__":
    main()
