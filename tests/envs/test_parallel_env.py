"""The PettingZoo environment does what PettingZoo and its users expect."""

import hashlib
import json
import pickle
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pettingzoo
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import data_equivalence
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, render_test, seed_test
from pettingzoo.test.state_test import state_test
from pettingzoo.utils import aec_to_parallel

import uavbench
from uavbench.envs.env import UAVEnv
from uavbench.envs.vector_env import UAVVectorEnv

IDS = [name for name in uavbench.list_scenarios() if "Team" in name]
CPP, DH = "Manhattan32-CPP-Team-v0", "Urban50-DH-Team-v0"
HOVER, LAND = 4, 5


def fly(env, seed, steps=80):
    """Everything that a seeded flight over several episodes returns."""
    generator = np.random.default_rng(7)
    trace = [env.reset(seed=seed)]
    for _ in range(steps):
        actions = {agent: int(generator.choice([0, 1, 2, 3, 4, 4, 5])) for agent in env.agents}
        trace.append(env.step(actions))
        if not env.agents:
            trace.append(env.reset())
    return trace


@pytest.mark.parametrize("arguments", [{}, {"num_uavs": 3}, {"num_uavs": 3, "flat": True}])
@pytest.mark.parametrize("name", IDS)
def test_passes_pettingzoos_tests_without_a_warning(name, arguments):
    def make(**more):
        return uavbench.parallel_env(name, **arguments, **more)

    def convert(**more):
        return uavbench.aec_env(name, **arguments, **more)

    parallel_api_test(make())
    parallel_seed_test(make)
    seed_test(convert)
    render_test(convert)
    state_test(convert(), make())
    with warnings.catch_warnings():
        if "flat" not in arguments:  # api_test warns of every observation that is no plain array
            warnings.filterwarnings("ignore", "Observation is not a NumPy array")
            warnings.filterwarnings("ignore", "Observation space for each agent probably should be gymnasium.spaces.box")
        api_test(convert())


@pytest.mark.skipif(not hasattr(pettingzoo, "make"), reason="PettingZoo has a registry since 1.27")
@pytest.mark.parametrize("name", IDS)
def test_is_in_pettingzoos_registry(name):
    env = pettingzoo.make("parallel", f"uavbench/{name}", num_uavs=2)
    assert data_equivalence(fly(env, 3), fly(uavbench.parallel_env(name, num_uavs=2), 3), exact=True)
    converted = pettingzoo.make("aec", f"uavbench/{name}", num_uavs=2)
    converted.reset(seed=3)
    assert np.array_equal(converted.last()[0]["global"], env.reset(seed=3)[0]["uav_0"]["global"])


@pytest.mark.parametrize("name", [CPP, DH])
def test_the_conversion_flies_the_same_episodes(name):
    there_and_back = aec_to_parallel(uavbench.aec_env(name))
    assert data_equivalence(fly(there_and_back, 5), fly(uavbench.parallel_env(name), 5), exact=True)


@pytest.mark.parametrize("name", [CPP, DH])
def test_the_same_seed_gives_the_same_flight_and_different_seeds_differ(name):
    assert data_equivalence(fly(uavbench.parallel_env(name), 5), fly(uavbench.parallel_env(name), 5), exact=True)
    env = uavbench.parallel_env(name)
    numbers = {env.reset(seed=seed)[1]["uav_0"]["episode_number"] for seed in range(50)}
    assert len(numbers) == 50
    flights = {fly(env, seed)[0][0]["uav_0"]["global"].tobytes() for seed in range(10)}
    assert len(flights) == 10
    unseeded = {uavbench.parallel_env(name).reset()[1]["uav_0"]["episode_number"] for _ in range(3)}
    assert len(unseeded) == 3


def digest(name):
    """A digest of a seeded flight."""
    sha = hashlib.sha256()
    for call in fly(uavbench.parallel_env(name), 5):
        for agent, observation in call[0].items():
            sha.update(agent.encode() + b"".join(values.tobytes() for values in observation.values()))
        if len(call) == 5:
            sha.update(json.dumps(call[1:4]).encode())
    return sha.hexdigest()


