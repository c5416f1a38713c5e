"""Do the rules hold for long? Many steps of every scenario and adapter under random and adversarial actions, each one checked.

Usage: python benchmarks/soak.py [--steps 100_000_000] [--seed 0] [--only Urban50]. Prints Markdown: for each scenario how many
steps of UAVs were checked and how fast, and the memory of the process after each tenth of the steps. It stops with the first
rule that is broken, and says where. Steps are shared so that each scenario has about the same time.

What is checked after each step, in all slots: targets do not grow, and no data are below 0; a UAV that flies loses one unit
of its budget; positions are on the map and, of UAVs that fly, not in a no-fly zone; a move that the mask calls valid is flown
(in a team another UAV may be in the way), and one that it calls invalid is not; after a safe action, landing is possible;
rewards are finite. At the end of an episode: CR and CRAL are in [0, 1], and CRAL is CR or 0. In the environments: observations
are in their spaces, rewards and outcomes are finite, and masks have the right shape.
"""

import argparse
import os
import time
from pathlib import Path

import gymnasium as gym
import numpy as np

import uavbench
from uavbench.simulation.simulator import Simulator
from uavbench.world.city import HOVER, LAND, NUM_ACTIONS

STEPS = np.array([(-1, 0), (0, 1), (1, 0), (0, -1), (0, 0), (0, 0)])
POLICIES = ("random", "blocked", "safe", "hovering", "landing")
EPSILON = 1e-9
TENTHS = 10


