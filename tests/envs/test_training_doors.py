"""What training asks of the environments: episodes that start anywhere, and safe actions."""

import gymnasium as gym
import numpy as np
import pytest

import uavbench

CPP, DH, TEAM = "Manhattan32-CPP-v0", "Manhattan32-DH-v0", "Manhattan32-DH-Team-v0"


def test_episodes_start_anywhere_with_a_budget_that_suffices_to_land():
    env = uavbench.make(CPP, start="anywhere")
    city, cells, budgets = env.simulator.city, set(), set()
    for _ in range(300):
        env.reset(seed=None if cells else 0)
        position, budget = tuple(env.simulator.state.position[0, 0].tolist()), int(env.simulator.state.budget[0, 0])
        assert city.distance_to_landing[position] + 1 <= budget <= env.scenario.budget[1]
        assert env.episode == ("custom", -1)
        cells.add(position)
        budgets.add(budget)
    assert len(cells) > 200
    assert min(budgets) < 20 < 140 < max(budgets)
    env.reset(options={"start": "landing"})
    assert env.episode[0] == "train"


def test_one_reset_can_ask_for_it_and_set_the_rest_by_hand():
    env = uavbench.make(DH)
    env.reset(seed=0, options={"start": "anywhere", "budget": 77})
    first = env.simulator.state.position.copy()
    assert env.simulator.state.budget[0, 0] == 77
    env.reset(seed=0, options={"start": "anywhere"})
    assert np.array_equal(env.simulator.state.position, first)  # drawn from the episode's key
    before = env.simulator.get_state()
    with pytest.raises(ValueError, match="budget"):
        env.simulator.customise(0, {"start": "anywhere", "budget": 10_000})
    after = env.simulator.get_state()
    assert all(np.array_equal(array, after.arrays[name]) for name, array in before.arrays.items())


@pytest.mark.parametrize("name", [CPP, DH])
def test_the_vector_environment_does_the_same_to_the_last_bit(name):
    made = {
        mode: gym.make_vec(f"uavbench/{name}", num_envs=3, vectorization_mode=mode, start="anywhere", safe_action_mask=True)
        for mode in ("sync", "vector_entry_point")
    }
    random = np.random.default_rng(0)
    seen = {mode: envs.reset(seed=5) for mode, envs in made.items()}
    for _ in range(250):
        actions = random.integers(0, 6, 3)
        for key in ("action_mask", "safe_action_mask", "_safe_action_mask", "episode_number"):
            assert np.array_equal(*(step[-1][key] for step in seen.values()))
        for key in ("local", "global", "budget"):
            assert np.array_equal(*(step[0][key] for step in seen.values()))
        seen = {mode: envs.step(actions) for mode, envs in made.items()}


def test_a_flight_of_safe_actions_alone_always_lands():
    env = uavbench.make(CPP, start="anywhere", safe_action_mask=True)
    random = np.random.default_rng(1)
    for _ in range(30):
        _, info = env.reset(seed=int(random.integers(2**31)))
        done = False
        while not done:
            safe = np.flatnonzero(info["safe_action_mask"] * info["action_mask"])
            _, _, done, _, info = env.step(random.choice(safe))
        assert info["landed"]


def test_safe_actions_by_brute_force():
    env = uavbench.make(CPP, safe_action_mask=True)
    city = env.simulator.city
    for seed in range(20):
        env.reset(seed=seed, options={"start": "anywhere", "budget": 1 + seed})
        state = env.get_state()
        possible = []
        for action in range(6):
            env.set_state(state)
            _, _, done, _, info = env.step(action)
            left, here = int(env.simulator.state.budget[0, 0]), tuple(env.simulator.state.position[0, 0].tolist())
            possible.append(bool(info["landed"]) if done else city.distance_to_landing[here] + 1 <= left)
        env.set_state(state)
        found = env.simulator.safe_action_mask()[0].astype(bool).tolist()
        assert found == (possible if any(possible) else [True] * 6)


def test_teams_have_both_doors():
    env = uavbench.parallel_env(TEAM, start="anywhere", safe_action_mask=True, budget=(20, 40))
    _, infos = env.reset(seed=0)
    assert {info["safe_action_mask"].shape for info in infos.values()} == {(6,)}
    assert env.episode == ("custom", -1)


def test_without_being_asked_nothing_changes():
    plain, asked = uavbench.make(CPP), uavbench.make(CPP, start="landing", safe_action_mask=False)
    for seed in range(3):
        (a, b), (c, d) = plain.reset(seed=seed), asked.reset(seed=seed)
        assert b.keys() == d.keys()
        assert all(np.array_equal(a[name], c[name]) for name in a)
        assert plain.episode == asked.episode


@pytest.mark.parametrize("make", [uavbench.make, uavbench.make_vec, uavbench.parallel_env, uavbench.parallel_vec])
def test_an_unknown_argument_is_refused_in_pythons_own_words(make):
    """TorchRL tries ``frameskip``, and goes on without it if it reads these words."""
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
        make("Block8-CPP-v0", frameskip=1)
