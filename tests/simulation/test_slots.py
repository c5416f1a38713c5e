"""States taken and set: what follows is the same to the last bit, in the simulator and in every environment."""

import pickle
import re
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from worlds import SURVEILLANCE, scenario

from uavbench import load_scenario, parallel_env
from uavbench.envs.env import UAVEnv
from uavbench.envs.vector_env import UAVVectorEnv
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator

ROWS = ("LL......", "........", "..##....", "..##....", "......N.", "........")
WORLDS = {
    "CPP": load_scenario("Block8-CPP-v0"),
    "DH": load_scenario("Block8-DH-v0"),
    "CPP team": load_scenario("Manhattan32-CPP-Team-v0"),
    "DH team": load_scenario("Manhattan32-DH-Team-v0"),
    "surveillance": scenario(ROWS, SURVEILLANCE),
    "surveillance team": scenario(ROWS, SURVEILLANCE, uavs=(1, 2)),
}
SLOTS = 8


@pytest.fixture(params=WORLDS)
def world(request):
    return WORLDS[request.param]


def flown(simulator, actions):
    """Fly; return all that there is to see after each step, for each slot."""
    count, observer = simulator.scenario.max_uavs, Observer(simulator.scenario)
    seen = []
    for each in actions:
        simulator.step(each)
        batch = observer.empty(simulator.num_envs * count)
        observer.write(simulator.state, np.arange(simulator.num_envs * count), batch)
        parts = [
            *simulator.state.arrays().values(),
            *simulator.outcomes(range(simulator.num_envs)).values(),
            simulator.action_mask(),
        ]
        parts += [part.reshape(simulator.num_envs, -1) for part in batch.values()]
        parts += [*simulator.mission.arrays().values()]
        seen.append([b"".join(part[i].tobytes() for part in parts) for i in range(simulator.num_envs)])
    return seen


def actions(world, steps, seed=0):
    shape = (steps, SLOTS, world.max_uavs) if world.team else (steps, SLOTS)
    return np.random.default_rng(seed).integers(0, 5, shape)


def begun(world, first=0):
    simulator = Simulator(world, SLOTS)
    simulator.reset(range(SLOTS), "train", range(first, first + SLOTS))
    return simulator


def test_what_follows_a_state_is_the_same(world):
    """To the end of the longest episode, in the same simulator and in another one."""
    simulator, other = begun(world), begun(world, 50)
    flown(simulator, actions(world, 7))
    state = pickle.loads(pickle.dumps(simulator.get_state()))
    rest = actions(world, world.budget[1], seed=1)
    expected = flown(simulator, rest)
    assert simulator.state.done.all()
    for each in (simulator, other):
        each.set_state(state)
        assert flown(each, rest) == expected
        assert [each.episode(i) for i in range(SLOTS)] == [("train", i) for i in range(SLOTS)]


def test_slots_are_taken_and_set_by_index(world):
    simulator, other = begun(world), begun(world, 50)
    flown(simulator, actions(world, 5))
    flown(other, actions(world, 9))
    kept = other.get_state()
    other.set_state(simulator.get_state([6, 1]), [0, 3])
    assert [other.episode(i)[1] for i in (0, 3, 1)] == [6, 1, 51]
    taken = other.get_state()
    for name, array in taken.arrays.items():
        source = simulator.get_state().arrays[name]
        assert np.array_equal(array[[0, 3]], source[[6, 1]]), name
        assert np.array_equal(array[[1, 2, 4, 5, 6, 7]], kept.arrays[name][[1, 2, 4, 5, 6, 7]]), name


def test_one_state_goes_into_many_slots(world):
    """A search tries every action in a slot of its own: all begin alike, and alike actions lead to the same."""
    simulator = begun(world)
    flown(simulator, actions(world, 5))
    simulator.set_state(simulator.get_state([2]), np.arange(1, SLOTS))
    same = np.repeat(actions(world, 6)[:, :1], SLOTS, axis=1)
    for row in flown(simulator, same):
        assert len(set(row[1:])) == 1


