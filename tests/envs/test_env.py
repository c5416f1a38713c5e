"""The Gymnasium environment does what Gymnasium and its users expect."""

import hashlib
import json
import pickle
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence

import uavbench
from uavbench.envs.core import SPLIT_CODES
from uavbench.envs.env import UAVEnv

IDS = [name for name in uavbench.list_scenarios() if "Team" not in name]
CPP, DH = "Block8-CPP-v0", "Block8-DH-v0"
HOVER, LAND = 4, 5


def fly(env, seed, steps=60):
    """Rewards, observations and infos of a seeded flight over several episodes."""
    generator = np.random.default_rng(7)
    observation, info = env.reset(seed=seed)
    trace = [(observation, 0.0, False, info)]
    for _ in range(steps):
        observation, reward, terminated, _, info = env.step(int(generator.integers(0, 6)))
        trace.append((observation, reward, terminated, info))
        if terminated:
            observation, info = env.reset()
            trace.append((observation, 0.0, False, info))
    return trace


@pytest.mark.parametrize("name", IDS)
def test_passes_gymnasiums_checker_without_a_warning(name):
    check_env(gym.make(f"uavbench:uavbench/{name}").unwrapped)


@pytest.mark.parametrize("name", IDS)
def test_its_spec_is_json_and_makes_it_again(name):
    env = gym.make(f"uavbench/{name}", local_size=5, global_scale=2)
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert json.loads(env.spec.to_json())["kwargs"]["local_size"] == 5
    assert data_equivalence(fly(env, 3), fly(again, 3), exact=True)


@pytest.mark.parametrize("name", [CPP, "Urban50-DH-v0"])
def test_the_same_seed_gives_the_same_flight(name):
    assert data_equivalence(fly(UAVEnv(name), 5), fly(UAVEnv(name), 5), exact=True)


@pytest.mark.parametrize("name", [CPP, "Urban50-DH-v0"])
def test_different_seeds_give_different_episodes(name):
    env = UAVEnv(name)
    numbers = {env.reset(seed=seed)[1]["episode_number"] for seed in range(50)}
    flights = {fly(env, seed)[0][0]["global"].tobytes() for seed in range(10)}
    assert len(numbers) == 50
    assert len(flights) > 5


def test_later_resets_draw_other_episodes():
    env = UAVEnv(CPP)
    numbers = [env.reset(seed=1)[1]["episode_number"], *(env.reset()[1]["episode_number"] for _ in range(20))]
    assert len(set(numbers)) == 21


def digest(name):
    """A digest of a seeded flight."""
    flight = [(r, t, {k: v.tolist() for k, v in o.items()}) for o, r, t, _ in fly(UAVEnv(name), 5)]
    return hashlib.sha256(json.dumps(flight).encode()).hexdigest()


def test_the_same_seed_gives_the_same_flight_in_another_process():
    code = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import test_env; print(test_env.digest({DH!r}))"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert child.stdout.strip() == digest(DH) != digest(CPP)


def test_goes_on_alike_after_pickling():
    env = UAVEnv(DH)
    env.reset(seed=4)
    env.step(1)
    copy = pickle.loads(pickle.dumps(env))
    for action in (1, 2, 2, 4, 4, 3, 0):
        assert data_equivalence(env.step(action), copy.step(action), exact=True)
    assert data_equivalence(env.reset(), copy.reset(), exact=True)


def test_observations_and_masks_are_fresh_at_every_call():
    env = UAVEnv(CPP)
    observation, info = env.reset(seed=0)
    kept = {name: values.copy() for name, values in observation.items()}, info["action_mask"].copy()
    _, later = env.reset()[0], env.step(HOVER)
    assert data_equivalence((observation, info["action_mask"]), kept, exact=True)
    info["action_mask"][:] = 0
    assert env.action_masks().any()
    assert not np.shares_memory(later[0]["local"], observation["local"])


@pytest.mark.parametrize("name", [CPP, DH])
def test_picks_an_episode_of_a_split(name):
    env = UAVEnv(name)
    first, info = env.reset(seed=1, options={"split": "test", "episode": 17})
    assert env.episode == ("test", 17)
    assert (info["split"], info["episode_number"]) == (SPLIT_CODES["test"], 17)
    assert data_equivalence(first, env.reset(seed=2, options={"split": "test", "episode": 17})[0], exact=True)
    others = [env.reset(options={"split": "test", "episode": k})[0]["global"].tobytes() for k in range(20)]
    assert len(set(others)) > 15
    assert env.reset(options={"split": "validation"})[1]["split"] == SPLIT_CODES["validation"]
    assert UAVEnv(name, split="validation").reset(seed=0)[1]["split"] == SPLIT_CODES["validation"]
    train = env.reset(options={"episode": 17})[0]
    assert not data_equivalence(train, first, exact=True)


