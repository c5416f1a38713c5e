"""How well agents fly in cities that they have not seen: the tables of docs/generalisation.md.

Usage: python docs/reproduction/generalisation.py [--mission CPP] [--agents ddqn-Manhattan32 ...] [--out results] [--workers 2].
Flights that are on the leaderboard, and those that already have results in the folder, are not flown again.

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
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.evaluation.metrics import summarise, variance_of_mean
from uavbench.evaluation.run import run
from uavbench.leaderboard.submission import load_submission
from uavbench.world.cities import city_numbers
from uavbench.world.episode import train_numbers
from uavbench.world.resources import baselines_folder

#: The scenarios whose 1,000 test episodes are flown.
PLACES = ("Cities32", "Manhattan32", "Helsinki32")
SUBMISSIONS = Path(__file__).parents[2] / "leaderboard" / "submissions"
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
    """Return the result of an agent on the test episodes of one of `PLACES`."""
    published = SUBMISSIONS / agent / f"{place}-{mission}-v0"
    if published.is_dir():
        return load_submission(published).result
    job = Job(source_of(agent, mission), load_scenario(f"{place}-{mission}-v0"), "test")
    return run(job, 1000, options.out / "test", workers=options.workers, resume=True)


def seen_in_training(agent, mission, options):
    """Return the scores in the first 1,000 episodes of the training with seed 0, and their cities.

    `uavbench train` draws the numbers of its episodes from the seed. Nearly each of them has a city of its own.
    """
    scenario, numbers = load_scenario(f"Cities32-{mission}-v0"), train_numbers(0, 0, 1000)
    file = options.out / "train" / f"{agent}-{mission}.npz"
    if not file.exists():
        records = evaluate(Job(source_of(agent, mission), scenario, "train"), numbers.tolist(), options.workers)
        scores = {record.episode: (record.landed, record.cr, record.cral) for record in records}
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savez(file, scores=np.array([scores[number] for number in numbers.tolist()], dtype=np.float64))
    landed, cr, cral = np.load(file)["scores"].T
    return landed, cr, cral, city_numbers(scenario, "train", numbers)


def shown(metrics, metric):
    """Return a metric with its interval, in %."""
    mean, low, high = (100 * each for each in vars(metrics[metric]).values())
    return f"{mean:.1f} [{low:.1f}, {high:.1f}]"


def gap(seen, unseen, mission):
    """Return by how much CRAL is higher in cities of the training than on test episodes, with its interval, in %.

    The two are independent samples, so their variances add up; both are over cities.
    """
    _, _, scores, cities = seen
    table = unseen.episodes()
    others = table["cral"].to_numpy()
    where = city_numbers(load_scenario(f"Cities32-{mission}-v0"), "test", table["episode"].to_numpy().astype(np.int64))
    difference = scores.mean() - others.mean()
    half = 1.96 * math.sqrt(variance_of_mean(scores, cities) + variance_of_mean(others, where))
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
    columns = ["Cities32, in training", *(f"{name}, test" for name in PLACES)]
    print(f"CRAL in {options.mission}, in % with 95 % intervals; below it the share of flights that landed.\n")
    print(f"| agent | {' | '.join(columns)} | in training − test |\n| --- |{' ---: |' * (len(columns) + 1)}")
    for agent in options.agents:
        seen = seen_in_training(agent, options.mission, options)
        results = [flown(agent, options.mission, place, options) for place in PLACES]
        metrics = [summarise(seen[0] > 0.0, seen[1], seen[2], clusters=seen[3]), *(result.metrics for result in results)]
        difference = gap(seen, results[PLACES.index("Cities32")], options.mission)
        print(f"| {agent} | {' | '.join(shown(each, 'cral') for each in metrics)} | {difference} |")
        print(f"| landed | {' | '.join(shown(each, 'landed') for each in metrics)} | |", flush=True)


if __name__ == "__main__":
    main()