def test_a_state_is_a_copy(world):
    simulator = begun(world)
    state = simulator.get_state()
    before = pickle.dumps(state)
    flown(simulator, actions(world, 5))
    simulator.set_state(state)
    flown(simulator, actions(world, 5))
    assert pickle.dumps(state) == before


def test_what_does_not_fit_is_refused_and_changes_nothing():
    simulator = begun(WORLDS["DH"])
    state, before = simulator.get_state([0, 1, 2]), pickle.dumps(simulator.get_state())
    other = begun(WORLDS["CPP"]).get_state([0])
    damaged = state._replace(arrays={name: array[..., :1] for name, array in state.arrays.items()})
    old = state._replace(arrays={name: array for name, array in state.arrays.items() if "sight" not in name})
    for error, reason, given, index in (
        (ValueError, "it belongs to the scenario with the digest", other, [0]),
        (ValueError, "it holds 3 slots, but is to be set in 2", state, [0, 1]),
        (ValueError, "it holds 3 slots, but is to be set in 8", state, None),
        (ValueError, "does not fit: another version", damaged, [0, 1, 2]),
        (ValueError, "its mission.sight does not fit: another version", old, [0, 1, 2]),
        (ValueError, r"index: bool of shape \(8,\)", state, np.arange(8) < 3),
        (ValueError, r"index: float64 of shape", state, [0.5, 1.0, 2.0]),
        (ValueError, r"index: int64 of shape \(\)", state, 3),
        (IndexError, "out of bounds", state, [0, 1, 8]),
    ):
        with pytest.raises(error, match=reason):
            simulator.set_state(given, index)
    assert pickle.dumps(simulator.get_state()) == before


@pytest.mark.parametrize("name", ["CPP", "DH", "surveillance"])
def test_an_environment_goes_back(name):
    env, other = UAVEnv(WORLDS[name]), UAVEnv(WORLDS[name])
    env.reset(seed=0, options={"budget": 30})
    for action in (1, 1, 2, 4):
        env.step(action)
    state = pickle.loads(pickle.dumps(env.get_state()))

    def rest(each):
        return [
            [
                *(values.tobytes() for values in observation.values()),
                *step,
                info["action_mask"].tobytes(),
                each.action_masks().tolist(),
            ]
            for observation, *step, info in (each.step(action) for action in [2, 2, 1, 4, 0, 3] + 20 * [4])
        ]

    first = rest(env)
    assert first[-1][4]  # terminated
    env.set_state(state)
    assert rest(env) == first
    other.set_state(state)  # without a reset
    assert rest(other) == first
    following = [env.reset()[1]["episode_number"] for _ in range(2)]
    env.reset(seed=0)
    assert following[0] == env.reset()[1]["episode_number"]  # the generator of episodes is not part of the state


def test_a_state_is_taken_and_set_in_the_time_of_three_steps():
    env, times = UAVEnv("Manhattan32-DH-v0"), {}
    env.reset(seed=0, options={"budget": 150})
    state = env.get_state()
    calls = {"take": env.get_state, "set": lambda: env.set_state(state), "step": lambda: env.step(4)}
    for name in 300 * list(calls):  # the best of single calls: other processes disturb only some
        started = time.perf_counter_ns()
        calls[name]()
        times[name] = min(times.get(name, np.inf), time.perf_counter_ns() - started)
    assert times["take"] + times["set"] <= 3 * times["step"]