def test_the_same_seed_gives_the_same_flight_in_another_process():
    here = str(Path(__file__).parent)
    code = f"import sys; sys.path.insert(0, {here!r}); import test_parallel_env as t; print(t.digest({DH!r}))"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert child.stdout.strip() == digest(DH) != digest(CPP)


def test_goes_on_alike_after_pickling():
    env = uavbench.parallel_env(DH, num_uavs=3)
    env.reset(seed=4)
    env.step(dict.fromkeys(env.agents, 1))
    copy = pickle.loads(pickle.dumps(env))
    for action in (1, 2, 2, 4, 4, 3, 0):
        actions = dict.fromkeys(env.agents, action)
        assert data_equivalence(env.step(actions), copy.step(actions), exact=True)
    assert data_equivalence(env.reset(), copy.reset(), exact=True)


def test_each_agent_has_spaces_of_its_own_the_same_at_every_call():
    env = uavbench.parallel_env(CPP)
    assert env.possible_agents == ["uav_0", "uav_1", "uav_2"]
    for agent in env.possible_agents:
        assert env.observation_space(agent) is env.observation_space(agent)
        assert env.action_space(agent) is env.action_space(agent)
        assert env.observation_space(agent)["local"].shape == (6, 17, 17)
        assert env.observation_space(agent)["global"].shape == (6, 21, 21)
    first, second = (env.observation_space(agent) for agent in env.possible_agents[:2])
    first.seed(1)
    expected = first.sample()["budget"]
    first.seed(1)
    second.seed(2)
    assert first.sample()["budget"] == expected


@pytest.mark.parametrize("name", IDS)
def test_observations_stay_in_their_space_and_are_fresh(name):
    env = uavbench.parallel_env(name)
    seen = []
    for observations, *_ in fly(env, 2):
        for agent, observation in observations.items():
            assert observation in env.observation_space(agent)
            for other in seen[-4:]:
                assert not any(np.shares_memory(a, b) for a, b in zip(observation.values(), other.values(), strict=True))
            seen.append(observation)


def test_flat_observations_hold_the_same_numbers():
    shaped, flat = uavbench.parallel_env(CPP), uavbench.parallel_env(CPP, flat=True)
    for agent, observation in shaped.reset(seed=1)[0].items():
        vector = flat.reset(seed=1)[0][agent]
        assert np.array_equal(vector, spaces.flatten(shaped.observation_space(agent), observation))
        assert vector in flat.observation_space(agent)
        assert (vector.dtype, vector.shape) == (np.float32, flat.observation_space(agent).shape)


def test_those_who_have_finished_leave():
    env = uavbench.parallel_env(CPP, num_uavs=3)
    env.reset(seed=0)
    observations, rewards, terminated, truncated, infos = env.step({"uav_0": HOVER, "uav_1": LAND, "uav_2": HOVER})
    assert terminated == {"uav_0": False, "uav_1": True, "uav_2": False}
    assert truncated == dict.fromkeys(terminated, False)
    assert env.agents == ["uav_0", "uav_2"]
    for part in (observations, rewards, infos):
        assert list(part) == ["uav_0", "uav_1", "uav_2"]
    assert list(env.step({"uav_0": HOVER, "uav_2": HOVER, "uav_1": HOVER})[0]) == env.agents  # the finished one's is ignored
    *_, infos = env.step({"uav_0": LAND, "uav_2": LAND})
    assert env.agents == []
    for info in infos.values():
        assert info["landed"]
        assert info["cral"] == info["cr"]
    with pytest.raises(RuntimeError, match="call reset"):
        env.step({})


def test_any_action_can_be_survived():
    """Blocked moves, moves against each other and failed landings pay, and end nothing."""
    env = uavbench.parallel_env(CPP, num_uavs=3)
    generator = np.random.default_rng(0)
    for seed in range(3):
        env.reset(seed=seed)
        steps = 0
        while env.agents:
            env.step({agent: int(generator.integers(0, 6)) for agent in env.agents})
            steps += 1
        assert env.simulator.state.budget[0].max() >= 0
        assert steps <= env.scenario.budget[1]


