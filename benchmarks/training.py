"""The time of an update of the reference agent's training if freed memory is given back to the system, and if it is kept.

Usage: python benchmarks/training.py [--scenario Manhattan32-CPP-v0] [--rounds 4] [--updates 50]

Each of the two has its own process; they take turns, and the best round of each counts.
Needs ``pip install 'uavbench[ddqn]'``.
"""

import argparse
import contextlib
import multiprocessing
import resource
import time

import torch

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.learning.memory import keep_freed

LEARNER = {}


def begin(keep, scenario):
    """Set up a training in this process, and make its first update."""
    torch.set_num_threads(1)
    if keep:
        keep_freed()
    ddqn = find_agent("ddqn").module()
    LEARNER["one"] = ddqn.Learner(load_scenario(scenario), ddqn.CONFIGS["fast"], seed=0)
    LEARNER["one"].advance()


def measure(updates):
    """Return the milliseconds that an update takes, and the memory pages that it requests from the system."""
    started, pages = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(updates):
        LEARNER["one"].advance()
    asked = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - pages
    return 1000 * (time.perf_counter() - started) / updates, asked / updates


def main():
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="Manhattan32-CPP-v0")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--updates", type=int, default=50)
    options = parser.parse_args()
    spawn = multiprocessing.get_context("spawn")
    best = {}
    with contextlib.ExitStack() as stack:
        pools = {keep: stack.enter_context(spawn.Pool(1, begin, (keep, options.scenario))) for keep in (False, True)}
        for _ in range(options.rounds + 1):
            for keep, pool in pools.items():
                best[keep] = min(best.get(keep, (float("inf"), 0.0)), pool.apply(measure, (options.updates,)))
    print("| freed memory | ms/update | pages/update |\n| --- | ---: | ---: |")
    for keep, (spent, pages) in best.items():
        print(f"| {'kept' if keep else 'given back'} | {spent:.1f} | {pages:,.0f} |")
    print(f"\nratio {best[False][0] / best[True][0]:.2f}")


if __name__ == "__main__":
    main()