def resident():
    """Return the memory of this process in MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


class BrokenError(AssertionError):
    """A rule does not hold."""


def must(condition, rule, where):
    """Raise a BrokenError if a condition does not hold everywhere."""
    if not np.all(condition):
        raise BrokenError(f"{where}: {rule}")


class Soak:
    """The simulator of one scenario under actions that are drawn at random."""

    def __init__(self, name, seed):
        self.scenario = uavbench.load_scenario(name)
        cells = self.scenario.shape[0] * self.scenario.shape[1]
        self.slots = int(np.clip(2**19 // cells, 4, 256))
        self.simulator = Simulator(self.scenario, self.slots)
        self.random, self.name = np.random.default_rng(seed), name
        self.next = self.steps = self.episodes = 0
        self.totals = np.zeros(self.slots)
        self._begin(np.arange(self.slots))

    def _begin(self, slots):
        """Start the next train or test episodes."""
        split = "train" if self.random.random() < 0.9 else "test"
        size = 10**6 if split == "train" else self.scenario.splits.test.episodes
        self.simulator.reset(slots, split, (self.next + np.arange(len(slots))) % size)
        self.next += len(slots)
        self.totals[slots] = 0.0

    def _choose(self, policy, valid, safe):
        """Return an action for each UAV, shape (B, U)."""
        scores = self.random.random(valid.shape)
        if policy == "blocked":
            scores -= 2.0 * valid
        elif policy == "safe":
            scores += 2.0 * (valid & safe)
            scores[..., LAND] -= 1.0  # flies until it must land
        elif policy in ("hovering", "landing"):
            scores[..., HOVER if policy == "hovering" else LAND] += 0.9
        return scores.argmax(axis=-1)

    def step(self, policy):
        """Take one step in every slot, and check it."""
        simulator, state, where = self.simulator, self.simulator.state, f"{self.name}, {policy}, step {self.steps}"
        shape = (*state.done.shape, NUM_ACTIONS)
        valid, safe = (mask.reshape(shape) > 0 for mask in (simulator.action_mask(), simulator.safe_action_mask()))
        actions = self._choose(policy, valid, safe)
        target, place, budget = state.target.copy(), state.position.copy(), state.budget.copy()
        flew, blocked = ~state.done, state.blocked.copy()
        able = self._home() < budget
        simulator.step(actions if self.scenario.team else actions[:, 0])
        self.steps += int(flew.sum())
        self.totals += state.reward.sum(axis=1)
        must(np.isfinite(state.reward), "a reward is not finite", where)
        must((state.target >= 0.0) & (state.target <= target), "a target grew, or is below 0", where)
        must(state.budget[flew] == budget[flew] - 1, "a budget did not fall by one", where)
        must((state.budget == budget)[~flew], "the budget of a UAV that does not fly changed", where)
        rows, cols = self.scenario.shape
        must((state.position >= 0) & (state.position < (rows, cols)), "a UAV is not on the map", where)
        must(~self._in_no_fly()[flew], "a UAV is in a no-fly zone", where)
        chosen = np.take_along_axis(valid, actions[..., None], axis=-1)[..., 0]
        moved, stayed = (state.position == place + STEPS[actions]).all(axis=-1), (state.position == place).all(axis=-1)
        refused, is_move = flew & ~chosen, actions < HOVER
        must((stayed & (state.blocked == blocked + is_move))[refused], "an invalid action was not blocked", where)
        must(~state.landed[refused], "a UAV landed where it may not", where)
        if not self.scenario.team:
            must((moved & (state.blocked == blocked))[flew & chosen], "a valid action was blocked", where)
            careful = np.take_along_axis(safe, actions[..., None], axis=-1)[..., 0]
            must((state.landed | (self._home() < state.budget))[flew & chosen & careful & able], "a safe action was not", where)
        over = np.flatnonzero(state.done.all(axis=1) & flew.any(axis=1))
        if len(over):
            found = simulator.outcomes(over)
            must((found["cr"] >= 0) & (found["cr"] <= 1 + EPSILON), "CR is not in [0, 1]", where)
            must(found["cral"] == np.where(found["landed"], found["cr"], 0.0), "CRAL is not CR of what landed", where)
            must(np.isfinite(self.totals[over]), "a return is not finite", where)
            self.episodes += len(over)
            self._begin(over)

    def _of_city(self, name):
        """Return a table of each slot's city at the UAVs' cells, shape (B, U)."""
        r, c = self.simulator.state.position[..., 0], self.simulator.state.position[..., 1]
        if self.scenario.cities is None:
            return getattr(self.simulator.city, name)[r, c]
        return np.array([getattr(self.simulator.city_at(i), name)[r[i], c[i]] for i in range(self.slots)])

    def _home(self):
        """Return the moves to the nearest landing cell; more than any budget where there is none."""
        moves = self._of_city("distance_to_landing")
        return np.where(moves >= 0, moves, 10**6)

    def _in_no_fly(self):
        """Return whether the UAVs are where nobody may fly."""
        return self._of_city("no_fly")


def adapters(name, seed, steps):
    """Check the environments of a scenario for some steps; return how many steps of UAVs that were."""
    scenario, random, count = uavbench.load_scenario(name), np.random.default_rng(seed), 0
    envs = gym.make_vec(f"uavbench/{name}", 4, vectorization_mode="vector_entry_point") if not scenario.team else None
    if envs is not None:
        envs.reset(seed=seed)
        for _ in range(steps // 8):
            observations, rewards, *_ = envs.step(random.integers(0, NUM_ACTIONS, 4))
            must(np.isfinite(rewards), "a reward is not finite", f"{name}, vector environment")
            for part, values in observations.items():
                must(np.isfinite(values), f"{part} is not finite", f"{name}, vector environment")
            count += 4
        env = uavbench.make(name)
        while count < steps:
            observation, info = env.reset(seed=int(random.integers(2**31)))
            over, total = False, 0.0
            while not over:
                must(np.shape(info["action_mask"]) == (NUM_ACTIONS,), "the mask has another shape", f"{name}, environment")
                observation, reward, terminated, truncated, info = env.step(int(random.integers(NUM_ACTIONS)))
                over, total, count = terminated or truncated, total + reward, count + 1
                must(env.observation_space.contains(observation), "the observation is not in its space", f"{name}, environment")
            must(np.isfinite(total) and 0.0 <= info["cr"] <= 1.0 + EPSILON, "an outcome is impossible", f"{name}, environment")
        return count
    env = uavbench.parallel_env(name)
    while count < steps:
        env.reset(seed=int(random.integers(2**31)))
        while env.agents:
            actions = {agent: int(random.integers(NUM_ACTIONS)) for agent in env.agents}
            count += len(actions)
            observations, rewards, *_ = env.step(actions)
            must(np.isfinite(list(rewards.values())), "a reward is not finite", f"{name}, team environment")
            for agent, observation in observations.items():
                must(env.observation_space(agent).contains(observation), "an observation is not in its space", name)
    return count


def main():
    """Check all scenarios, and print what was checked."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=100_000_000, help="steps of UAVs, in all scenarios together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="scenarios whose id contains this")
    options = parser.parse_args()
    names = [name for name in uavbench.list_scenarios() if options.only in name]
    soaks = [Soak(name, options.seed) for name in names]
    spent, done, memory, round_number = dict.fromkeys(names, 0.0), 0, [], 0
    started = time.perf_counter()
    while done < options.steps:
        soak = min(soaks, key=lambda each: spent[each.name])  # each scenario has the same time
        before = time.perf_counter()
        for _ in range(50):
            soak.step(POLICIES[round_number % len(POLICIES)])
            if time.perf_counter() - before > 1.0:
                break
        spent[soak.name] += time.perf_counter() - before
        round_number += 1
        done = sum(each.steps for each in soaks)
        while len(memory) < TENTHS * min(1.0, done / options.steps) - 1e-9:
            memory.append(resident())
    print("| scenario | steps | episodes | steps/s |\n| --- | ---: | ---: | ---: |")
    for soak in soaks:
        print(f"| {soak.name} | {soak.steps:,} | {soak.episodes:,} | {soak.steps / spent[soak.name]:,.0f} |")
    through = sum(adapters(name, options.seed, min(2_000, options.steps // 100)) for name in names)
    print(
        f"\n{done:,} steps in {time.perf_counter() - started:.0f} s, and {through:,} through the environments: no rule broken."
    )
    print(f"Memory after each tenth of the steps, MB: {', '.join(f'{each:.0f}' for each in memory)}.")
    middle, end = memory[TENTHS // 2 - 1], memory[-1]
    must(end <= 1.05 * middle, f"memory grew from {middle:.0f} to {end:.0f} MB", "soak")


if __name__ == "__main__":
    main()
