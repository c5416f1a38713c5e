"""Teams keep the rules of the world: the simulator agrees with the oracle, UAV by UAV."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import team
from worlds import COVERAGE, HARVESTING, SIZES, draw_devices, draw_starts, draw_targets, in_city, maps, scenario

import uavbench
from uavbench.envs.env import UAVEnv
from uavbench.envs.parallel_env import UAVParallelEnv
from uavbench.simulation.simulator import Simulator
from uavbench.world.episode import frozen_columns

NORTH, EAST, SOUTH, WEST, HOVER, LAND = range(6)
ROWS = (".........", ".LLLL....", ".........", "....N....")


def start(starts, budgets=20, mission=COVERAGE, rows=ROWS, **options):
    """A team that starts in ``starts``."""
    env = UAVParallelEnv(scenario(rows, mission, uavs=(1, 3)))
    if mission is COVERAGE and "targets" not in options:
        options["targets"] = np.zeros((len(rows), len(rows[0])), bool)
        options["targets"][3, 8] = True  # out of sight
    env.reset(seed=0, options={"num_uavs": len(starts), "start": starts, "budget": budgets, **options})
    return env


def step(env, *actions):
    """Fly actions of the UAVs that fly, in order."""
    return env.step(dict(zip(env.agents, actions, strict=True)))


def cells(env):
    return env.simulator.state.position[0, : env.simulator.state.uavs[0]].tolist()


def check_observation(found, uav, sizes, exact):
    for name, expected in uav.observation(*sizes).items():
        if name == "budget":
            assert np.array_equal(found[name], expected)
            continue
        assert found[name].shape == expected.shape == (6, *expected.shape[1:])
        same = expected.astype(np.float32)
        if exact:
            assert np.array_equal(found[name], same)
        else:
            assert np.array_equal(found[name][[0, 1, 2, 4, 5]], same[[0, 1, 2, 4, 5]])
            np.testing.assert_allclose(found[name][3], expected[3], rtol=3e-7, atol=1e-9)


def check_flight(env, uavs, observations, infos, joint_actions, exact):
    """Fly ``joint_actions`` and compare everything with the oracles ``uavs``."""
    sizes = (env.scenario.observation.local_size, env.scenario.observation.global_scale)
    tolerance = {"abs": 0.0} if exact else {"abs": 1e-9}
    names = {f"uav_{k}": uav for k, uav in enumerate(uavs)}
    for joint in joint_actions:
        for name in env.agents:
            check_observation(observations[name], names[name], sizes, exact)
            assert infos[name]["action_mask"].tolist() == names[name].mask()
        acting = list(env.agents)
        assert acting == [name for name, uav in names.items() if not uav.done]
        if not acting:
            break
        expected = {name: names[name].step(joint[uavs.index(names[name])]) for name in acting}  # one after the other
        observations, rewards, terminated, truncated, infos = env.step({name: joint[int(name[-1])] for name in acting})
        assert terminated == {name: names[name].done for name in acting}
        assert not any(truncated.values())
        assert rewards == pytest.approx(expected, rel=0, **tolerance)
        assert [tuple(cell) for cell in cells(env)] == [uav.p for uav in uavs]
        for name in acting:
            check_observation(observations[name], names[name], sizes, exact)
            assert infos[name]["cr"] == pytest.approx(uavs[0].cr(), abs=1e-12 if exact else 1e-9)
            assert infos[name]["landed"] == all(uav.landed for uav in uavs)
    if all(uav.done for uav in uavs):
        assert env.agents == []
        for name in acting:
            assert infos[name]["landed"] == all(uav.landed for uav in uavs)
            assert infos[name]["blocked"] == sum(uav.blocked for uav in uavs)
            assert infos[name]["cr"] == pytest.approx(uavs[0].cr(), abs=1e-12 if exact else 1e-9)
            assert infos[name]["cral"] == infos[name]["cr"] * infos[name]["landed"]


ACTIONS = st.lists(st.tuples(*[st.sampled_from([0, 1, 2, 3, 0, 1, 2, 3, 4, 5])] * 3), min_size=30, max_size=30)


@settings(max_examples=150)
@given(st.data(), maps(landing=(3, 4)), SIZES, st.integers(1, 3), ACTIONS)
def test_coverage_agrees_with_the_oracle(data, rows, sizes, number, actions):
    world = scenario(rows, uavs=(1, 3), observation={"local_size": sizes[0], "global_scale": sizes[1]})
    starts, targets = draw_starts(data, rows, number), draw_targets(data, rows)
    budgets = data.draw(st.lists(st.integers(1, 40), min_size=number, max_size=number))
    env = UAVParallelEnv(world)
    options = {"num_uavs": number, "start": starts, "budget": budgets, "targets": targets}
    check_flight(env, team(world, starts, budgets, targets), *env.reset(seed=0, options=options), actions, exact=True)


@settings(max_examples=150)
@given(st.data(), maps(landing=(3, 4)), SIZES, st.integers(1, 3), st.booleans(), st.integers(0, 2**62 - 1), ACTIONS)
def test_harvesting_agrees_with_the_oracle(data, rows, sizes, number, noisy, episode, actions):
    world = scenario(rows, HARVESTING, uavs=(1, 3), observation={"local_size": sizes[0], "global_scale": sizes[1]})
    starts, devices = draw_starts(data, rows, number), draw_devices(data, rows)
    budgets = data.draw(st.lists(st.integers(1, 40), min_size=number, max_size=number))
    env = UAVParallelEnv(world)
    options = {"episode": episode, "num_uavs": number, "start": starts, "budget": budgets, "devices": devices, "noise": noisy}
    first = env.reset(options=options)
    uavs = team(world, starts, budgets, devices, env.simulator.state.key[0], noisy)
    check_flight(env, uavs, *first, actions, exact=False)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name.startswith("Urban50") else name
        for name in uavbench.list_scenarios()
        if "Team" in name
    ],
)
def test_shipped_scenarios_agree_with_the_oracle(name):
    env = uavbench.parallel_env(name)
    coverage = env.scenario.mission.kind == "coverage"
    generator = np.random.default_rng(5)
    for number in range(2):
        first = env.reset(options={"split": "test", "episode": number})
        state, view = env.simulator.state, env.simulator.mission.view(0)
        uavs = len(env.agents)
        targets = state.target[0].copy()
        if not coverage:
            targets = [[*c, d] for c, d in zip(view["device_cell"].tolist(), view["device_data"].tolist(), strict=True)]
        there = in_city(env.scenario, env.simulator.city_at(0))
        oracles = team(there, state.position[0, :uavs].tolist(), state.budget[0, :uavs], targets, state.key[0])
        check_flight(env, oracles, *first, generator.integers(0, 5, (30, 3)).tolist(), coverage)


def test_uavs_move_in_their_order():
    env = start([[1, 2], [1, 3]])
    step(env, WEST, WEST)  # the second moves into the cell that the first has just left
    assert cells(env) == [[1, 1], [1, 2]]
    _, rewards, *_ = step(env, EAST, EAST)  # the first moves against the second, which is still there
    assert cells(env) == [[1, 1], [1, 3]]
    assert rewards == {"uav_0": -1.2, "uav_1": -0.2}
    assert env.simulator.state.blocked[0].tolist() == [1, 0, 0]


def test_uavs_cannot_change_places():
    env = start([[1, 2], [1, 3]])
    step(env, EAST, WEST)
    assert cells(env) == [[1, 2], [1, 3]]
    assert env.simulator.state.blocked[0].tolist() == [1, 1, 0]


def test_a_uav_that_has_landed_or_crashed_frees_its_cell():
    env = start([[1, 2], [1, 3]])
    step(env, LAND, WEST)  # landed before the second moves
    assert cells(env) == [[1, 2], [1, 2]]
    assert env.agents == ["uav_1"]
    env = start([[1, 2], [1, 3]], budgets=[1, 20])
    step(env, HOVER, WEST)
    assert cells(env) == [[1, 2], [1, 2]]
    env = start([[1, 2], [1, 3]])
    step(env, EAST, LAND)  # too early: the second is still there
    assert cells(env) == [[1, 2], [1, 3]]


def test_what_one_covers_is_covered_for_the_others():
    targets = np.zeros((4, 9), bool)
    targets[1, 2] = targets[1, 3] = True
    env = start([[1, 2], [1, 3]], targets=targets)
    assert step(env, HOVER, HOVER)[1] == {"uav_0": pytest.approx(-0.2 + 0.8), "uav_1": -0.2}


def test_the_first_may_empty_a_device_within_the_step():
    env = start([[1, 2], [1, 3]], mission=HARVESTING, devices=[[0, 2, 0.5]], noise=False)
    first, second = step(env, HOVER, HOVER)[1].values()
    assert first == pytest.approx(-0.2 + 0.4 * 0.5)
    assert second == -0.2


def test_uavs_have_fading_of_their_own():
    gains = []
    for cell in ([1, 2], [1, 3]):  # who is alone with a device, at the same distance
        env = start([cell, [1, 1]], mission=HARVESTING, devices=[[0, 2 if cell == [1, 2] else 3, 20.0]])
        gains.append(step(env, HOVER, LAND)[1]["uav_0"])
    env = start([[1, 1], [1, 3]], mission=HARVESTING, devices=[[0, 3, 20.0]])
    gains.append(step(env, LAND, HOVER)[1]["uav_1"])
    assert gains[0] == pytest.approx(gains[1])
    assert gains[0] != pytest.approx(gains[2])


def test_the_team_has_landed_when_all_have():
    env = start([[1, 1], [1, 2], [1, 3]])
    step(env, LAND, HOVER, HOVER)
    *_, infos = step(env, HOVER, LAND)
    assert not infos["uav_2"]["landed"]
    *_, infos = step(env, LAND)
    told = {name: infos["uav_1"][name].item() for name in ("landed", "cr", "cral", "blocked", "is_success")}
    assert told == {"landed": True, "cr": 0.0, "cral": 0.0, "blocked": 0, "is_success": False}
    env = start([[1, 1], [1, 2]], budgets=[2, 9], targets=np.array([["LLL" in r] * 9 for r in ROWS]))
    step(env, HOVER, HOVER)
    step(env, HOVER, HOVER)  # the first crashes
    *_, infos = step(env, LAND)
    assert (infos["uav_1"]["landed"], infos["uav_1"]["cral"]) == (False, 0.0)
    assert infos["uav_1"]["cr"] > 0


@pytest.mark.parametrize("name", ["Manhattan32-CPP-Team-v0", "Urban50-DH-Team-v0"])
def test_a_batch_equals_its_episodes_flown_alone(name):
    world, numbers = uavbench.load_scenario(name), np.arange(40) * 1001
    actions = np.random.default_rng(0).choice([0, 1, 2, 3, 4, 4, 4, 5], (120, 40, 3))
    batch = Simulator(world, 40)
    batch.reset(np.arange(40), "train", numbers)
    rewards = []
    for row in actions:
        batch.step(row)
        rewards.append(batch.state.reward.copy())
    assert set(batch.state.uavs.tolist()) == {1, 2, 3}
    for i in range(0, 40, 7):
        alone = Simulator(world, 1)
        alone.reset([0], "train", [numbers[i]])
        for t, row in enumerate(actions):
            alone.step(row[i : i + 1])
            assert np.array_equal(alone.state.reward[0], rewards[t][i])
        for field in alone.state.arrays():
            assert np.array_equal(getattr(alone.state, field)[0], getattr(batch.state, field)[i]), field
        assert alone.outcomes([0]) == {field: values[i] for field, values in batch.outcomes(np.arange(40)).items()}
        assert np.array_equal(alone.action_mask()[0], batch.action_mask()[i])


@pytest.mark.parametrize("mission", ["CPP", "DH"])
@pytest.mark.parametrize("split", ["train", "test"])
def test_the_first_uav_starts_as_the_one_that_flies_alone(mission, split):
    """Same episode, same targets: a team's scores can be set beside those of one UAV."""
    alone = Simulator(uavbench.load_scenario(f"Urban50-{mission}-v0"), 50)
    together = Simulator(uavbench.load_scenario(f"Urban50-{mission}-Team-v0"), 50)
    for simulator in (alone, together):
        simulator.reset(np.arange(50), split, np.arange(50))
    for field in ("position", "budget"):
        assert np.array_equal(getattr(alone.state, field)[:, 0], getattr(together.state, field)[:, 0])
    assert np.array_equal(alone.state.target, together.state.target)


