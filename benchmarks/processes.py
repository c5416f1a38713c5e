"""How much faster a training of `ppo` is if several processes share it; they begin and validate outside the measurement.

Usage: python benchmarks/processes.py [--scenario Manhattan32-CPP-v0] [--processes 2] [--updates 12] [--rounds 3]

One process and several take turns, and the best round of each counts. Needs ``pip install 'uavbench[ddqn]'``.
"""

import argparse
import contextlib
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.learning.train import train
from uavbench.learning.training import Training

SOURCE = find_agent("ppo")


def measure(scenario, processes, updates):
    """Return the milliseconds that an update takes, the first one left out."""
    config = replace(SOURCE.module().CONFIGS["fast"], updates=10**6, validation=10**6)
    training = Training(SOURCE, load_scenario(scenario), "fast", config, 0, None, processes)
    times = []

    def note(done):
        times.append(time.perf_counter())
        if done > updates:
            raise InterruptedError

    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(InterruptedError):
        train(training, Path(folder), on_update=note)
    return 1000 * (times[-1] - times[0]) / updates


def main():
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenario", default="Manhattan32-CPP-v0")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--updates", type=int, default=12)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    best = {}
    for _ in range(options.rounds):
        for processes in (1, options.processes):
            found = measure(options.scenario, processes, options.updates)
            best[processes] = min(best.get(processes, float("inf")), found)
    print("| processes | ms/update |\n| ---: | ---: |")
    for processes, spent in best.items():
        print(f"| {processes} | {spent:.0f} |")
    print(f"\nratio {best[1] / best[options.processes]:.2f}")


if __name__ == "__main__":
    main()
