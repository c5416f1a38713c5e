"""The time to get a state and to set it again, as tree searches do, compared with a step of the environment.

Usage: python benchmarks/states.py [--rounds 30]. Prints Markdown. All measurements take turns in every round, and the best
round of each counts, so that a busy machine disturbs all of them alike.
"""

import argparse
import copy
import time

import gymnasium as gym
import numpy as np

import uavbench

NAMES = ("Manhattan32-CPP-v0", "Urban50-CPP-v0", "Manhattan32-DH-v0", "Urban50-DH-v0")
NUM_ENVS = 256
STEPS = 60


def microseconds(function, count):
    """Return the wall time of a call in microseconds, as the mean of ``count`` calls."""
    started = time.perf_counter()
    for _ in range(count):
        function()
    return 1e6 * (time.perf_counter() - started) / count


def measures(name):
    """Return what is measured on a scenario, by name: a function, its calls in a round, and the steps in each call."""
    env = gym.make(f"uavbench/{name}").unwrapped
    envs = gym.make_vec(f"uavbench/{name}", NUM_ENVS, vectorization_mode="vector_entry_point")
    env.reset(seed=0, options={"budget": env.scenario.budget[1]})
    envs.reset(seed=0)
    state, states, one = env.get_state(), envs.get_state(), envs.get_state([0])
    hover = np.full(NUM_ENVS, 4)

    def step():
        env.set_state(state)
        for _ in range(STEPS):
            env.step(4)

    return {
        "step": (step, 1, STEPS),
        "get_state": (env.get_state, 50, 1),
        "set_state": (lambda: env.set_state(state), 50, 1),
        "deepcopy": (lambda: copy.deepcopy(env), 5, 1),
        f"step of {NUM_ENVS}": (lambda: envs.step(hover), 20, 1),
        f"get_state of {NUM_ENVS}": (envs.get_state, 20, 1),
        f"set_state of {NUM_ENVS}": (lambda: envs.set_state(states), 20, 1),
        f"one state into {NUM_ENVS}": (lambda: envs.set_state(one), 20, 1),
    }


def main():
    """Measure, and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=30)
    rounds = parser.parse_args().rounds
    print(f"uavbench {uavbench.__version__}; µs per call\n")
    for k, name in enumerate(NAMES):
        measured = measures(name)
        best = dict.fromkeys(measured, np.inf)
        for _ in range(rounds):
            for what, (function, count, steps) in measured.items():
                best[what] = min(best[what], microseconds(function, count) / steps)
        if k == 0:
            print("| | " + " | ".join(best) + " | (get + set) / step |")
            print("| --- |" + " ---: |" * (len(best) + 1))
        ratio = (best["get_state"] + best["set_state"]) / best["step"]
        print(f"| {name} | " + " | ".join(f"{value:,.1f}" for value in best.values()) + f" | {ratio:.2f} |")


if __name__ == "__main__":
    main()
