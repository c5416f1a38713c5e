"""PPO: a network that is the same in all symmetries, advantages by their definition, masks that hold, training that resumes."""

from dataclasses import replace

import numpy as np
import pytest
from learning import CPP, DH, check_resumes, torch

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.agents.weights import load_weights
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.learning.train import train
from uavbench.learning.training import Training
from uavbench.simulation.observation import Observer

SOURCE = find_agent("ppo")
PPO = SOURCE.module()
TEAM = load_scenario("Manhattan32-DH-Team-v0")
TINY = replace(PPO.CONFIGS["fast"], updates=6, num_envs=8, steps=16, minibatch=64, epochs=2, validation=6)


def training(config=TINY, scenario=CPP, seed=0):
    return Training(SOURCE, scenario, "tiny", config, seed)


def observations(scenario, count):
    torch.manual_seed(0)
    return {name: torch.rand(count, *part.shape[1:]) for name, part in Observer(scenario).empty(1).items()}


@pytest.mark.parametrize("name", ["Manhattan32-CPP-v0", "Urban50-DH-v0", "Manhattan32-DH-Team-v0"])
def test_the_mean_over_symmetries_turns_with_the_map(name):
    scenario = load_scenario(name)
    network, seen = PPO.Network(scenario), observations(scenario, 3)
    scores = network.agreed(seen)
    middle = network.middle.clone()
    for symmetry in network.symmetries:
        turned = {name: symmetry.maps(part) if part.dim() == 4 else part for name, part in seen.items()}
        network.middle[:] = torch.stack(symmetry.direction(*middle))
        found = network.agreed(turned)[:, list(symmetry.actions)]
        torch.testing.assert_close(found, scores, atol=1e-5, rtol=1e-4)
    assert scores.exp().sum(dim=1).lt(1.0 + 1e-5).all()


def test_every_input_counts():
    network, seen = PPO.Network(TEAM), observations(TEAM, 2)
    before = network.evaluate(seen, team=torch.tensor([0, 0]))
    for name in seen:
        for found, was in zip(
            network.evaluate({**seen, name: seen[name] + 1.0}, team=torch.tensor([0, 0])), before, strict=True
        ):
            assert not torch.equal(found, was)
    alone = network.evaluate(seen)
    assert torch.equal(alone[0], before[0])  # who flies beside changes the value, not the decision
    assert not torch.equal(alone[1], before[1])


def test_returns_are_generalised_advantage_estimates():
    learner, random = PPO.Learner(CPP, TINY, 0), np.random.default_rng(0)
    steps = learner._steps
    for name in ("reward", "value"):
        steps[name][:] = random.normal(size=steps[name].shape)
    steps["over"][:] = random.random(steps["over"].shape) < 0.2
    onward = random.normal(size=steps["value"].shape[1]).astype(np.float32)
    found, discount, trace = learner._returns(onward), TINY.discount, TINY.trace
    values = np.vstack([steps["value"], onward])
    for b in range(8):
        for t in range(16):
            gain, factor = 0.0, 1.0
            for k in range(t, 16):
                goes_on = not steps["over"][k, b]
                gain += factor * (steps["reward"][k, b] + discount * goes_on * values[k + 1, b] - values[k, b])
                factor *= discount * trace
                if not goes_on:
                    break
            assert found[t, b] == pytest.approx(gain + values[t, b], abs=1e-4)


@pytest.mark.parametrize("scenario", [CPP, DH, TEAM], ids=["CPP", "DH", "team"])
def test_only_safe_actions_are_taken_in_training(scenario):
    learner = PPO.Learner(scenario, replace(TINY, random_start_fraction=0.0), 0)
    crashes = []
    step = learner._simulator.step

    def watched(actions):
        step(actions)
        state = learner._simulator.state
        crashes.append((state.done & ~state.landed).any())

    learner._simulator.step = watched
    for _ in range(4):
        found = learner.advance()
    assert len(crashes) == 4 * TINY.steps
    assert scenario.team or not any(crashes)  # in a team, another UAV may be in the way
    assert all(np.isfinite(value) for value in found.values())


@pytest.mark.slow
def test_learns_to_cover(tmp_path):
    config = replace(TINY, updates=40, num_envs=32, steps=32, minibatch=256, validation=20, random_start_fraction=0.0)
    kept = train(training(config), tmp_path)
    curve = load_weights(kept)[1]["curve"]
    assert all(point["landed"] == 1.0 for point in curve)
    assert max(point["cral"] for point in curve) > 0.55


@pytest.mark.parametrize("scenario", [CPP, TEAM], ids=["alone", "team"])
def test_a_training_that_goes_on_from_a_snapshot_ends_in_the_same_weights(scenario):
    check_resumes(lambda seed=0: PPO.Learner(scenario, TINY, seed), 4)


def test_switches_of_the_training_hold_for_the_agent(tmp_path):
    kept = train(training(replace(TINY, safe_mask=False, symmetries=False)), tmp_path)
    agent = find_agent(str(kept)).make(CPP)
    assert (agent._safe, agent._symmetries) == (False, False)
    records = list(evaluate(Job(find_agent(str(kept)), CPP, "test"), range(10), workers=0))
    assert len(records) == 10
