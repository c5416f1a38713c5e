"""The forms of observations: compact ones hold the same to the last bit, in a quarter of the memory."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from worlds import COVERAGE, HARVESTING, SURVEILLANCE, scenario

import uavbench
from uavbench.envs.forms import Form

NAMES = ("Manhattan32-CPP-v0", "Urban50-CPP-v0", "Manhattan32-DH-v0", "Urban50-DH-v0")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("normalize", [False, True])
def test_a_compact_observation_is_small_and_expands_to_the_same_bits(name, normalize):
    plain, compact = uavbench.make_vec(name, 5), uavbench.make_vec(name, 5, compact=True, normalize=normalize)
    form, random = Form(compact.scenario, True, normalize), np.random.default_rng(0)
    (usual, _), (small, _) = plain.reset(seed=0), compact.reset(seed=0)
    assert sum(values[0].nbytes for values in small.values()) <= 3_000
    largest = compact.scenario.budget[1] if normalize else 1
    for _ in range(250):
        expanded = form.expand(small)
        for part in ("local", "global"):
            assert np.array_equal(expanded[part], usual[part])
            assert expanded[part].dtype == np.float32
        assert np.array_equal(expanded["budget"], usual["budget"] / np.float32(largest))
        assert compact.observation_space.contains(small)
        actions = random.integers(0, 6, 5)
        usual, small = plain.step(actions)[0], compact.step(actions)[0]


@pytest.mark.parametrize("name", NAMES[::2])
def test_the_vector_environment_has_the_form_of_the_single_one(name):
    for mode in ("SameStep", "NextStep"):
        how = {"sync": {"vector_kwargs": {"autoreset_mode": mode}}, "vector_entry_point": {"autoreset_mode": mode}}
        made = [gym.make_vec(f"uavbench/{name}", 3, kind, compact=True, normalize=True, **more) for kind, more in how.items()]
        seen, random = [envs.reset(seed=4)[0] for envs in made], np.random.default_rng(2)
        for _ in range(250):
            assert all(np.array_equal(seen[0][part], seen[1][part]) for part in seen[0])
            assert seen[0].keys() == seen[1].keys()
            actions = random.integers(0, 6, 3)
            steps = [envs.step(actions) for envs in made]
            seen = [step[0] for step in steps]
            if "final_obs" in steps[0][-1]:
                for first, second in zip(*(step[-1]["final_obs"] for step in steps), strict=True):
                    assert (first is None) == (second is None)
                    assert first is None or all(np.array_equal(first[part], second[part]) for part in first)


@pytest.mark.parametrize("mission", [COVERAGE, HARVESTING])
@pytest.mark.parametrize("sizes", [(0, 1), (3, 2), (5, 7)])
def test_every_size_has_a_compact_form(mission, sizes):
    rows = ("LL......", "........", "..###...", "........", "........")
    world = scenario(rows, mission).with_observation(*sizes)
    env, plain, form = uavbench.make(world, compact=True), uavbench.make(world), Form(world, compact=True)
    check_env(env, skip_render_check=True)
    for seed in range(20):
        small, usual = env.reset(seed=seed)[0], plain.reset(seed=seed)[0]
        expanded = form.expand({name: values[None] for name, values in small.items()})
        assert expanded.keys() == usual.keys()
        assert all(np.array_equal(expanded[name][0], usual[name]) for name in usual)


def test_what_has_no_compact_form_says_so():
    world = scenario(("LL..", "....", "....", "...."), SURVEILLANCE)
    with pytest.raises(ValueError, match="compact: observations of Test-v0 have no compact form"):
        uavbench.make(world, compact=True)
    assert uavbench.make(world, normalize=True).reset(seed=0)[0]["budget"] <= 1
