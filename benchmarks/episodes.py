"""How long do the built-in agents take? One episode of a city of 512×512 cells, and the 1,000 of Cities32 flown by greedy.

Usage: python benchmarks/episodes.py [--episode 0]. Prints Markdown. Kernels are compiled before the clock starts.
"""

import argparse
import time

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job, evaluate

LARGE = {
    "City512-CPP-v0": ("greedy", "boustrophedon", "planner"),
    "City512-DH-v0": ("greedy", "tsp", "planner"),
}


def seconds(agent, scenario, numbers):
    """Return how long an agent takes for episodes of the test split, in one process, and its mean CRAL in %."""
    job = Job(find_agent(agent), load_scenario(scenario), "test")
    started = time.perf_counter()
    records = list(evaluate(job, numbers))
    return time.perf_counter() - started, 100 * sum(record.cral for record in records) / len(records)


def main():
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description="Measure how long the built-in agents take.")
    parser.add_argument("--episode", type=int, default=0, help="the test episode of City512")
    episode = parser.parse_args().episode
    print("| agent | scenario | episodes | seconds | CRAL % |\n| --- | --- | ---: | ---: | ---: |", flush=True)
    for scenario, agents in LARGE.items():
        for agent in agents:
            seconds(agent, scenario.replace("512", "128"), [episode])  # compiles what it needs
            taken, cral = seconds(agent, scenario, [episode])
            print(f"| {agent} | {scenario} | 1 | {taken:.1f} | {cral:.1f} |", flush=True)
    seconds("greedy", "Cities32-CPP-v0", range(2))
    taken, cral = seconds("greedy", "Cities32-CPP-v0", range(1000))
    print(f"| greedy | Cities32-CPP-v0 | 1,000 | {taken:.1f} | {cral:.1f} |", flush=True)


if __name__ == "__main__":
    main()
