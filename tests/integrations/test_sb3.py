"""The vector environment for Stable-Baselines3 is what DummyVecEnv of single environments is, bit for bit."""

import numpy as np
import pytest

import uavbench

pytestmark = pytest.mark.integrations
NAMES = ("Block8-CPP-v0", "Block8-DH-v0")


@pytest.fixture
def sb3():
    """The adapter and SB3's own vector environments, where Stable-Baselines3 is installed."""
    pytest.importorskip("stable_baselines3", reason="needs the extra: pip install -e '.[integrations]'")
    from stable_baselines3.common import vec_env

    from uavbench.integrations.sb3 import VecEnv

    return VecEnv, vec_env


def same(a, b):
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[name], b[name]) for name in a)
    return np.array_equal(a, b) and np.asarray(a).dtype == np.asarray(b).dtype


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("limit", [None, 9])
def test_it_is_dummy_vec_env_to_the_last_bit(sb3, name, limit):
    import gymnasium as gym

    VecEnv, vec_env = sb3
    more = {} if limit is None else {"max_episode_steps": limit}
    made = (
        vec_env.DummyVecEnv([lambda: gym.make(f"uavbench/{name}", **more) for _ in range(4)]),
        VecEnv(name, 4, every_info=True, **more),
    )
    for envs in made:
        envs.seed(7)
    assert same(*(envs.reset() for envs in made))
    random, ended = np.random.default_rng(0), 0
    for _ in range(200):
        actions = random.integers(0, 6, 4)
        (a, b, c, d), (e, f, g, h) = (envs.step(actions) for envs in made)
        assert same(a, e)
        assert same(b, f)
        assert same(c, g)
        ended += c.sum()
        assert all(same(first, second) for first, second in zip(d, h, strict=True))
        assert all(same(*infos) for infos in zip(*(envs.reset_infos for envs in made), strict=True))
        assert same(*(np.stack(envs.env_method("action_masks")) for envs in made))
    assert ended > 20


def test_infos_of_ended_episodes_alone_are_told_by_default(sb3):
    VecEnv, _ = sb3
    quick, whole = VecEnv(NAMES[0], 3), VecEnv(NAMES[0], 3, every_info=True)
    for envs in (quick, whole):
        envs.seed(1)
        envs.reset()
    random = np.random.default_rng(0)
    for _ in range(100):
        actions = random.integers(0, 6, 3)
        (_, _, dones, few), (*_, many) = quick.step(actions), whole.step(actions)
        assert all(same(few[i], many[i]) if dones[i] else few[i] == {} for i in range(3))


def test_sb3s_wrappers_and_algorithms_work_on_it(sb3):
    VecEnv, vec_env = sb3
    from sb3_contrib import MaskablePPO
    from stable_baselines3 import PPO

    envs = vec_env.VecNormalize(vec_env.VecMonitor(VecEnv(NAMES[0], 8)), norm_obs=False)
    model = PPO("MultiInputPolicy", envs, n_steps=32, batch_size=64, n_epochs=1, seed=0)
    model.learn(2_000)
    assert len(model.ep_info_buffer) > 0
    assert len(model.ep_success_buffer) > 0
    masked = MaskablePPO("MultiInputPolicy", VecEnv(NAMES[0], 8), n_steps=32, batch_size=64, n_epochs=1, seed=0)
    masked.learn(512)


def test_attributes_are_those_of_the_slots(sb3):
    VecEnv, _ = sb3
    envs = VecEnv(NAMES[0], 3, render_mode="rgb_array")
    envs.reset()
    envs.set_attr("success_cr", 0.5, indices=[1])
    assert envs.get_attr("success_cr") == [0.9, 0.5, 0.9]
    assert envs.get_attr("success_cr", indices=1) == [0.5]
    assert envs.get_images()[2].ndim == 3
    assert envs.env_is_wrapped(object) == [False] * 3
    with pytest.raises(ValueError, match="autoreset_mode"):
        VecEnv(NAMES[0], 2, autoreset_mode="NextStep")
    with pytest.raises(ValueError, match="is for a team"):
        VecEnv("Manhattan32-DH-Team-v0", 2)


def test_options_are_for_all_slots(sb3):
    VecEnv, _ = sb3
    envs = VecEnv(NAMES[0], 2, split="test")
    envs.set_options({"episode": 17})
    envs.reset()
    assert envs.get_attr("episode") == [("test", 17)] * 2
    assert uavbench.load_scenario(NAMES[0]).digest == envs.get_attr("scenario")[0].digest
