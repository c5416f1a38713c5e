"""Many teams in one simulator are what as many single environments of teams are, bit for bit."""

import numpy as np
import pytest

import uavbench

NAMES = ("Manhattan32-CPP-Team-v0", "Manhattan32-DH-Team-v0", "Block8-CPP-v0")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("more", [{}, {"start": "anywhere", "budget": (10, 60)}])
def test_it_is_the_single_environments_to_the_last_bit(name, more):
    many = uavbench.parallel_vec(name, 3, **more)
    single = [uavbench.parallel_env(name, keep_finished=True, **more) for _ in range(3)]
    observations, infos = many.reset(seed=11)
    told = [env.reset(seed=11 + i) for i, env in enumerate(single)]
    random, ended = np.random.default_rng(0), 0

    def check(observations, infos, i, expected, info):
        for u, agent in enumerate(single[i].possible_agents):
            assert all(np.array_equal(observations[part][i, u], values) for part, values in expected[agent].items())
            assert np.array_equal(infos["action_mask"][i, u], info[agent]["action_mask"])
            assert infos["active"][i, u] == info[agent]["active"]
            for key in ("split", "episode_number", "landed", "cr", "cral", "blocked", "is_success"):
                assert infos[key][i] == info[agent][key]

    for i, (expected, info) in enumerate(told):
        check(observations, infos, i, expected, info)
    for _ in range(300):
        actions = random.integers(0, 6, (3, many.max_uavs))
        observations, rewards, terminated, truncated, infos = many.step(actions)
        assert not truncated.any()
        for i, env in enumerate(single):
            chosen = dict(zip(env.possible_agents, actions[i].tolist(), strict=True))
            expected, earned, done, _, info = env.step(chosen)
            assert rewards[i].tolist() == [earned[agent] for agent in env.possible_agents]
            assert terminated[i] == all(done.values())
            if terminated[i]:
                ended += 1
                check(infos["final_obs"], infos["final_info"], i, expected, info)
                expected, info = env.reset()
            check(observations, infos, i, expected, info)
    assert ended > 5


def test_episodes_are_chosen_as_everywhere():
    envs = uavbench.parallel_vec(NAMES[0], 2, split="validation", order="cycle", num_uavs=3)
    _, infos = envs.reset(seed=0)
    assert envs.episode == (("validation", 0), ("validation", 1))
    assert infos["active"].all()
    _, infos = envs.reset(options={"split": "test", "episode": 5, "num_uavs": 3})
    assert infos["episode_number"].tolist() == [-1, -1]  # the number of UAVs was set by hand


@pytest.mark.parametrize(
    ("call", "error", "reason"),
    [
        (lambda envs: envs.step(np.zeros((2, 3), int)), RuntimeError, "call reset"),
        (lambda envs: (envs.reset(), envs.step(np.zeros((2, 2), int))), ValueError, r"shape \(2, 2\), expected \(2, 3\)"),
        (lambda envs: (envs.reset(), envs.step(np.full((2, 3), 6))), ValueError, "6 is not an action"),
        (lambda envs: (envs.reset(), envs.step(np.zeros((2, 3)))), ValueError, "expected integers"),
        (lambda envs: envs.reset(seed=[1]), ValueError, "1 seeds for 2"),
        (lambda envs: envs.reset(options={"wind": 1}), ValueError, "unknown option 'wind'"),
        (lambda envs: uavbench.parallel_vec(NAMES[0], 0), ValueError, "num_envs: 0"),
        (lambda envs: uavbench.parallel_vec(NAMES[0], 2, threads=0), ValueError, "threads: 0 is not an integer from 1 on"),
    ],
)
def test_what_does_not_fit_says_so(call, error, reason):
    with pytest.raises(error, match=reason):
        call(uavbench.parallel_vec(NAMES[0], 2, num_uavs=3))
