"""Compare our DDQN with Stable-Baselines3's DQN: same environment, network, batch size and machine, one thread each.

Usage: python docs/reproduction/stable_baselines.py speed [--rounds 5]
       python docs/reproduction/stable_baselines.py curves [--minutes 30] [--out runs]

``speed`` measures in turns how many samples per second each learns from. ``curves`` trains both at the same time, each on its
own core, and writes their scores on 200 validation episodes to ``stable_baselines.csv`` and ``stable_baselines.png``.
Needs ``pip install 'uavbench[ddqn]' stable-baselines3``.
"""

import argparse
import contextlib
import multiprocessing
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import torch
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.agents.weights import save_weights
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.evaluation.metrics import METRICS
from uavbench.learning.memory import keep_freed
from uavbench.simulation.observation import Observer

SCENARIO = "Manhattan32-CPP-v0"
ENVIRONMENTS, BATCH, PREFILL = 128, 512, 8_192
# More than Stable-Baselines3 can take before the time is up. It lowers its exploration over the first twentieth of them.
STEPS = 2_400_000
OURS = find_agent("ddqn").module()


class SameNetwork(BaseFeaturesExtractor):
    """The convolutions of our network. Its dense layers are given by the policy's ``net_arch``."""

    def __init__(self, space, scenario):
        network = OURS.Network(Observer(scenario), budget_scale=0.1)
        super().__init__(space, features_dim=network.inputs)
        self.branches = network.branches.to(memory_format=torch.contiguous_format)  # as Stable-Baselines3 does
        self.maps, self.budget_scale = network.maps, network.budget_scale

    def forward(self, observation):
        """Return the features, shape (B, N)."""
        parts = [self.branches[f"{name}_map"](observation[name]).flatten(1) for name in self.maps]
        return torch.cat([*parts, self.budget_scale * observation["budget"]], dim=1)


class Agent:
    """The policy of Stable-Baselines3, as an agent that uavbench can score."""

    model = None

    def __init__(self, scenario):
        pass

    def act_batch(self, observations, infos):
        """Return the action with the highest Q-value for each running episode."""
        return self.model.predict(observations, deterministic=True)[0]


def theirs(scenario):
    """Return Stable-Baselines3's DQN: after each step of all environments, it makes an update on 512 of the stored steps."""
    envs = make_vec_env(
        lambda: gym.wrappers.TransformReward(gym.make(f"uavbench/{scenario.id}"), lambda reward: 0.1 * reward),
        n_envs=ENVIRONMENTS,
        seed=0,
    )
    return DQN(
        "MultiInputPolicy",
        envs,
        learning_rate=5e-4,
        buffer_size=65_536,
        learning_starts=PREFILL,
        batch_size=BATCH,
        gamma=0.95,
        tau=0.005,
        train_freq=1,
        gradient_steps=1,
        target_update_interval=1,
        exploration_fraction=0.05,  # of STEPS
        exploration_final_eps=0.05,
        max_grad_norm=5.0,
        policy_kwargs={
            "features_extractor_class": SameNetwork,
            "features_extractor_kwargs": {"scenario": scenario},
            "net_arch": [256, 256, 256],
        },
        seed=0,
        device="cpu",
    )


LEARNERS = {}


def begin(name):
    """Set up one of the two learners in this process, and train it until its first update."""
    torch.set_num_threads(1)
    scenario = load_scenario(SCENARIO)
    if name == "uavbench":
        keep_freed()  # as `uavbench train` does
        LEARNERS[name] = OURS.Learner(scenario, OURS.CONFIGS["fast"], seed=0)
        LEARNERS[name].advance()
    else:
        LEARNERS[name] = theirs(scenario)
        LEARNERS[name].learn(PREFILL + ENVIRONMENTS)


def timed(updates):
    """Return how many samples per second the learner of this process learns from."""
    started = time.perf_counter()
    for name, learner in LEARNERS.items():
        if name == "uavbench":
            for _ in range(updates):
                learner.advance()
        else:
            learner.learn(updates * ENVIRONMENTS, reset_num_timesteps=False)
    return updates * BATCH / (time.perf_counter() - started)


def speed(rounds, updates):
    """Return how many samples per second each learns from: the best of several rounds, in which they take turns."""
    spawn = multiprocessing.get_context("spawn")
    best = {"uavbench": 0.0, "Stable-Baselines3": 0.0}
    with contextlib.ExitStack() as stack:
        pools = {name: stack.enter_context(spawn.Pool(1, begin, (name,))) for name in best}
        for pool in pools.values():
            pool.apply(timed, (1,))
        for _ in range(rounds):
            for name, pool in pools.items():
                best[name] = max(best[name], pool.apply(timed, (updates,)))
    return best


