"""Is the suite as fast as it was? Batches, single environments and teams, on one thread, in this checkout and in another.

Usage: python benchmarks/throughput.py [--against FOLDER] [--rounds 40]. Prints Markdown. Each checkout is measured in a process
of its own; their rounds alternate, and the best round of each counts, so that a busy machine disturbs both alike. The same
rounds also measure copying the observations. (`uavbench speed` measures one installation, in more ways.)
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

NAMES = ("Manhattan32-CPP-v0", "Urban50-CPP-v0", "Manhattan32-DH-v0", "Urban50-DH-v0")
NUM_ENVS = 256
LARGE = 1024
STEPS = 60
HERE = Path(__file__).resolve().parents[1]


def seconds(function):
    """Return the wall time of a call in seconds."""
    started = time.perf_counter()
    function()
    return time.perf_counter() - started


class Batch:
    """A vector environment of one scenario, with random actions from 0 to ``most``."""

    def __init__(self, name, most, number):
        import gymnasium as gym
        import numpy as np

        self.copyto = np.copyto
        self.envs = gym.make_vec(f"uavbench/{name}", number, vectorization_mode="vector_entry_point")
        self.observations, _ = self.envs.reset(seed=0)
        self.actions = np.random.default_rng(0).integers(0, most + 1, (max(4, STEPS * NUM_ENVS // number), number))
        self.copies = {part: np.empty_like(values) for part, values in self.observations.items()}
        self.best, self.copying = np.inf, np.inf

    def measure(self):
        """Measure steps and copies once, and keep the best times."""
        self.best = min(self.best, seconds(self._step) / self.actions.size)
        self.copying = min(self.copying, seconds(self._copy) / self.actions.size)

    def _step(self):
        for row in self.actions:
            self.envs.step(row)

    def _copy(self):
        for _ in self.actions:
            for part, values in self.observations.items():
                self.copyto(self.copies[part], values)


class Single:
    """One environment; resets are not counted."""

    copying = None

    def __init__(self, name):
        import gymnasium as gym

        self.env = gym.make(f"uavbench/{name}").unwrapped
        self.best = float("inf")

    def measure(self):
        """Measure steps once, and keep the best time."""
        self.env.reset(seed=0, options={"budget": self.env.scenario.budget[1]})
        self.env.step(4)
        self.best = min(self.best, seconds(lambda: [self.env.step(k % 5) for k in range(100)]) / 100)


class Teams:
    """256 teams of ``uavs`` UAVs in one simulator, with random actions except ``land``; with observations, masks and resets."""

    copying = None

    def __init__(self, name, uavs):
        import numpy as np

        import uavbench

        try:
            from uavbench.simulation.observation import Observer
            from uavbench.simulation.simulator import Simulator
        except ModuleNotFoundError:  # a checkout from before the package had folders
            from uavbench.observation import Observer  # pyright: ignore[reportMissingImports]
            from uavbench.simulator import Simulator  # pyright: ignore[reportMissingImports]

        self.np = np
        scenario = uavbench.load_scenario(name).with_uavs(uavs)
        self.simulator, self.observer = Simulator(scenario, NUM_ENVS), Observer(scenario)
        self.simulator.reset(np.arange(NUM_ENVS), "train", np.arange(NUM_ENVS))
        self.actions = np.random.default_rng(0).integers(0, 5, (STEPS, NUM_ENVS, uavs))
        self.next, self.best = NUM_ENVS, np.inf

    def measure(self):
        """Measure steps once, and keep the best time."""
        self.best = min(self.best, seconds(self._step) / STEPS / NUM_ENVS)

    def _step(self):
        everyone = self.np.arange(self.actions[0].size)
        for row in self.actions:
            self.simulator.step(row)
            over = self.np.flatnonzero(self.simulator.state.done.all(axis=1))
            if len(over):
                self.simulator.reset(over, "train", self.np.arange(self.next, self.next + len(over)))
                self.next += len(over)
            self.simulator.action_mask()
            self.observer.write(self.simulator.state, everyone, self.observer.empty(len(everyone)))


class Team:
    """One team in a ``ParallelEnv``."""

    copying = None

    def __init__(self, name, uavs):
        import uavbench

        scenario = uavbench.load_scenario(name).with_uavs(uavs)
        self.env, self.longest, self.best = uavbench.parallel_env(scenario), scenario.budget[1], float("inf")

    def measure(self):
        """Measure steps once, and keep the best time."""
        self.env.reset(seed=0, options={"budget": self.longest})
        actions = [dict.fromkeys(self.env.agents, k % 5) for k in range(100)]
        self.best = min(self.best, seconds(lambda: [self.env.step(each) for each in actions]) / 100)


def everything():
    """Return everything that is measured, by its name in the table."""
    measured = {}
    for name in NAMES:
        measured[f"{name}, 256, all but land"] = Batch(name, 4, NUM_ENVS)
        measured[f"{name}, 256, all actions"] = Batch(name, 5, NUM_ENVS)
        measured[f"{name}, 1,024, all but land"] = Batch(name, 4, LARGE)
        measured[f"{name}, vector of 1"] = Batch(name, 4, 1)
        measured[f"{name}, Env"] = Single(name)
        team = name.replace("-v0", "-Team-v0")
        for uavs in (1, 3):
            measured[f"{team}, 256 teams of {uavs}"] = Teams(team, uavs)
            measured[f"{team}, ParallelEnv of {uavs}"] = Team(team, uavs)
    return measured


def serve():
    """Measure a round for each line on standard input, and print the best times so far."""
    import uavbench  # registers the environments

    if Path(uavbench.__file__).parents[1] != Path.cwd():
        raise SystemExit(f"{uavbench.__file__} is not in {Path.cwd()}")
    measured = everything()
    print("ready", flush=True)
    for _ in sys.stdin:
        for each in measured.values():
            each.measure()
        print(json.dumps({name: [each.best, each.copying] for name, each in measured.items()}), flush=True)


def started(folder):
    """Start a process that measures the checkout in a folder."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    command = [sys.executable, str(Path(__file__).resolve()), "--serve"]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment, cwd=str(folder))


def main():
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=40, help="rounds, of which the best counts (default: 40)")
    parser.add_argument("--against", type=Path, help="the folder of another checkout, to be measured in the same rounds")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    wanted = parser.parse_args()
    if wanted.serve:
        return serve()
    folders = [HERE] if wanted.against is None else [HERE, wanted.against.resolve()]
    processes = [started(folder) for folder in folders]
    for process in processes:
        process.stdout.readline()
    for _ in range(wanted.rounds):
        tables = []
        for process in processes:
            process.stdin.write("\n")
            process.stdin.flush()
            tables.append(json.loads(process.stdout.readline()))
    for process in processes:
        process.stdin.close()
        process.wait()
    names = ["here", "there"][: len(folders)]
    print(f"| what | {' | '.join(f'{name}, µs/step' for name in names)} | copying, µs | copying/step | there/here |")
    print(f"| --- |{' ---: |' * (len(names) + 3)}")
    for what, (best, _) in tables[0].items():
        copies = [table[what][1] for table in tables]
        copied = f"{1e6 * min(copies):.2f} | {min(copies) / best:.2f}" if copies[0] else " | "
        ratio = f"{tables[1][what][0] / best:.2f}" if len(tables) > 1 else ""
        print(f"| {what} | {' | '.join(f'{1e6 * table[what][0]:.2f}' for table in tables)} | {copied} | {ratio} |")
    return None


if __name__ == "__main__":
    main()