def test_a_cycle_gives_each_episode_once_in_order():
    env = UAVEnv(CPP, split="validation", order="cycle")
    assert [env.reset()[1]["episode_number"] for _ in range(203)] == [*range(200), 0, 1, 2]
    env.reset(options={"episode": 7})  # takes nothing from the cycle
    assert env.reset()[1]["episode_number"] == 3
    env.reset(options={"split": "test"})
    assert env.episode == ("test", 0)
    assert env.reset()[1]["episode_number"] == 4
    assert [env.reset(seed=1)[1]["episode_number"], env.reset()[1]["episode_number"]] == [0, 1]
    team = uavbench.parallel_env("Manhattan32-CPP-Team-v0", split="validation", order="cycle")
    assert [team.reset()[1]["uav_0"]["episode_number"] for _ in range(3)] == [0, 1, 2]
    assert [team.reset(seed=k)[1]["uav_0"]["episode_number"] for k in range(2)] == [0, 0]
    train = gym.make(f"uavbench/{CPP}", order="cycle")
    assert [train.reset()[1]["episode_number"] for _ in range(2)] == [0, 1]
    with pytest.raises(ValueError, match="order: 'ordered' is not one of random, cycle"):
        UAVEnv(CPP, order="ordered")


def test_sets_an_episode_by_hand():
    env = UAVEnv(CPP)
    mask = np.zeros((8, 8), bool)
    mask[5, 2] = True
    _, info = env.reset(seed=0, options={"start": [7, 6], "budget": 11, "targets": mask.tolist()})
    state = env.simulator.state
    assert state.position[0, 0].tolist() == [7, 6]
    assert state.budget[0] == 11
    assert np.argwhere(state.target[0]).tolist() == [[5, 2]]
    assert env.episode == ("custom", -1)
    assert (info["split"], info["episode_number"]) == (SPLIT_CODES["custom"], -1)
    dh = UAVEnv(DH)
    dh.reset(seed=0, options={"devices": [[0, 7, 5.5], [3, 2, 9]]})
    assert np.argwhere(dh.simulator.state.target[0]).tolist() == [[0, 7], [3, 2]]
    assert dh.simulator.state.remaining[0] == 14.5


def test_the_rest_of_a_custom_episode_stays_as_drawn():
    env = UAVEnv(CPP)
    env.reset(options={"split": "test", "episode": 3})
    drawn = env.simulator.state.target[0].copy()
    env.reset(options={"split": "test", "episode": 3, "budget": 13})
    assert np.array_equal(env.simulator.state.target[0], drawn)
    assert env.simulator.state.budget[0] == 13


BAD_COVERAGE = [
    ({"start": [4, 4]}, "start: .* outside the landing zones"),
    ({"start": [-1, 0]}, "start: .* off the 8×8 map"),
    ({"start": [0.5, 0]}, "start: .* two integers"),
    ({"start": 3}, "start: 3 is not a cell"),
    ({"budget": 0}, "budget: 0"),
    ({"budget": 31}, "budget: 31 .* 1 to 30"),
    ({"budget": 9.5}, "budget: 9.5"),
    ({"targets": np.ones((8, 8))}, "is a building"),
    ({"targets": np.ones((8, 7))}, r"shape \(8, 7\), the map \(8, 8\)"),
    ({"targets": np.zeros((8, 8))}, "the mask is empty"),
    ({"targets": np.full((8, 8), 0.5)}, "other than 0 and 1"),
    ({"targets": [[1], [0, 1]]}, "all of one length"),
    ({"noise": 1}, "noise: 1 is not"),
    ({"split": "tset"}, "split: 'tset' is not one of"),
    ({"split": "test", "episode": 1000}, "0 to 999"),
    ({"split": "test", "episode": -1}, "out of range"),
    ({"split": "test", "episode": 1.0}, "not an integer"),
    ({"epsiode": 3}, "unknown option 'epsiode'"),
    ({"devices": [[0, 7, 5]]}, "unknown option 'devices'"),
]
BAD_HARVESTING = [
    ([[0, 0, 5.0]], "in a landing cell"),
    ([[1, 4, 5.0]], "in a building cell"),
    ([[8, 4, 5.0]], "not on a cell"),
    ([[0.5, 4, 5.0]], "not on a cell"),
    ([[0, 7, 0.0]], "0 data units"),
    ([[0, 7, float("nan")]], "nan data units"),
    ([[0, 7, 21.0]], "21 data units"),
    ([[float("nan"), 7, 5.0]], "not on a cell"),
    ([[0, 7], [1]], "not a table of numbers"),
    ([["a", 7, 5.0]], "not a table of numbers"),
    ([[0, 7]], "shape"),
    ([], "shape"),
    ([[0, 7, 5.0], [0, 7, 6.0]], "on one cell"),
    ([[0, 7, 5.0], [0, 6, 5.0], [0, 5, 6.0], [0, 4, 6.0]], "4 devices"),
]


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [(CPP, *case) for case in BAD_COVERAGE] + [(DH, {"devices": d}, m) for d, m in BAD_HARVESTING],
)
def test_refuses_an_episode_that_does_not_fit(name, options, message):
    env = UAVEnv(name)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)


