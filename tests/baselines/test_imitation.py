"""Imitation: a buffer that gives back what was seen, learning from advice, training that resumes."""

from dataclasses import replace

import numpy as np
import pytest
from learning import CPP, DH, check_resumes, torch, weights_of

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.agents.weights import WeightsError, load_weights
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.learning.train import train
from uavbench.learning.training import Training
from uavbench.planning.advice import NEVER
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator

SOURCE = find_agent("imitation")
IMITATION = SOURCE.module()
TEAM = load_scenario("Manhattan32-DH-Team-v0")
CITIES = load_scenario("Cities32-CPP-v0")
TINY = replace(
    IMITATION.CONFIGS["fast"],
    updates=12,
    num_envs=8,
    batch=16,
    buffer_size=500,
    learning_starts=40,
    first=500,
    mending=50,
    validation=6,
)


def training(config=TINY, scenario=CPP, seed=0):
    return Training(SOURCE, scenario, "tiny", config, seed)


@pytest.mark.parametrize("scenario", [CPP, DH, TEAM, CITIES], ids=["CPP", "DH", "team", "cities"])
def test_the_buffer_gives_back_what_was_seen(scenario):
    slots, random = np.arange(4), np.random.default_rng(0)
    simulator, observer = Simulator(scenario, 4), Observer(scenario)
    simulator.reset(slots, "train", slots)
    buffer, seen, number = IMITATION.Buffer(scenario, 48), {}, 0
    for _ in range(20):  # more than fit
        worths = np.full((4, scenario.max_uavs, 6), NEVER)
        worths[~simulator.state.done, 0] = number + np.arange((~simulator.state.done).sum())
        number += 100
        observation = observer.empty(4 * scenario.max_uavs)
        observer.write(simulator.state, np.arange(4 * scenario.max_uavs), observation)
        for i, u in np.argwhere(~simulator.state.done):
            seen[worths[i, u, 0]] = {name: part[i * scenario.max_uavs + u] for name, part in observation.items()}
        buffer.add(simulator.state, worths)
        actions = random.integers(5, size=simulator.state.done.shape)
        simulator.step(actions if scenario.team else actions[:, 0])
        over = np.flatnonzero(simulator.state.done.all(axis=1))
        if len(over):
            simulator.reset(over, "train", number + over)
    for k in range(10):
        observation, worths = buffer.sample(16, np.random.default_rng(k))
        for b, worth in enumerate(worths[:, 0].tolist()):
            assert worth >= 100 * (20 - 12)  # the newest twelve steps are kept
            for name, part in observation.items():
                np.testing.assert_array_equal(part[b].numpy(), seen[worth][name])


def test_learns_what_the_teacher_does(tmp_path):
    config = replace(TINY, updates=150, num_envs=16, batch=64, buffer_size=20_000, first=3_000, mending=300, validation=75)
    kept = train(training(config), tmp_path)
    curve = load_weights(kept)[1]["curve"]
    assert all(point["landed"] == 1.0 for point in curve)
    assert max(point["cral"] for point in curve) > 0.6


@pytest.mark.parametrize("scenario", [CPP, pytest.param(TEAM, marks=pytest.mark.slow), DH], ids=["CPP", "team", "DH"])
def test_a_training_that_goes_on_from_a_snapshot_ends_in_the_same_weights(scenario):
    check_resumes(lambda seed=0: IMITATION.Learner(scenario, TINY, seed), 12)


def test_ppo_goes_on_from_its_weights(tmp_path):
    kept, ppo = train(training(), tmp_path), find_agent("ppo")
    config = replace(ppo.module().CONFIGS["finish"], updates=2, num_envs=4, steps=8, minibatch=16, critic_first=1, validation=2)
    learner = ppo.module().Learner(CPP, config, 0)
    learner.start_from(kept)
    policy = {name: each.clone() for name, each in learner.network.state_dict().items()}
    assert {name: array.tobytes() for name, array in learner.weights().items()} == weights_of(kept)
    learner.advance()
    after = learner.network.state_dict()
    assert torch.equal(after["policy.weight"], policy["policy.weight"])  # at first only the value is learned
    assert not torch.equal(after["value.weight"], policy["value.weight"])
    learner.advance()
    assert not torch.equal(learner.network.state_dict()["policy.weight"], policy["policy.weight"])


def test_a_network_of_another_size_flies_and_is_gone_on_with(tmp_path):
    config = replace(TINY, updates=2, validation=2, channels=8, blocks=1)
    kept = train(Training(SOURCE, CPP, "tiny", config, 0), tmp_path)
    assert load_weights(kept)[0]["branches.local_map.0.weight"].shape[0] == 8
    assert len(list(evaluate(Job(find_agent(str(kept)), CPP, "test"), range(3)))) == 3
    ppo = find_agent("ppo")
    finish = replace(ppo.module().CONFIGS["finish"], updates=1, validation=1, num_envs=4, steps=8, channels=8, blocks=1)
    went_on = train(Training(ppo, CPP, "tiny", finish, 0, kept), tmp_path)
    assert len(list(evaluate(Job(find_agent(str(went_on)), CPP, "test"), range(3)))) == 3
    with pytest.raises(WeightsError, match="has shape"):
        train(Training(ppo, CPP, "wide", replace(finish, channels=16), 0, kept), tmp_path)
