"""The paper's table V: how much faster training is with the global-local scheme than without (l = 0, g = 1).

Usage: python docs/reproduction/table_5.py [--scenario Manhattan32-DH-v0] [--rounds 5] [--updates 5]

Every network trains by the configuration ``paper``; the time is that of a step and an update on 128 samples, computing the
observations included. The networks take turns in every round, and the best round of each counts, so that a busy machine
disturbs all of them alike.
"""

import argparse
import time
from dataclasses import replace

import torch

from uavbench import load_scenario
from uavbench.agents.agent import find_agent

LOCALS, SCALES = (9, 17, 25, 33), (2, 3, 5, 7)


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="Manhattan32-DH-v0")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--updates", type=int, default=5)
    options = parser.parse_args()
    torch.set_num_threads(1)
    module, scenario = find_agent("ddqn").module(), load_scenario(options.scenario)
    config = replace(module.CONFIGS["paper"], buffer_size=1000, learning_starts=500)  # the size does not affect the time
    sizes = [(0, 1), *((size, scale) for size in LOCALS for scale in SCALES)]
    learners = {size: module.Learner(scenario.with_observation(*size), config, seed=0) for size in sizes}
    seconds = dict.fromkeys(sizes, float("inf"))
    for learner in learners.values():
        learner.advance()  # fills the replay buffer
    for _ in range(options.rounds):
        for size, learner in learners.items():
            started = time.perf_counter()
            for _ in range(options.updates):
                learner.advance()
            seconds[size] = min(seconds[size], (time.perf_counter() - started) / options.updates)
    whole = seconds[0, 1]
    print(f"{options.scenario}, one thread: {1000 * whole:.0f} ms per update without the scheme; times as fast with it:\n")
    print("| | " + " | ".join(f"g = {g}" for g in SCALES) + " |\n| --- |" + " ---: |" * len(SCALES))
    for size in LOCALS:
        print(f"| l = {size} | " + " | ".join(f"{whole / seconds[size, scale]:.1f}" for scale in SCALES) + " |")


if __name__ == "__main__":
    main()
