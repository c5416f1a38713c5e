"""Every info of every environment has the same keys, all of them numbers or arrays, so that libraries can stack them."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import uavbench
from uavbench.envs.core import SPLIT_CODES
from uavbench.envs.env import UAVEnv
from uavbench.envs.parallel_env import UAVParallelEnv
from uavbench.envs.vector_env import UAVVectorEnv

CPP, DH, TEAM = "Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-CPP-Team-v0"
HOVER, LAND = 4, 5
KINDS = {
    "action_mask": np.int8,
    "split": np.int64,
    "episode_number": np.int64,
    "landed": np.bool_,
    "cr": np.float64,
    "cral": np.float64,
    "blocked": np.int64,
    "is_success": np.bool_,
}


def check(info):
    """One environment's info has all keys, with numbers that know their dtype, and an array for the mask."""
    assert {name: value.dtype for name, value in info.items()} == KINDS
    assert {name: value.shape for name, value in info.items()} == {**dict.fromkeys(KINDS, ()), "action_mask": (6,)}


@pytest.mark.parametrize("name", [CPP, DH])
def test_an_environments_infos_have_the_same_keys(name):
    env = UAVEnv(name, split="validation")
    generator = np.random.default_rng(0)
    for seed in range(3):
        check(env.reset(seed=seed)[1])
        terminated = False
        while not terminated:
            _, _, terminated, _, info = env.step(generator.integers(0, 6))
            check(info)
            assert env.episode == ("validation", info["episode_number"])
            assert info["split"] == SPLIT_CODES["validation"] == 1
    assert SPLIT_CODES == {"train": 0, "validation": 1, "test": 2, "custom": 3}


@pytest.mark.parametrize("flat", [False, True])
def test_a_teams_infos_have_the_same_keys(flat):
    env = uavbench.parallel_env(TEAM, flat=flat, split="test")
    _, infos = env.reset(seed=0)
    while env.agents:
        *_, more = env.step(dict.fromkeys(env.agents, HOVER))
        for info in (*infos.values(), *more.values()):
            check(info)
            assert (info["split"], info["episode_number"]) == (SPLIT_CODES["test"], env.episode[1])
        infos = more


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_vector_environments_infos_have_the_same_keys(mode):
    envs = UAVVectorEnv(CPP, 4, autoreset_mode=mode)

    def look(infos, number=4):
        plain = {name: values for name, values in infos.items() if not name.startswith(("_", "final"))}
        assert {name: values.dtype for name, values in plain.items()} == KINDS
        for name, values in plain.items():
            assert values.shape == ((4, 6) if name == "action_mask" else (4,))
            assert infos[f"_{name}"].sum() == number
        if "final_info" in infos:
            look(infos["final_info"], number=infos["_final_info"].sum())

    look(envs.reset(seed=0)[1])
    generator, final = np.random.default_rng(0), 0
    for _ in range(60):
        _, _, terminated, _, infos = envs.step(generator.choice([0, 1, 2, 3, 4, 5], 4))
        look(infos)
        final += "final_info" in infos
        if mode is AutoresetMode.DISABLED and terminated.any():
            look(envs.reset(options={"reset_mask": terminated})[1], number=terminated.sum())
    assert bool(final) == (mode is AutoresetMode.SAME_STEP)


def test_metrics_so_far_are_those_of_the_state():
    env = UAVEnv(CPP)
    env.reset(seed=0)
    state, last = env.simulator.state, 0.0
    for action in (2, 2, 1, 1, 1, 0, 0, 0):
        info = env.step(action)[-1]
        assert info["cr"] == (state.total[0] - state.remaining[0]) / state.total[0] >= last
        assert (info["landed"], info["cral"], info["is_success"]) == (False, 0.0, False)
        assert info["blocked"] == state.blocked[0, 0]
        last = info["cr"]
    assert last > 0


@pytest.mark.parametrize(("least", "success"), [(0.0, True), (0.5, True), (0.6, False), (None, False)])
def test_success_is_landing_with_a_cr_of_at_least_the_threshold(least, success):
    targets = np.zeros((8, 8), bool)
    targets[7, 6] = targets[0, 7] = True  # one under the UAV's start, and one out of its camera's reach
    chosen = {} if least is None else {"success_cr": least}
    for env in (UAVEnv(CPP, **chosen), UAVParallelEnv(CPP, **chosen)):
        env.reset(options={"start": [7, 6], "budget": 30, "targets": targets})
        for action, landed in ((HOVER, False), (LAND, True)):
            step = env.step(action if isinstance(env, UAVEnv) else {"uav_0": action})
            info = step[-1] if isinstance(env, UAVEnv) else step[-1]["uav_0"]
            assert (info["cr"], info["landed"], info["is_success"]) == (0.5, landed, landed and success)


@pytest.mark.parametrize("least", [-0.1, 1.1, float("nan"), "much", None, True, [0.5]])
def test_refuses_a_threshold_that_is_none(least):
    for make in (UAVEnv, UAVParallelEnv, lambda name, **more: UAVVectorEnv(name, 2, **more)):
        with pytest.raises(ValueError, match=r"success_cr: .* is not a number from 0 to 1"):
            make(CPP, success_cr=least)


def test_episode_is_told_by_attribute_through_all_wrappers():
    env = gym.make(f"uavbench/{CPP}", split="test")
    env.reset(seed=3)
    assert env.unwrapped.episode == env.get_wrapper_attr("episode")
    assert env.unwrapped.episode[0] == "test"
    for mode in ("sync", "vector_entry_point"):
        envs = gym.make_vec(f"uavbench/{CPP}", 2, vectorization_mode=mode)
        envs.reset(options={"split": "validation", "episode": 17})
        assert envs.call("episode") == (("validation", 17),) * 2


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_an_environment_with_a_window_can_be_copied(duplicate):
    pygame = pytest.importorskip("pygame", reason="a window needs pygame-ce: pip install 'uavbench[human]'")
    for env in (UAVEnv(CPP, render_mode="human"), uavbench.parallel_env(CPP, render_mode="human")):
        env.metadata["render_fps"] = 1000
        env.reset(seed=0)
        again = duplicate(env)
        for action in (HOVER, 0, 1):
            chosen = action if isinstance(env, UAVEnv) else {"uav_0": action}
            first, second = env.step(chosen), again.step(chosen)
            assert first[1] == second[1]
        again.close()
        env.step(chosen)  # its window opens again, if the copy has closed the display that both drew on
        assert pygame.display.get_surface() is not None
        env.close()


@pytest.mark.parametrize("name", [name for name in uavbench.list_scenarios() if "Team" in name])
def test_gymnasium_is_told_how_a_teams_environment_is_made(name):
    for make, more in ((gym.make, {}), (gym.make, {"num_uavs": 2}), (gym.make_vec, {"num_envs": 2}), (gym.make_vec, {})):
        with pytest.raises(ValueError, match=rf'^{name} is for a team: use uavbench.parallel_env\("{name}"\)$'):
            make(f"uavbench/{name}", **more)