def test_the_mask_masks_nothing_that_works_and_all_that_cannot():
    env = uavbench.parallel_env(CPP, num_uavs=3)
    generator, seen = np.random.default_rng(1), set()
    for seed in range(60):
        _, infos = env.reset(seed=seed)
        for _ in range(12):
            state = env.simulator.state
            before, flying = state.position[0].copy(), list(env.agents)
            actions = {agent: int(generator.integers(0, 5)) for agent in flying}
            masked = {agent: not infos[agent]["action_mask"][action] for agent, action in actions.items()}
            *_, infos = env.step(actions)
            for agent in flying:
                u = int(agent[-1])
                moved = bool((state.position[0, u] != before[u]).any())
                seen.add((masked[agent], moved, actions[agent] == HOVER))
            if not env.agents:
                break
    assert (True, True, False) not in seen  # what is masked has no effect
    assert {(True, False, False), (False, True, False), (False, False, True)} <= seen


def test_the_whole_state_is_shown_to_a_centralised_critic():
    env = uavbench.parallel_env(CPP, num_uavs=2)
    env.reset(seed=3)
    env.step({"uav_0": HOVER, "uav_1": LAND})
    whole, state = env.state(), env.simulator.state
    assert whole in env.state_space
    r, c = state.position[0, 0]
    assert np.argwhere(whole[4]).tolist() == np.argwhere(whole[5]).tolist() == [[r, c]]
    assert whole[5, r, c] == state.budget[0, 0]
    assert np.array_equal(whole[3], state.target[0])
    assert np.array_equal(
        whole[:3].astype(bool), [env.simulator.city.landing, env.simulator.city.no_fly, env.simulator.city.building]
    )


