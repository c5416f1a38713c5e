"""Learners that decide by macro-actions fly as those that decide by single actions, and so do agents."""

from pathlib import Path

import numpy as np
import pytest

import uavbench
from uavbench.agents.agent import find_agent
from uavbench.envs.macro_actions import MacroActions, VectorMacroActions
from uavbench.evaluation.evaluate import Job, evaluate

KINDS = ("cells", "directions")
NAMES = ("Block8-CPP-v0", "Block8-DH-v0", "Cities32-CPP-v0")
AGENT = """
from uavbench.agents.macro_actions import MacroAgent

class Agent(MacroAgent):
    kind = "{kind}"
    def choose(self, observation, mask, info):
        return mask.nonzero()[0][int(observation["budget"][0]) * 7919 % mask.sum()]
"""


def choose(observation, mask):
    """A macro-action that can begin, different ones in the course of an episode."""
    return int(mask.nonzero()[0][int(observation["budget"][0]) * 7919 % mask.sum()])


def alone(name, kind, episode, discount=0.9):
    """A flight by macro-actions: rewards, durations, and the metrics at its end."""
    env = MacroActions(uavbench.make(name, safe_action_mask=True), kind, discount)
    observation, info = env.reset(options={"split": "test", "episode": episode})
    found, terminated = [], False
    while not terminated:
        action = choose(observation, info["macro_action_mask"])
        observation, reward, terminated, _, info = env.step(action)
        found.append((reward, info["duration"]))
        assert info["discount"] == pytest.approx(discount ** info["duration"])
    return found, info


class Recorder:
    """An environment that writes down what it is asked."""

    def __init__(self, env):
        self._env, self.actions, self.rewards = env, [], []

    def step(self, action):
        found = self._env.step(action)
        self.actions.append(action)
        self.rewards.append(found[1])
        return found

    def __getattr__(self, name):
        return getattr(self._env, name)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NAMES)
def test_rewards_are_discounted_sums_over_the_moves(name, kind):
    env = MacroActions(uavbench.make(name, safe_action_mask=True), kind, 0.9)
    env.env = Recorder(env.env)
    observation, info = env.reset(seed=3)
    terminated = False
    while not terminated:
        before = len(env.env.rewards)
        observation, reward, terminated, _, info = env.step(choose(observation, info["macro_action_mask"]))
        moved = env.env.rewards[before:]
        assert info["duration"] == len(moved) >= 1
        assert reward == pytest.approx(sum(0.9**k * each for k, each in enumerate(moved)))
    assert info["landed"]  # only safe actions were flown
    assert max(info["action_mask"].shape) == 6


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("kind", KINDS)
def test_slots_of_a_vector_environment_fly_as_environments_alone(kind, mode):
    name, number = "Block8-CPP-v0", 3
    expected = [alone(name, kind, episode) for episode in range(number)]
    envs = VectorMacroActions(uavbench.make_vec(name, number, safe_action_mask=True, autoreset_mode=mode), kind, discount=0.9)
    observation, info = envs.reset(options={"split": "test", "episode": list(range(number))})
    found, over = [[] for _ in range(number)], np.zeros(number, dtype=bool)
    while not over.all():
        masks = info["macro_action_mask"]
        actions = [choose({"budget": observation["budget"][i]}, masks[i]) for i in range(number)]
        observation, rewards, terminated, _, info = envs.step(actions)
        assert info["decides"].any()
        assert not rewards[~info["decides"]].any()
        for i in np.flatnonzero(info["decides"] & ~over).tolist():
            found[i].append((rewards[i], info["duration"][i]))
        over |= terminated
    for i, (flight, _) in enumerate(expected):
        assert [moves for _, moves in found[i]] == [moves for _, moves in flight]
        assert [reward for reward, _ in found[i]] == pytest.approx([reward for reward, _ in flight])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NAMES)
def test_agents_fly_as_the_wrapper(name, kind, tmp_path):
    path = Path(tmp_path) / "mine.py"
    path.write_text(AGENT.format(kind=kind), encoding="utf-8")
    scenario = uavbench.load_scenario(name)
    for record in evaluate(Job(find_agent(str(path)), scenario, "test"), range(3)):
        flight, info = alone(name, kind, record.episode)
        assert (record.landed, record.cr) == (info["landed"], pytest.approx(info["cr"]))
        assert len(record.actions) == sum(moves for _, moves in flight)


def test_wrong_actions_are_refused_and_change_nothing():
    env = MacroActions(uavbench.make("Block8-CPP-v0"))
    with pytest.raises(RuntimeError, match="reset"):
        env.step(0)
    _, info = env.reset(seed=1)
    closed = int(np.flatnonzero(info["macro_action_mask"] == 0)[0])
    for action, message in ((env.action_space.n, "not one integer"), (closed, "cannot begin")):
        with pytest.raises(ValueError, match=message):
            env.step(action)
    envs = VectorMacroActions(uavbench.make_vec("Block8-CPP-v0", 2))
    _, info = envs.reset(seed=1)
    good = [int(mask.nonzero()[0][0]) for mask in info["macro_action_mask"]]
    for actions, message in (([good[0]], "1 actions for 2"), ([good[0], -1], "not one integer")):
        with pytest.raises(ValueError, match=message):
            envs.step(actions)
    envs.step(good)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="local map"):
        MacroActions(uavbench.make("Block8-CPP-v0", local_size=0))
    with pytest.raises(ValueError, match="discount"):
        MacroActions(uavbench.make("Block8-CPP-v0"), discount=1.5)
    with pytest.raises(ValueError, match="autoreset_mode"):
        VectorMacroActions(uavbench.make_vec("Block8-CPP-v0", 2, autoreset_mode="Disabled"))
    with pytest.raises(ValueError, match="cells, directions"):
        MacroActions(uavbench.make("Block8-CPP-v0"), "cell")