class Curve(BaseCallback):
    """Scores Stable-Baselines3's policy every few minutes, and stops when the time is up, not counting the scoring."""

    def __init__(self, scenario, minutes, every):
        super().__init__()
        self.scenario, self.minutes, self.every, self.points = scenario, minutes, every, []

    def _on_training_start(self):
        self.started, self.scored = time.perf_counter(), 0.0

    def _on_step(self):
        spent = (time.perf_counter() - self.started - self.scored) / 60
        if spent >= self.every * (len(self.points) + 1):
            paused, source = time.perf_counter(), find_agent(__file__)
            source.load().model = self.model  # `evaluate` uses another copy of this module
            samples = self.model._n_updates * BATCH
            self.points.append(("Stable-Baselines3", round(spent, 2), samples, *score(source, self.scenario)))
            print(*self.points[-1], flush=True)
            self.scored += time.perf_counter() - paused
        return spent < self.minutes


def their_curve(minutes, every):
    """Train Stable-Baselines3's DQN for ``minutes`` minutes, and return the points of its curve."""
    torch.set_num_threads(1)
    scenario = load_scenario(SCENARIO)
    callback = Curve(scenario, minutes, every)
    theirs(scenario).learn(STEPS, callback=callback)
    return callback.points


def our_curve(minutes, every):
    """Train our DDQN as long, by ``fast`` with as many updates as fit, because its learning rate depends on their number."""
    torch.set_num_threads(1)
    keep_freed()  # as `uavbench train` does
    scenario = load_scenario(SCENARIO)
    rate = speed_of(scenario)
    learner = OURS.Learner(scenario, replace(OURS.CONFIGS["fast"], updates=int(60 * minutes * rate)), seed=0)
    points, spent = [], 0.0
    with tempfile.TemporaryDirectory() as folder:
        weights = Path(folder) / "ddqn.safetensors"
        while spent < 60 * minutes:
            started = time.perf_counter()
            learner.advance()
            spent += time.perf_counter() - started
            if spent >= 60 * every * (len(points) + 1):
                save_weights(weights, learner.weights(), {"agent": "ddqn", "scenario": scenario.id})
                points.append(("uavbench", round(spent / 60, 2), learner.samples, *score(find_agent(str(weights)), scenario)))
                print(*points[-1], flush=True)
    return points


def speed_of(scenario):
    """Return how many updates per second our DDQN makes."""
    learner = OURS.Learner(scenario, OURS.CONFIGS["fast"], seed=0)
    learner.advance()
    started = time.perf_counter()
    for _ in range(50):
        learner.advance()
    return 50 / (time.perf_counter() - started)


def score(source, scenario):
    """Return Landed, CR and CRAL on 200 validation episodes."""
    records = list(evaluate(Job(source, scenario, "validation"), range(200)))
    return [round(float(np.mean([getattr(record, name) for record in records])), 4) for name in METRICS]


def curves(minutes, every, out):
    """Train both at the same time; write the points of their curves and draw them."""
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        runs = [pool.apply_async(curve, (minutes, every)) for curve in (our_curve, their_curve)]
        points = [point for run in runs for point in run.get()]
    out.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame(points, columns=["library", "minutes", "samples", *METRICS])
    table.to_csv(out / "stable_baselines.csv", index=False)
    draw(table, out / "stable_baselines.png")


def draw(table, path):
    """Draw each metric against the minutes of training."""
    figure, axes = plt.subplots(1, len(METRICS), figsize=(9, 3.2), sharey=True, layout="constrained")
    for axis, metric, title in zip(axes, METRICS, ("Landed", "CR", "CRAL"), strict=True):
        for library, rows in table.groupby("library", sort=False):
            axis.plot(rows["minutes"], 100 * rows[metric], marker="o", markersize=3, label=library)
        axis.set_xlabel("minutes of training, one core")
        axis.set_title(f"{title}, %", fontsize=9)
    axes[1].legend(loc="lower right")
    figure.savefig(path, dpi=120)


def main():
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=("speed", "curves"))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--updates", type=int, default=20, help="updates in a round")
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--every", type=float, default=2.5, help="minutes between points")
    parser.add_argument("--out", type=Path, default=Path("runs"))
    options = parser.parse_args()
    if options.what == "speed":
        best = speed(options.rounds, options.updates)
        print("| | samples/s |\n| --- | ---: |")
        for name, rate in best.items():
            print(f"| {name} | {rate:,.0f} |")
        print(f"\nratio {best['uavbench'] / best['Stable-Baselines3']:.2f}")
        return
    curves(options.minutes, options.every, options.out)


if __name__ == "__main__":
    main()