def test_options_pick_and_set_an_episode():
    env = uavbench.parallel_env(DH)
    observations, infos = env.reset(options={"split": "test", "episode": 17})
    assert {info["episode_number"] for info in infos.values()} == {17}
    assert env.episode == ("test", 17)
    again, _ = env.reset(options={"split": "test", "episode": 17, "no such option": 1})  # PettingZoo's tests pass one
    assert data_equivalence(observations, again, exact=True)
    starts = [[22, 22], [28, 24]]
    _, infos = env.reset(options={"num_uavs": 2, "start": starts, "budget": [3, 200]})
    assert infos["uav_0"]["episode_number"] == -1
    assert env.episode == ("custom", -1)
    assert env.simulator.state.position[0, :2].tolist() == starts
    assert env.simulator.state.budget[0, :2].tolist() == [3, 200]
    env.reset(options={"num_uavs": 3, "budget": 9})
    assert env.simulator.state.budget[0].tolist() == [9, 9, 9]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_uavs": 4}, "num_uavs: 4 is not an integer from 1 to 3"),
        ({"num_uavs": True}, "num_uavs: True"),
        ({"num_uavs": 2.0}, "num_uavs: 2.0"),
        ({"num_uavs": 2, "start": [22, 22]}, "a list of 2 cells"),
        ({"num_uavs": 2, "start": [[22, 22], [22]]}, "a list of 2 cells"),
        ({"num_uavs": 2, "start": [[22, 22], [22, 22]]}, "two UAVs are on one cell"),
        ({"num_uavs": 2, "start": [[22, 22], [0, 0]]}, "outside the landing zones"),
        ({"num_uavs": 2, "budget": [5]}, "1 given for 2|budget"),
        ({"num_uavs": 2, "budget": [5, 6, 7]}, "3 given for 2 UAVs"),
        ({"num_uavs": 2, "budget": [5, 0]}, "budget: 0"),
        ({"num_uavs": 2, "budget": [5, 201]}, "budget: 201"),
        ({"split": "tset"}, "split"),
        ({"noise": 3}, "noise"),
    ],
)
def test_refuses_an_episode_that_does_not_fit(options, message):
    env = uavbench.parallel_env(DH)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)
    assert env.agents == []  # nothing flies until a reset succeeds


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ({"uav_0": 4}, "none for uav_1"),
        ({"uav_0": 4, "uav_1": 6}, "6 of uav_1 is not"),
        ({"uav_0": 4, "uav_1": 1.0}, "1.0 of uav_1 is not one integer"),
        ({"uav_0": 4, "uav_1": [1]}, "of uav_1 is not one integer"),
        ({"uav_0": 4, "uav_1": None}, "of uav_1 is not one integer"),
        ({"uav_0": 4, "uav_1": 4, "uav_9": 4}, "'uav_9' is not an agent"),
    ],
)
def test_refuses_what_is_not_an_action_and_changes_nothing(actions, message):
    env = uavbench.parallel_env(CPP, num_uavs=2)
    env.reset(seed=0)
    budget = env.simulator.state.budget.copy()
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert np.array_equal(env.simulator.state.budget, budget)
    assert env.agents == ["uav_0", "uav_1"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: uavbench.parallel_env(CPP, num_uavs=4), "num_uavs: 4 is not an integer from 1 to 3"),
        (lambda: uavbench.parallel_env(CPP, num_uavs=0), "num_uavs: 0"),
        (lambda: uavbench.parallel_env(CPP, num_uavs=1.5), "num_uavs: 1.5"),
        (lambda: uavbench.parallel_env("Urban50-DH-v0", num_uavs=2), "is for one UAV"),
        (lambda: uavbench.parallel_env(CPP, render_mode="film"), "render_mode: 'film'"),
        (lambda: UAVEnv(CPP), "is for a team: use uavbench.parallel_env"),
        (lambda: UAVVectorEnv(CPP, 2), "is for a team"),
    ],
)
def test_refuses_what_does_not_fit(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_draws_every_uav():
    env = uavbench.parallel_env(CPP, num_uavs=3, render_mode="ansi")
    with pytest.raises(RuntimeError, match="call reset"):
        env.render()
    env.reset(seed=0)
    env.step(dict.fromkeys(env.agents, 1))
    head, *rows = env.render().splitlines()
    assert [sum(row.count(digit) for row in rows) for digit in "0123"] == [1, 1, 1, 0]
    assert head.count("/") == 3
    pictured = uavbench.parallel_env(CPP, num_uavs=3, render_mode="rgb_array")
    pictured.reset(seed=0)
    before = pictured.render()
    assert before.dtype == np.uint8
    pictured.step(dict.fromkeys(pictured.agents, 2))
    assert not np.array_equal(before, pictured.render())
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 6  # three UAVs of three colours
    assert uavbench.parallel_env(CPP).render() is None


def test_team_ids_are_those_of_teams():
    assert [name for name in uavbench.list_scenarios() if uavbench.load_scenario(name).team] == IDS


@pytest.mark.parametrize("name", ["Manhattan32-CPP-Team-v0", "Manhattan32-DH-Team-v0"])
def test_finished_uavs_may_stay_and_nothing_else_changes(name):
    plain, kept = uavbench.parallel_env(name), uavbench.parallel_env(name, keep_finished=True)
    random = np.random.default_rng(0)
    for seed in range(6):
        (few, _), (many, infos) = plain.reset(seed=seed), kept.reset(seed=seed)
        assert list(many) == kept.possible_agents == kept.agents
        while plain.agents:
            flying = list(plain.agents)
            assert [agent for agent, info in infos.items() if info["active"]] == flying
            actions = {agent: int(random.integers(6)) for agent in kept.possible_agents}
            few, rewards, _, _, told = plain.step({agent: actions[agent] for agent in flying})
            many, all_rewards, all_done, _, infos = kept.step(actions)
            for agent in kept.possible_agents:
                if agent in flying:
                    assert all_rewards[agent] == rewards[agent]
                    assert infos[agent]["cr"] == told[agent]["cr"]
                if agent in plain.agents:
                    assert all(np.array_equal(few[agent][part], many[agent][part]) for part in few[agent])
                    assert np.array_equal(infos[agent]["action_mask"], told[agent]["action_mask"])
                else:
                    assert not any(values.any() for values in many[agent].values())
                    assert infos[agent]["action_mask"].tolist() == [0, 0, 0, 0, 1, 0]
            assert set(all_done.values()) == {not plain.agents}
        assert kept.agents == []


def test_pettingzoos_own_test_passes_with_finished_uavs_kept():
    parallel_api_test(uavbench.parallel_env("Manhattan32-CPP-Team-v0", keep_finished=True), num_cycles=300)
