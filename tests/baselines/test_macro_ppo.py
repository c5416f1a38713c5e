"""PPO over macro-actions: logits that turn with the map, semi-Markov returns by their definition, training that resumes."""

import itertools
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

SOURCE = find_agent("macro_ppo")
MACRO = SOURCE.module()
CITY = load_scenario("Manhattan32-CPP-v0")
TINY = replace(
    MACRO.CONFIGS["fast"], updates=6, num_envs=8, steps=16, minibatch=64, epochs=2, validation=6, random_start_fraction=0.0
)


def training(config=TINY, scenario=CPP):
    return Training(SOURCE, scenario, "tiny", config, 0)


def test_the_logits_of_cells_turn_with_the_map():
    torch.manual_seed(0)
    seen = {name: torch.rand(3, *part.shape[1:]) for name, part in Observer(CITY).empty(1).items()}
    network, side = MACRO.MapNetwork(CITY), CITY.observation.local_size
    scores, middle = network.agreed(seen), network.middle.clone()
    assert scores.shape == (3, side**2 + 1)
    torch.testing.assert_close(scores.exp().sum(dim=1) < 1.0 + 1e-5, torch.ones(3, dtype=torch.bool))
    assert (scores[:, :-1].std(dim=1) > 0).all()
    for symmetry in network.symmetries:
        turned = {name: symmetry.maps(part) if part.dim() == 4 else part for name, part in seen.items()}
        network.middle[:] = torch.stack(symmetry.direction(*middle))
        found = network.agreed(turned)
        cells = symmetry.restored(found[:, :-1].reshape(-1, side, side)).flatten(1)
        torch.testing.assert_close(torch.cat([cells, found[:, -1:]], dim=1), scores, atol=1e-5, rtol=1e-4)


def test_every_input_counts():
    torch.manual_seed(0)
    seen = {name: torch.rand(2, *part.shape[1:]) for name, part in Observer(CITY).empty(1).items()}
    network = MACRO.MapNetwork(CITY)
    before = network.evaluate(seen)
    for name in seen:
        for found, was in zip(network.evaluate({**seen, name: seen[name] + 1.0}), before, strict=True):
            assert not torch.equal(found, was)


@pytest.mark.parametrize("kind", ["cells", "directions"])
@pytest.mark.parametrize("scenario", [CPP, DH], ids=["CPP", "DH"])
def test_returns_are_those_of_a_semi_markov_process(scenario, kind):
    """Against a slow computation from the moves that were flown."""
    config = replace(TINY, kind=kind, discount=0.9, trace=0.8)
    learner = MACRO.Learner(scenario, config, 0)
    for _ in range(3):  # episodes are in their middle then
        learner.advance()
    moves, step = [], learner._simulator.step

    def watched(actions):
        step(actions)
        state = learner._simulator.state
        moves.append((state.reward[:, 0].copy(), state.done[:, 0].copy()))

    learner._simulator.step = watched
    onward = learner._collect(learner.network.symmetries[0], np.random.default_rng(0))
    found, steps, gamma = learner._returns(onward), learner._steps, learner._between("discount")
    assert len(moves) == config.steps
    assert steps["flies"][0].all()
    durations = []
    for b in range(config.num_envs):
        begins = [*np.flatnonzero(steps["flies"][:, b]).tolist(), config.steps]
        values = [*(float(steps["value"][t, b]) for t in begins[:-1]), float(onward[b])]
        errors, factors = [], []
        for k, (t, end) in enumerate(itertools.pairwise(begins)):
            over = bool(moves[end - 1][1][b])
            assert not any(moves[at][1][b] for at in range(t, end - 1))  # whoever has landed decides anew
            earned = sum(gamma**j * config.reward_scale * float(moves[t + j][0][b]) for j in range(end - t))
            factors.append(0.0 if over else gamma ** (end - t))
            errors.append(earned + factors[-1] * values[k + 1] - values[k])
            durations.append(end - t)
        gain = 0.0
        for k in reversed(range(len(errors))):
            gain = errors[k] + factors[k] * config.trace * gain
            assert found[begins[k], b] == pytest.approx(gain + values[k], abs=1e-4)
    assert max(durations) > 1


@pytest.mark.parametrize("kind", ["cells", "directions"])
def test_only_safe_moves_are_flown_in_training(kind):
    learner = MACRO.Learner(CPP, replace(TINY, kind=kind), 0)
    crashes, step = [], learner._simulator.step

    def watched(actions):
        step(actions)
        state = learner._simulator.state
        crashes.append((state.done & ~state.landed).any())

    learner._simulator.step = watched
    for _ in range(4):
        found = learner.advance()
    assert len(crashes) == 4 * TINY.steps
    assert not any(crashes)
    assert all(np.isfinite(value) for value in found.values())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cells", "directions"])
def test_learns_to_cover(kind, tmp_path):
    config = replace(TINY, kind=kind, updates=40, num_envs=32, steps=32, minibatch=128, validation=20)
    kept = train(training(config), tmp_path)
    curve = load_weights(kept)[1]["curve"]
    assert all(point["landed"] == 1.0 for point in curve)
    assert max(point["cral"] for point in curve) > 0.55
    agent = find_agent(str(kept)).make(CPP)
    assert agent.kind == kind
    assert len(list(evaluate(Job(find_agent(str(kept)), CPP, "test"), range(5)))) == 5


def test_a_training_that_goes_on_from_a_snapshot_ends_in_the_same_weights():
    check_resumes(lambda seed=0: MACRO.Learner(CPP, TINY, seed), 4)


def test_what_it_cannot_learn_is_said():
    with pytest.raises(ValueError, match="Manhattan32-CPP-Team-v0 is for teams"):
        MACRO.Learner(load_scenario("Manhattan32-CPP-Team-v0"), TINY, 0)
    with pytest.raises(ValueError, match="'cell' is not one of cells, directions"):
        MACRO.Learner(CPP, replace(TINY, kind="cell"), 0)
