"""The belief planner sees no more than the observation, and always lands."""

import gymnasium as gym
import numpy as np
import pytest

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job, evaluate

SOURCE = find_agent("belief_planner")
NAMES = ("Manhattan32-CPP-v0", "Manhattan32-DH-v0")


def fly(name, agent, numbers):
    return list(evaluate(Job(find_agent(agent), load_scenario(name), "validation"), numbers))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_lands_and_beats_greedy_which_sees_everything(name):
    records = fly(name, "belief_planner", range(2))
    assert all(record.landed for record in records)
    assert np.mean([r.cral for r in records]) > np.mean([r.cral for r in fly(name, "greedy", range(2))])


def test_is_asked_by_the_observation_alone():
    assert SOURCE.load().track == "observation"
    with pytest.raises(ValueError, match="Team"):
        SOURCE.load()(load_scenario("Manhattan32-CPP-Team-v0"))


@pytest.mark.slow
def test_what_is_said_of_the_episode_changes_nothing():
    """Its number and its split would tell everything."""
    scenario = load_scenario("Block8-CPP-v0")
    env = gym.make("uavbench:uavbench/Block8-CPP-v0", disable_env_checker=True)
    flown = []
    for change in ({"seed": 1}, {"seed": 1, "episode": 7, "episode_number": 7, "split": "train"}):
        observation, info = env.reset(options={"split": "test", "episode": 3})
        agent, actions, done = SOURCE.make(scenario), [], False
        agent.reset({**info, **change})
        while not done:
            actions.append(int(agent.act(observation, {**info, **change})))
            observation, _, done, _, info = env.step(actions[-1])
        flown.append(actions)
    assert flown[0] == flown[1]
    assert len(flown[0]) > 5


def test_its_old_name_still_leads_to_it():
    old = find_agent("pilot")
    assert (old.name, old.path, old.built_in) == (SOURCE.name, SOURCE.path, True)
