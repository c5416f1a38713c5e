"""The simulator keeps the rules of the world: it agrees with the oracle everywhere."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import Oracle
from worlds import COVERAGE, HARVESTING, SIZES, draw_devices, draw_start, draw_targets, maps, scenario

from uavbench import load_scenario
from uavbench.envs.env import UAVEnv
from uavbench.simulation.simulator import Simulator

NORTH, EAST, SOUTH, WEST, HOVER, LAND = range(6)
OPEN = ("....", ".LL.", "...N", "..#.", "....")


def start(rows=OPEN, mission=COVERAGE, budget=20, **options):
    env = UAVEnv(scenario(rows, mission))
    options.setdefault("start", [1, 1])
    if mission is COVERAGE:
        targets = np.zeros((len(rows), len(rows[0])), bool)
        targets[-1, -1] = True
        options.setdefault("targets", targets)
    env.reset(seed=0, options={"budget": budget, **options})
    return env


def check_step(env, oracle, action, exact):
    observation, reward, terminated, truncated, info = env.step(action)
    expected = oracle.step(action)
    state = env.simulator.state
    assert tuple(state.position[0, 0]) == oracle.p
    assert state.budget[0] == oracle.b
    assert (terminated, truncated) == (oracle.done, False)
    assert info["action_mask"].tolist() == oracle.mask()
    if exact:
        assert reward == expected
        assert np.array_equal(state.target[0], oracle.D)
    else:
        assert reward == pytest.approx(expected, abs=1e-9)
        data = env.simulator.mission.view(0)["device_data"]
        assert data == pytest.approx([left for _, left in oracle.devices], abs=1e-9)
    if terminated:
        assert info["landed"] == oracle.landed
        assert info["blocked"] == oracle.blocked
        assert info["cr"] == pytest.approx(oracle.cr(), abs=1e-12 if exact else 1e-9)
        assert info["cral"] == info["cr"] * info["landed"]
    check_observation(env, oracle, observation, exact)


def check_observation(env, oracle, observation, exact):
    sizes = env.scenario.observation
    for name, expected in oracle.observation(sizes.local_size, sizes.global_scale).items():
        found = observation[name]
        assert found.dtype == np.float32
        if name == "budget":
            assert np.array_equal(found, expected)
            continue
        assert np.array_equal(found[:3], expected[:3].astype(np.float32))
        if exact:
            assert np.array_equal(found[3], expected[3].astype(np.float32))
        else:  # data is kept in float64 and shown in float32: two roundings apart at most
            np.testing.assert_allclose(found[3], expected[3], rtol=3e-7, atol=1e-9)


@settings(max_examples=150)
@given(st.data(), maps(), SIZES, st.sampled_from([1, 3, 5, 7]), st.lists(st.integers(0, 5), min_size=40, max_size=40))
def test_coverage_agrees_with_the_oracle(data, rows, sizes, camera, actions):
    world = scenario(rows, {**COVERAGE, "camera_size": camera}, observation={"local_size": sizes[0], "global_scale": sizes[1]})
    env = UAVEnv(world)
    cell, budget, targets = draw_start(data, rows), data.draw(st.integers(1, 40)), draw_targets(data, rows)
    observation, _ = env.reset(seed=0, options={"start": cell, "budget": budget, "targets": targets})
    oracle = Oracle(world, cell, budget, targets)
    check_observation(env, oracle, observation, exact=True)
    for action in actions:
        check_step(env, oracle, action, exact=True)
        if oracle.done:
            break


@settings(max_examples=150)
@given(
    st.data(),
    maps(),
    SIZES,
    st.booleans(),
    st.integers(0, 2**62 - 1),
    st.lists(st.integers(0, 5), min_size=40, max_size=40),
)
def test_harvesting_agrees_with_the_oracle(data, rows, sizes, noisy, number, actions):
    world = scenario(rows, HARVESTING, observation={"local_size": sizes[0], "global_scale": sizes[1]})
    env = UAVEnv(world)
    cell, budget, devices = draw_start(data, rows), data.draw(st.integers(1, 40)), draw_devices(data, rows)
    options = {"start": cell, "budget": budget, "devices": devices, "noise": noisy, "episode": number}
    observation, _ = env.reset(options=options)
    oracle = Oracle(world, cell, budget, devices, env.simulator.state.key[0], noisy)
    check_observation(env, oracle, observation, exact=False)
    for action in actions:
        check_step(env, oracle, action, exact=False)
        if oracle.done:
            break


@pytest.mark.parametrize(
    "name",
    [
        "Manhattan32-CPP-v0",
        "Manhattan32-DH-v0",
        pytest.param("Urban50-CPP-v0", marks=pytest.mark.slow),
        pytest.param("Urban50-DH-v0", marks=pytest.mark.slow),
    ],
)
def test_shipped_scenarios_agree_with_the_oracle(name):
    env = UAVEnv(name)
    generator = np.random.default_rng(3)
    for number in range(3):
        observation, _ = env.reset(options={"split": "test", "episode": number})
        state, coverage = env.simulator.state, env.scenario.mission.kind == "coverage"
        view = env.simulator.mission.view(0)
        targets = (
            state.target[0].copy()
            if coverage
            else [[*c, d] for c, d in zip(view["device_cell"].tolist(), view["device_data"].tolist(), strict=True)]
        )
        oracle = Oracle(env.scenario, state.position[0, 0].tolist(), state.budget[0, 0], targets, state.key[0])
        check_observation(env, oracle, observation, coverage)
        while not oracle.done:
            check_step(env, oracle, int(generator.integers(0, 5)), coverage)


def test_a_move_into_the_edge_a_no_fly_zone_or_a_building_is_blocked():
    env = start(start=[1, 2])
    for action in (EAST, SOUTH):  # to (1, 3), above the no-fly zone at (2, 3)
        env.step(action)
    assert env.simulator.state.position[0, 0].tolist() == [1, 3]
    assert env.simulator.state.blocked[0] == 1
    env.step(EAST)
    assert env.simulator.state.blocked[0] == 2


def test_a_failed_land_pays_the_safety_penalty_and_is_not_counted_as_blocked():
    env = start()
    env.step(NORTH)
    assert env.step(LAND)[1] == -1.2
    assert env.simulator.state.blocked[0] == 0


def test_landing_pays_nothing_and_covers_nothing():
    env = start(targets=np.ones((5, 4), bool) & ~np.array([[c == "#" for c in row] for row in OPEN]))
    _, reward, terminated, _, info = env.step(LAND)
    assert (reward, terminated, info["landed"], info["cr"]) == (0.0, True, True, 0.0)


def test_nothing_is_covered_at_reset_and_the_first_step_covers_first():
    targets = np.zeros((5, 4), bool)
    targets[1, 1] = True
    env = start(targets=targets)
    assert env.simulator.state.target[0, 1, 1] == 1
    assert env.step(HOVER)[1] == pytest.approx(-0.2 + 0.4)


def test_the_last_action_may_land():
    env = start(budget=1)
    _, reward, terminated, _, info = env.step(LAND)
    assert (reward, terminated, info["landed"]) == (0.0, True, True)


def test_an_empty_budget_is_a_crash_that_terminates_and_covers_nothing():
    targets = np.ones((5, 4), bool) & ~np.array([[c == "#" for c in row] for row in OPEN])
    env = start(budget=1, targets=targets)
    _, reward, terminated, truncated, info = env.step(HOVER)
    assert reward == -0.2 - 150.0
    assert (terminated, truncated, info["landed"], info["cr"]) == (True, False, False, 0.0)


def test_a_finished_episode_stays_as_it_is():
    simulator = Simulator(scenario(OPEN), 2)
    simulator.reset([0, 1], "train", [5, 6])
    simulator.step([LAND, NORTH])
    before = simulator.state.position[0].copy(), simulator.state.budget[0]
    simulator.step([NORTH, NORTH])
    assert (simulator.state.position[0] == before[0]).all()
    assert simulator.state.budget[0] == before[1]
    assert simulator.state.reward[0] == 0.0


@pytest.mark.parametrize(
    ("actions", "message"),
    [([0], "expected integers"), ([0.0, 1.0], "expected integers"), ([0, 6], "6 is not"), ([-1, 0], "-1 is not")],
)
def test_refuses_what_is_not_an_action_and_changes_nothing(actions, message):
    simulator = Simulator(scenario(OPEN), 2)
    simulator.reset([0, 1], "train", [5, 6])
    budget = simulator.state.budget.copy()
    with pytest.raises(ValueError, match=message):
        simulator.step(actions)
    assert (simulator.state.budget == budget).all()


@pytest.mark.parametrize("name", ["Manhattan32-CPP-v0", "Urban50-DH-v0"])
def test_a_batch_equals_its_episodes_flown_alone(name):
    from uavbench import load_scenario

    world, numbers = load_scenario(name), np.arange(40) * 1001
    actions = np.random.default_rng(0).integers(0, 6, (120, 40))
    batch = Simulator(world, 40)
    batch.reset(np.arange(40), "train", numbers)
    rewards = []
    for row in actions:
        batch.step(row)
        rewards.append(batch.state.reward.copy())
    for i in range(0, 40, 7):
        alone = Simulator(world, 1)
        alone.reset([0], "train", [numbers[i]])
        for t, row in enumerate(actions):
            alone.step(row[i : i + 1])
            assert alone.state.reward[0] == rewards[t][i]
        for field in alone.state.arrays():
            assert np.array_equal(getattr(alone.state, field)[0], getattr(batch.state, field)[i]), field


@pytest.mark.parametrize("name", ["Manhattan32-CPP-v0", "Block8-DH-v0", "Manhattan32-CPP-Team-v0"])
def test_scatter_puts_uavs_anywhere_with_budgets_that_suffice(name):
    simulator = Simulator(load_scenario(name), 400)
    slots, state, home = np.arange(400), simulator.state, simulator.city.distance_to_landing
    simulator.reset(slots, "train", slots)
    before, targets = state.position.copy(), state.target.copy()
    simulator.scatter(slots[100:])
    assert np.array_equal(state.position[:100], before[:100])
    assert np.array_equal(state.target, targets)
    assert simulator.episode(0) == ("train", 0)
    assert simulator.episode(100) == ("custom", -1)
    largest = simulator.scenario.budget[1]
    for i in range(100, 400):
        cells = [tuple(cell) for cell in state.position[i, : state.uavs[i]].tolist()]
        assert len(set(cells)) == len(cells)
        for cell, budget, first in zip(cells, state.budget[i], state.initial_budget[i], strict=False):
            assert 0 <= home[cell] < budget <= largest
            assert budget == first
    where = state.position[100:, 0]
    assert len({tuple(cell) for cell in where.tolist()}) > min(150, (home >= 0).sum() // 2)
    assert state.budget[100:, 0].min() < 0.1 * largest + home.max()
    assert state.budget[100:, 0].max() > 0.9 * largest
    again = Simulator(simulator.scenario, 1)
    again.reset([0], "train", [250])
    again.scatter(np.array([0]))
    assert np.array_equal(again.state.position[0], state.position[250])
    assert np.array_equal(again.state.budget[0], state.budget[250])


@pytest.mark.parametrize("name", ["Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-DH-Team-v0"])
def test_a_snapshot_is_gone_on_from_as_if_nothing_had_been(name):
    scenario, slots, random = load_scenario(name), np.arange(30), np.random.default_rng(0)
    simulator, other = Simulator(scenario, 30), Simulator(scenario, 30)
    simulator.reset(slots, "train", slots)
    other.reset(slots, "train", slots + 99)
    actions = random.integers(0, 5, (40, 30, 3) if scenario.team else (40, 30))
    for each in actions[:15]:
        simulator.step(each)
    taken = simulator.snapshot()
    kept = {key: array.copy() for key, array in taken.items()}
    simulator.step(actions[15])
    assert all(np.array_equal(array, kept[key]) for key, array in taken.items())
    other.resume(taken)
    other.step(actions[15])
    for each in actions[16:]:
        simulator.step(each)
        other.step(each)
        for key, array in simulator.state.arrays().items():
            assert np.array_equal(array, getattr(other.state, key)), key
    assert [simulator.episode(i) for i in slots] == [other.episode(i) for i in slots]
