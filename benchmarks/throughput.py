"""How fast is the simulator? Steps per second on one thread, beside what copying the same bytes takes in the same run.

Usage: python benchmarks/throughput.py [--rounds 40]. Prints Markdown. Rounds of stepping and copying alternate, and the best
of each counts, so that a busy machine disturbs both alike.
"""

import argparse
import os
import platform
import subprocess
import sys
import time

import gymnasium as gym
import numpy as np

import uavbench
from uavbench.observation import Observer
from uavbench.simulator import Simulator

NAMES = ("Manhattan32-CPP-v0", "Urban50-CPP-v0", "Manhattan32-DH-v0", "Urban50-DH-v0")
TEAMS = ("Manhattan32-CPP-Team-v0", "Urban50-CPP-Team-v0", "Manhattan32-DH-Team-v0", "Urban50-DH-Team-v0")
NUM_ENVS = 256
STEPS = 60


def seconds(function):
    """Return the wall time of a call."""
    started = time.perf_counter()
    function()
    return time.perf_counter() - started


class Batch:
    """256 environments of one scenario under random actions from 0 to ``most``."""

    def __init__(self, name, most):
        self.envs = gym.make_vec(f"uavbench/{name}", NUM_ENVS, vectorization_mode="vector_entry_point")
        self.observations, _ = self.envs.reset(seed=0)
        self.actions = np.random.default_rng(0).integers(0, most + 1, (STEPS, NUM_ENVS))
        self.copies = {part: np.empty_like(values) for part, values in self.observations.items()}
        self.stepping, self.copying, self.ended, self.rounds = np.inf, np.inf, 0, 0

    def measure(self):
        """Step and copy once, and keep the best."""
        self.stepping = min(self.stepping, seconds(self._step) / STEPS / NUM_ENVS)
        self.copying = min(self.copying, seconds(self._copy) / STEPS / NUM_ENVS)
        self.rounds += 1

    def _step(self):
        for row in self.actions:
            self.ended += int(self.envs.step(row)[2].sum())

    def _copy(self):
        for _ in range(STEPS):
            for part, values in self.observations.items():
                np.copyto(self.copies[part], values)

    def row(self, what):
        """Return the cells of the table."""
        ended = 1000 * self.ended / self.rounds / STEPS / NUM_ENVS
        return (
            f"{what} | {1 / self.stepping:,.0f} | {1e6 * self.stepping:.2f} | {1e6 * self.copying:.2f} | "
            f"{self.stepping / self.copying:.1f} | {ended:.0f}"
        )


class Single:
    """One environment; resets are not counted."""

    def __init__(self, name):
        self.env = gym.make(f"uavbench/{name}").unwrapped
        self.best = np.inf

    def measure(self):
        """Step and keep the best."""
        self.env.reset(seed=0, options={"budget": self.env.scenario.budget[1]})
        self.env.step(4)
        self.best = min(self.best, seconds(lambda: [self.env.step(k % 5) for k in range(100)]) / 100)


class Teams:
    """256 teams of ``uavs`` in one simulator, and one team in its environment, under random actions but ``land``."""

    def __init__(self, name, uavs):
        self.scenario = uavbench.load_scenario(name).with_uavs(uavs)
        self.simulator, self.observer = Simulator(self.scenario, NUM_ENVS), Observer(self.scenario)
        self.simulator.reset(np.arange(NUM_ENVS), "train", np.arange(NUM_ENVS))
        self.actions = np.random.default_rng(0).integers(0, 5, (STEPS, NUM_ENVS, uavs))
        self.env = uavbench.parallel_env(self.scenario)
        self.next, self.batch, self.single = NUM_ENVS, np.inf, np.inf

    def measure(self):
        """Step both and keep the best."""
        self.batch = min(self.batch, seconds(self._step) / STEPS / NUM_ENVS)
        self.env.reset(seed=0, options={"budget": self.scenario.budget[1]})
        actions = [dict.fromkeys(self.env.agents, k % 5) for k in range(100)]
        self.single = min(self.single, seconds(lambda: [self.env.step(each) for each in actions]) / 100)

    def _step(self):
        everyone = np.arange(self.actions[0].size)
        for row in self.actions:
            self.simulator.step(row)
            over = np.flatnonzero(self.simulator.state.done.all(axis=1))
            if len(over):
                self.simulator.reset(over, "train", np.arange(self.next, self.next + len(over)))
                self.next += len(over)
            self.simulator.action_mask()
            self.observer.write(self.simulator.state, everyone, self.observer.empty(len(everyone)))


def process(*words):
    """Return the best wall time of a new Python process."""
    return min(seconds(lambda: subprocess.run([sys.executable, *words], check=True, capture_output=True)) for _ in range(7))


def main():
    """Measure, and print tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=40, help="rounds, of which the best counts (default: 40)")
    rounds = parser.parse_args().rounds
    print(f"uavbench {uavbench.__version__}, {platform.processor() or platform.machine()}, {os.cpu_count()} cores, ", end="")
    print(f"Python {platform.python_version()}, one thread, {NUM_ENVS} environments, observations and resets included\n")
    print(
        "| scenario | actions | steps/s | µs/step | copying its bytes, µs | ratio | resets per 1,000 steps | `Env.step`, µs |"
    )
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    batches = {(name, most): Batch(name, most) for name in NAMES for most in (4, 5)}
    singles = {name: Single(name) for name in NAMES}
    teams = {(name, uavs): Teams(name, uavs) for name in TEAMS for uavs in (1, 3)}
    for _ in range(rounds):
        for measured in (*batches.values(), *singles.values(), *teams.values()):
            measured.measure()
    for (name, most), batch in batches.items():
        print(f"| {name} | {batch.row('all' if most == 5 else 'all but land')} | {1e6 * singles[name].best:.1f} |")
    print("\n| scenario | 256 teams: one UAV, µs/step | three | ratio | `ParallelEnv.step`: one, µs | three | ratio |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name in TEAMS:
        one, three = teams[name, 1], teams[name, 3]
        print(
            f"| {name} | {1e6 * one.batch:.2f} | {1e6 * three.batch:.2f} | {three.batch / one.batch:.2f} | "
            f"{1e6 * one.single:.1f} | {1e6 * three.single:.1f} | {three.single / one.single:.2f} |"
        )
    print(f"\n`import uavbench` {process('-c', 'import uavbench'):.2f} s, ", end="")
    print(f"`uavbench --help` {process('-c', 'from uavbench.cli import app; app()', '--help'):.2f} s")


if __name__ == "__main__":
    main()