def test_noise_can_be_switched_off_for_an_episode():
    env = UAVEnv("Manhattan32-DH-v0")

    def rewards(**options):
        env.reset(seed=0, options={"split": "test", "episode": 2, **options})
        return [env.step(HOVER)[1] for _ in range(10)]

    assert rewards() == rewards() != rewards(noise=False)
    assert len(set(rewards(noise=False))) < len(set(rewards()))


def test_an_episode_without_its_noise_is_not_that_episode():
    env = UAVEnv("Block8-DH-v0")
    for noise, named in ((True, ("test", 2)), (False, ("custom", -1))):
        env.reset(options={"split": "test", "episode": 2, "noise": noise})
        assert env.episode == named


def test_the_same_episode_has_the_same_noise_whatever_was_flown_before():
    env = UAVEnv("Manhattan32-DH-v0")
    options = {"split": "test", "episode": 2}
    env.reset(options=options)
    first = [env.step(a)[1] for a in (HOVER, HOVER, HOVER)]
    fly(env, 1)
    env.reset(options=options)
    assert [env.step(a)[1] for a in (HOVER, HOVER, HOVER)] == first


def test_step_needs_a_running_episode():
    env = UAVEnv(CPP)
    with pytest.raises(RuntimeError, match="call reset"):
        env.step(0)
    env.reset(seed=0)
    env.step(LAND)
    with pytest.raises(RuntimeError, match="call reset"):
        env.step(0)


@pytest.mark.parametrize("action", [6, -1, 1.0, "north", [1, 2], np.array([[3]]), None])
def test_refuses_what_is_not_an_action(action):
    env = UAVEnv(CPP)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="actions"):
        env.step(action)


def test_nothing_can_be_asked_before_a_reset():
    for ask in (UAVEnv.action_masks, lambda _: UAVEnv(CPP, render_mode="ansi").render()):
        with pytest.raises(RuntimeError, match="call reset"):
            ask(UAVEnv(CPP))


def test_info_tells_the_metrics_at_the_end():
    env = UAVEnv(CPP)
    env.reset(seed=0)
    _, _, terminated, _, info = env.step(LAND)
    assert terminated
    assert {name: info[name] for name in ("landed", "cr", "cral", "blocked")} == {
        "landed": True,
        "cr": 0.0,
        "cral": 0.0,
        "blocked": 0,
    }


def test_the_mask_says_which_actions_have_their_effect():
    env = UAVEnv(CPP)
    generator = np.random.default_rng(0)
    for episode in range(20):
        _, info = env.reset(seed=episode)
        terminated = False
        while not terminated:
            assert np.array_equal(info["action_mask"].astype(bool), env.action_masks())
            action, before = int(generator.integers(0, 6)), env.simulator.state.position[0, 0].copy()
            _, _, terminated, _, after = env.step(action)
            moved = (env.simulator.state.position[0, 0] != before).any()
            effective = bool(info["action_mask"][action])
            assert effective == (moved or action == HOVER or bool(env.simulator.state.landed[0]))
            info = after


def test_sizes_can_be_chosen_and_are_checked():
    env = UAVEnv(CPP, local_size=3, global_scale=5)
    assert env.reset(seed=0)[0]["local"].shape == (4, 3, 3)
    assert env.observation_space["global"].shape == (4, 3, 3)
    whole = UAVEnv(CPP, local_size=0, global_scale=1)  # the paper's ablation: the whole centred map
    assert whole.reset(seed=0)[0].keys() == {"global", "budget"}
    assert whole.observation_space["global"].shape == (4, 15, 15)
    for sizes, message in (
        ({"local_size": 4}, "even"),
        ({"local_size": 17}, "exceeds 15"),
        ({"global_scale": 0}, "scale"),
    ):
        with pytest.raises(ValueError, match=message):
            UAVEnv(CPP, **sizes)


@pytest.mark.parametrize("name", IDS)
def test_observations_stay_in_their_space(name):
    env = UAVEnv(name)
    assert all(observation in env.observation_space for observation, *_ in fly(env, 2, 200))


@pytest.mark.parametrize("name", [CPP, "Manhattan32-DH-v0"])
def test_renders_headless(name):
    env = gym.make(f"uavbench/{name}", render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    env.step(4)
    for action in (1, 1, 2, 2, 3):
        env.step(action)
    after = env.render()
    assert before.dtype == np.uint8
    assert before.shape == after.shape
    assert before.ndim == 3
    assert not np.array_equal(before, after)
    text = gym.make(f"uavbench/{name}", render_mode="ansi")
    text.reset(seed=0)
    rows = text.render().splitlines()
    assert len(rows) == 1 + env.unwrapped.scenario.shape[0]
    assert sum(row.count("@") for row in rows[1:]) == 1
    with pytest.raises(ValueError, match="render_mode"):
        UAVEnv(name, render_mode="human3d")
