"""The vector environment is bit for bit what Gymnasium makes of single environments."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from uavbench import list_scenarios
from uavbench.envs.env import UAVEnv
from uavbench.envs.vector_env import UAVVectorEnv

N = 5
CPP, DH = "Block8-CPP-v0", "Block8-DH-v0"
MODES = list(AutoresetMode)


def pair(name, mode, **kwargs):
    ours = UAVVectorEnv(name, N, autoreset_mode=mode, **kwargs)
    return ours, SyncVectorEnv([lambda: UAVEnv(name, **kwargs)] * N, autoreset_mode=mode)


def same(ours, theirs):
    """Equal to the last bit, types, keys and masks of infos included."""
    assert sorted(ours[-1]) == sorted(theirs[-1])
    for a, b in zip(ours[:-1], theirs[:-1], strict=True):
        assert data_equivalence(a, b, exact=True)
    infos(ours[-1], theirs[-1])


def infos(ours, theirs):
    for key, value in theirs.items():
        if isinstance(value, dict):
            infos(ours[key], value)
        elif key == "final_obs":
            for a, b in zip(ours[key], value, strict=True):
                assert data_equivalence(a, b, exact=True)
        else:
            assert ours[key].dtype == value.dtype, key
            assert np.array_equal(ours[key], value), key


def actions(steps):
    generator = np.random.default_rng(1)
    some = generator.integers(0, 6, (steps, N))
    return np.where(some == 5, np.where(generator.random((steps, N)) < 0.2, 5, 4), some)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("name", [CPP, DH, "Manhattan32-DH-v0"])
def test_equals_single_environments_over_many_episodes(name, mode):
    ours, theirs = pair(name, mode)
    same(ours.reset(seed=3), theirs.reset(seed=3))
    ended = 0
    for row in actions(200):
        found = ours.step(row)
        same(found, theirs.step(row))
        ended += found[2].sum()
    assert ended > N


@pytest.mark.parametrize("name", [CPP, DH])
def test_equals_single_environments_reset_by_mask(name):
    ours, theirs = pair(name, "Disabled")
    same(ours.reset(seed=3), theirs.reset(seed=3))
    for row in actions(120):
        found = ours.step(row)
        same(found, theirs.step(row))
        if found[2].any():
            mask = found[2].copy()
            same(ours.reset(options={"reset_mask": mask.copy()}), theirs.reset(options={"reset_mask": mask.copy()}))


@pytest.mark.parametrize("name", [CPP, DH])
def test_options_reach_every_environment(name):
    ours, theirs = pair(name, "NextStep")
    options = {"split": "test", "episode": 5, "budget": 12}
    same(ours.reset(seed=1, options=dict(options)), theirs.reset(seed=1, options=dict(options)))
    same(ours.reset(seed=[4, 5, 6, 7, 8]), theirs.reset(seed=[4, 5, 6, 7, 8]))


def test_each_environment_can_have_its_own_episode():
    envs = UAVVectorEnv(CPP, 3)
    observations, info = envs.reset(options={"split": "test", "episode": [7, 0, 999]})
    assert info["episode_number"].tolist() == [7, 0, 999]
    for i, number in enumerate([7, 0, 999]):
        single, _ = UAVEnv(CPP).reset(options={"split": "test", "episode": number})
        assert np.array_equal(observations["global"][i], single["global"])


@pytest.mark.parametrize("name", [name for name in list_scenarios() if "Team" not in name])
def test_is_made_for_every_id_in_every_mode(name):
    for mode in MODES:
        envs = gym.make_vec(f"uavbench:uavbench/{name}", 3, vectorization_mode="vector_entry_point", autoreset_mode=mode.value)
        observations, _ = envs.reset(seed=0)
        assert envs.metadata["autoreset_mode"] is mode
        assert observations in envs.observation_space
        assert envs.step(envs.action_space.sample())[0] in envs.observation_space
        assert gym.envs.registration.EnvSpec.from_json(envs.unwrapped.spec.to_json()).kwargs["autoreset_mode"] == mode.value


@pytest.mark.parametrize("mode", MODES)
def test_no_array_of_one_call_is_reused_by_another(mode):
    envs = UAVVectorEnv(CPP, N, autoreset_mode=mode)
    calls = [envs.reset(seed=0)]
    calls += [envs.step(np.full(N, 4)) for _ in range(3)]
    kept = [{name: values.copy() for name, values in call[0].items()} for call in calls]
    for k, call in enumerate(calls):
        assert data_equivalence(call[0], kept[k], exact=True)
        for later in calls[k + 1 :]:
            for name in call[0]:
                assert not np.shares_memory(call[0][name], later[0][name])
            assert not np.shares_memory(call[-1]["action_mask"], later[-1]["action_mask"])


def test_environments_differ_from_each_other_and_between_seeds():
    envs = UAVVectorEnv("Manhattan32-CPP-v0", 20)
    first = envs.reset(seed=0)[1]["episode_number"].tolist()
    second = envs.reset(seed=100)[1]["episode_number"].tolist()
    unseeded = [UAVVectorEnv(CPP, 1).reset()[1]["episode_number"][0] for _ in range(3)]
    assert len({*first, *second}) == 40
    assert len(set(unseeded)) == 3


def test_stepping_past_the_end_is_an_error_without_autoreset():
    envs = UAVVectorEnv(CPP, 2, autoreset_mode="Disabled")
    envs.reset(seed=0)
    envs.step(np.array([5, 4]))
    with pytest.raises(RuntimeError, match=r"slots \[0\]"):
        envs.step(np.array([4, 4]))


def test_goes_on_alike_after_pickling():
    envs = UAVVectorEnv(DH, 3)
    envs.reset(seed=0)
    envs.step(np.array([4, 5, 4]))
    again = pickle.loads(pickle.dumps(envs))
    for row in actions(40)[:, :3]:
        same(envs.step(row), again.step(row))


def test_stepping_before_a_successful_reset_is_an_error():
    envs = UAVVectorEnv(CPP, 2)
    with pytest.raises(RuntimeError, match="call reset"):
        envs.step(np.array([4, 4]))
    envs.reset(seed=0)
    with pytest.raises(ValueError, match="budget"):
        envs.reset(options={"budget": 0})
    with pytest.raises(RuntimeError, match="call reset"):
        envs.step(np.array([4, 4]))
    envs.reset()
    envs.step(np.array([4, 4]))


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: UAVVectorEnv(CPP, 0), ValueError, "num_envs"),
        (lambda: UAVVectorEnv(CPP, 2, autoreset_mode="never"), ValueError, "never"),
        (lambda: UAVVectorEnv(CPP, 2).reset(seed=[1]), ValueError, "1 seeds for 2"),
        (lambda: UAVVectorEnv(CPP, 2).reset(options={"reset_mask": [True, False]}), TypeError, "reset_mask"),
        (lambda: UAVVectorEnv(CPP, 2).reset(options={"reset_mask": np.zeros(2, bool)}), ValueError, "reset_mask"),
        (lambda: UAVVectorEnv(CPP, 2).reset(options={"episode": [1, 2, 3]}), ValueError, "3 numbers for 2"),
        (lambda: UAVVectorEnv(CPP, 2).reset(options={"episode": None}), ValueError, "None is not an integer"),
        (lambda: UAVVectorEnv(CPP, 2, max_episode_steps=0), ValueError, "max_episode_steps: 0 is not"),
        (lambda: UAVVectorEnv(CPP, 2, max_episode_steps=2.5), ValueError, "max_episode_steps: 2.5 is not"),
        (lambda: UAVVectorEnv(CPP, 2).call("step", 4), AttributeError, "call: 'step' is not one of action_masks, "),
        (lambda: UAVVectorEnv(CPP, 2).set_attr("scenario", 4), AttributeError, "'scenario' cannot be set"),
        (lambda: UAVVectorEnv(CPP, 2).set_attr("success_cr", [1.0]), ValueError, "1 values for 2"),
        (lambda: UAVVectorEnv(CPP, 2).set_attr("success_cr", 2), ValueError, "success_cr: 2 is not a number from 0 to 1"),
        (lambda: UAVVectorEnv(CPP, 2).reset(options={"start": [4, 4]}), ValueError, "landing"),
    ],
)
def test_refuses_what_does_not_fit(call, error, message):
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize("limit", [1, 7])
@pytest.mark.parametrize("mode", MODES)
def test_truncates_as_single_environments_under_a_time_limit(mode, limit):
    ours = UAVVectorEnv(CPP, N, max_episode_steps=limit, autoreset_mode=mode)
    theirs = SyncVectorEnv([lambda: gym.make(f"uavbench/{CPP}", max_episode_steps=limit)] * N, autoreset_mode=mode)
    options = {"budget": 7}  # so that some crash in the step of the limit: both flags are set
    same(ours.reset(seed=3, options=dict(options)), theirs.reset(seed=3, options=dict(options)))
    seen = set()
    for row in actions(80):
        found = ours.step(row)
        same(found, theirs.step(row))
        seen |= set(zip(found[2].tolist(), found[3].tolist(), strict=True))
        over = found[2] | found[3]
        if mode is AutoresetMode.DISABLED and over.any():
            with pytest.raises(RuntimeError, match=r"after the end of the episodes in slots \["):
                ours.step(row)
            same(ours.reset(options={"reset_mask": over.copy()}), theirs.reset(options={"reset_mask": over.copy()}))
    assert seen >= {(False, True), (True, True)}
    assert ((False, False) in seen) == (limit > 1 or mode is AutoresetMode.NEXT_STEP)


def test_a_time_limit_comes_by_keyword_and_by_spec():
    name, native = f"uavbench/{CPP}", {"vectorization_mode": "vector_entry_point"}
    spec = copy.deepcopy(gym.spec(name))
    spec.max_episode_steps = 3
    limited = [gym.make_vec(name, 2, max_episode_steps=3, **native), gym.make_vec(spec, 2, **native)]
    limited.append(gym.make_vec(limited[0].spec))
    for envs in limited:
        envs.reset(seed=0)
        assert [envs.step(np.array([4, 4]))[3].tolist() for _ in range(4)] == [[False] * 2] * 2 + [[True] * 2, [False] * 2]
    for none in (None, -1):
        envs = gym.make_vec(name, 2, max_episode_steps=none, **native)
        envs.reset(seed=0)
        assert not any(envs.step(np.array([4, 4]))[3].any() for _ in range(40))


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("number", [1, 4])
def test_a_cycle_gives_every_slot_the_next_episode(number, mode):
    envs = UAVVectorEnv(CPP, number, split="validation", order="cycle", autoreset_mode=mode)
    flown = envs.reset()[1]["episode_number"].tolist()
    assert flown == list(range(number))
    running = list(flown)
    generator = np.random.default_rng(0)
    while len(flown) < 205:
        numbers = envs.step(np.where(generator.random(number) < 0.3, 5, 4))[-1]["episode_number"].tolist()
        flown += [now for before, now in zip(running, numbers, strict=True) if now != before]
        running = numbers
    assert flown[:205] == [k % 200 for k in range(205)]
    assert envs.reset(seed=3)[1]["episode_number"].tolist() == list(range(number))
    assert {split for split, _ in envs.episode} == {"validation"}
    mask = np.arange(number) == number - 1
    assert envs.reset(options={"reset_mask": mask})[1]["episode_number"][-1] == number


def test_a_slot_whose_reset_failed_does_not_fly_on():
    envs = UAVVectorEnv(CPP, 3, autoreset_mode="Disabled")
    envs.reset(seed=0)
    with pytest.raises(ValueError, match="budget"):
        envs.reset(options={"reset_mask": np.array([True, False, False]), "budget": 0})
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    with pytest.raises(RuntimeError, match=r"slots \[0\]"):
        envs.step(np.array([4, 4, 4]))


def test_single_environments_can_be_asked():
    ours, theirs = pair(CPP, "NextStep", success_cr=0.5)
    for envs in (ours, theirs):
        envs.reset(seed=3, options={"split": "test"})
        envs.set_attr("success_cr", [0.1, 0.2, 0.3, 0.4, 0.5])
    for name in ("episode", "success_cr", "render_mode", "observation_space", "action_space"):
        assert ours.call(name) == ours.get_attr(name) == theirs.call(name)
    assert ours.call("render") == theirs.call("render") == (None,) * N
    assert np.array_equal(ours.call("action_masks"), theirs.call("action_masks"))
    assert [scenario.id for scenario in ours.get_attr("scenario")] == [CPP] * N
    for row in actions(60):
        same(ours.step(row), theirs.step(row))
    for envs in (ours, theirs):
        envs.set_attr("success_cr", 0.0)
    ours.reset(seed=0)
    assert ours.step(np.full(N, 5))[-1]["is_success"].all()


def test_draws_the_frames_of_single_environments():
    options = {"split": "test", "episode": 3, "start": [7, 7]}
    ours, theirs = pair(CPP, "NextStep", render_mode="rgb_array")
    for envs in (ours, theirs):
        envs.reset(seed=0, options=dict(options))
    for row in actions(60):
        for envs in (ours, theirs):
            envs.step(row)
        assert all(np.array_equal(a, b) for a, b in zip(ours.render(), theirs.render(), strict=True))


def test_renders_every_environment():
    envs = UAVVectorEnv(CPP, 2, render_mode="ansi")
    envs.reset(seed=0)
    envs.step(np.array([4, 5]))
    assert [frame.count("@") for frame in envs.render()] == [1, 1]
