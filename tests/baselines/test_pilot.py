"""Pilot sees no more than the observation, always lands, and learns to complete the map."""

import os
import signal
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.agents.weights import load_weights
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.learning.train import Training, train

torch = pytest.importorskip("torch", reason="pilot needs PyTorch: pip install 'uavbench[ddqn]'")

SOURCE = find_agent("pilot")
PILOT = SOURCE.module()
NAMES = ("Manhattan32-CPP-v0", "Manhattan32-DH-v0")


def fly(name, agent, numbers):
    return list(evaluate(Job(find_agent(agent), load_scenario(name), "validation"), numbers))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_lands_and_beats_greedy_which_sees_everything(name):
    records = fly(name, "pilot", range(2))
    assert all(record.landed for record in records)
    assert np.mean([r.cral for r in records]) > np.mean([r.cral for r in fly(name, "greedy", range(2))])


def test_is_asked_by_the_observation_alone():
    assert SOURCE.load().track == "observation"
    with pytest.raises(ValueError, match="Team"):
        SOURCE.load()(load_scenario("Manhattan32-CPP-Team-v0"))


@pytest.mark.slow
def test_learning_makes_fewer_cells_wrong():
    config = replace(PILOT.CONFIGS["fast"], updates=30, episodes=8, views=4)
    learner = PILOT.Learner(load_scenario("Manhattan32-CPP-v0"), config, 0)
    scores = [learner.advance() for _ in range(config.updates)]
    wrong, before = (np.mean([score[key] for score in scores[-8:]]) for key in ("wrong", "wrong before"))
    assert wrong < before


def test_training_that_is_interrupted_ends_as_if_it_had_not_been(tmp_path):
    scenario = load_scenario("Manhattan32-CPP-v0")
    config = replace(PILOT.CONFIGS["fast"], updates=4, episodes=2, views=3, validation=4, validation_episodes=1)
    training = Training(SOURCE, scenario, "tiny", config, 0)
    whole = train(training, tmp_path / "whole")

    def interrupt(updates):
        if updates == 2:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train(training, tmp_path / "parts", on_update=interrupt)
    parts = train(training, tmp_path / "parts", resume=True)
    for ours, theirs in ((whole, parts), (training.files(tmp_path / "whole")[1], training.files(tmp_path / "parts")[1])):
        ours, theirs = load_weights(ours)[0], load_weights(theirs)[0]
        assert ours.keys() == theirs.keys()
        assert all(np.array_equal(ours[name], theirs[name]) for name in ours)


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


def test_dh_needs_no_training():
    with pytest.raises(ValueError, match="learns nothing in DH"):
        PILOT.Learner(load_scenario("Block8-DH-v0"), PILOT.CONFIGS["fast"], 0)