@pytest.mark.parametrize("name", ["CPP team", "DH team", "surveillance team"])
def test_a_teams_environment_goes_back(name):
    env, other = parallel_env(WORLDS[name]), parallel_env(WORLDS[name])
    env.reset(seed=0, options={"num_uavs": 2, "budget": [12, 20]})
    random = np.random.default_rng(0)
    chosen = [dict(zip(env.possible_agents, row, strict=False)) for row in random.integers(0, 5, (20, 3)).tolist()]

    def fly(each, steps):
        seen = []
        for row in steps:
            if each.agents:
                observations, *parts = each.step({agent: row[agent] for agent in each.agents})
                flat = {agent: b"".join(map(np.ndarray.tobytes, maps.values())) for agent, maps in observations.items()}
                seen.append((flat, str(parts), list(each.agents), each.state().tobytes(), each.episode))
        return seen

    for at in (5, 14):  # with both UAVs, and with one that flies no more
        env.reset(seed=0, options={"num_uavs": 2, "budget": [12, 20]})
        fly(env, chosen[:at])
        state = env.get_state()
        first = fly(env, chosen[at:])
        assert not env.agents
        for each in (env, other):
            each.set_state(state)
            assert fly(each, chosen[at:]) == first


def test_a_vector_environment_tries_all_actions_from_one_state():
    env, envs = UAVEnv("Block8-DH-v0"), UAVVectorEnv("Block8-DH-v0", 6)
    env.reset(seed=3, options={"budget": 20})
    env.step(1)
    state = env.get_state()
    envs.set_state(state)  # without a reset
    observations, rewards, ended, _, _ = envs.step(np.arange(6))
    for action in range(6):
        env.set_state(state)
        observation, reward, over, _, _ = env.step(action)
        assert (reward, over) == (rewards[action], ended[action])
        assert all(np.array_equal(values, observations[name][action]) for name, values in observation.items())
    envs.set_state(envs.get_state([1, 2]), [4, 5])
    again = envs.get_state().simulator.arrays["position"]
    assert np.array_equal(again[[1, 2]], again[[4, 5]])


def test_the_documentations_search_runs():
    text = (Path(__file__).parents[2] / "docs" / "environments.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n([^`]*set_state[^`]*)```", text)[1].replace("Manhattan32", "Block8")
    found = {}
    exec(code, found)
    assert found["terminated"]


def test_a_wrapped_environment_is_searched():
    env = gym.make("uavbench/Block8-CPP-v0")
    env.reset(seed=0)
    state = env.unwrapped.get_state()
    first = env.step(1)[1]
    env.unwrapped.set_state(state)
    assert env.step(1)[1] == first


def test_pictures_go_back_too():
    """Whatever a search flew in between is not drawn, and the way before it is."""
    env, twin = (UAVEnv("Block8-DH-v0", render_mode="rgb_array") for _ in range(2))
    for each in (env, twin):
        each.reset(seed=0, options={"budget": 20})
        for action in (1, 2, 2):
            each.step(action)
    state = env.get_state()
    env.step(3)
    env.set_state(state)
    env.step(1)
    twin.step(1)
    assert np.array_equal(env.render(), twin.render())
    env.set_state(state)
    assert not np.array_equal(env.render(), twin.render())


def test_a_state_without_pictures_begins_a_new_way():
    env, plain = UAVEnv("Block8-CPP-v0", render_mode="rgb_array"), UAVEnv("Block8-CPP-v0")
    plain.reset(seed=0, options={"budget": 20})
    for action in (1, 2, 2):
        plain.step(action)
    env.set_state(plain.get_state())
    assert env.render().shape[2] == 3
    (way,) = env._pictures._trails[0].cells
    assert way == [tuple(env.simulator.state.position[0, 0])]
    env.step(1)
    env.step(5)
    assert len(way) == 3
    envs = UAVVectorEnv("Block8-CPP-v0", 3, render_mode="ansi")
    envs.set_state(plain.get_state())
    assert len(set(envs.render())) == 1


def test_the_steps_that_a_limit_counts_go_back_too():
    envs = UAVVectorEnv("Block8-CPP-v0", 2, max_episode_steps=3)
    envs.reset(seed=0)
    envs.step([4, 4])
    state = envs.get_state()
    assert [envs.step([4, 4])[3].tolist() for _ in range(2)] == [[False, False], [True, True]]
    envs.set_state(state)
    assert [envs.step([4, 4])[3].tolist() for _ in range(2)] == [[False, False], [True, True]]