def test_as_many_uavs_fly_as_are_asked_for_and_those_drawn_first():
    name = "Manhattan32-DH-Team-v0"
    drawn = uavbench.parallel_env(name)
    for number in (1, 2, 3):
        env = uavbench.parallel_env(name, num_uavs=number)
        for episode in range(10):
            for options in ({"split": "test", "episode": episode}, {"episode": episode}):
                env.reset(options=options)
                assert len(env.agents) == number
                drawn.reset(options={**options, "num_uavs": 3})
                assert cells(env) == cells(drawn)[:number]
    assert env.possible_agents == ["uav_0", "uav_1", "uav_2"]


@pytest.mark.parametrize("split", ["train", "validation", "test"])
def test_one_to_three_fly_each_as_often(split):
    simulator = Simulator(uavbench.load_scenario("Manhattan32-CPP-Team-v0"), 200)
    simulator.reset(np.arange(200), split, np.arange(200))
    counts = np.bincount(simulator.state.uavs, minlength=4)
    assert counts[0] == 0
    assert counts[1:].min() > 45
    for cell, uavs in zip(simulator.state.position.tolist(), simulator.state.uavs, strict=True):
        assert len({tuple(c) for c in cell[:uavs]}) == uavs


def test_a_team_of_one_flies_as_one_alone():
    """The same transitions to the last bit; its observation has two empty layers more."""
    name, generator = "Manhattan32-DH", np.random.default_rng(2)
    env, alone = uavbench.parallel_env(f"{name}-Team-v0", num_uavs=1), UAVEnv(f"{name}-v0")
    same = uavbench.parallel_env(f"{name}-v0")
    for episode in range(5):
        for each in (env, alone, same):
            each.reset(seed=episode)
        while env.agents:
            action = int(generator.integers(0, 6))
            observation, reward, terminated, _, info = alone.step(action)
            for other in (env, same):
                theirs, rewards, ends, _, infos = other.step({"uav_0": action})
                assert (rewards["uav_0"], ends["uav_0"]) == (reward, terminated)
                assert {key: infos["uav_0"][key] for key in info if key != "action_mask"} == {
                    key: value for key, value in info.items() if key != "action_mask"
                }
                assert np.array_equal(infos["uav_0"]["action_mask"], info["action_mask"])
                for key, values in observation.items():
                    layers = 4 if key != "budget" else 1
                    assert np.array_equal(theirs["uav_0"][key][:layers], values)
                    assert not theirs["uav_0"][key][layers:].any()


def test_frozen_episodes_hold_all_uavs_that_may_fly():
    columns = frozen_columns(uavbench.load_scenario("Urban50-CPP-Team-v0"), "test")
    assert columns["start"].shape == (1000, 3, 2)
    assert columns["budget"].shape == (1000, 3)
    assert set(columns["uavs"].tolist()) == {1, 2, 3}
