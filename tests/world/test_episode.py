"""Episodes: three disjoint splits, drawn evenly, numbers checked."""

import numpy as np
import pytest
from scipy import stats

from uavbench import load_scenario
from uavbench.simulation.simulator import Simulator
from uavbench.world.episode import TRAIN_EPISODES, check_number, check_split, episode_keys, split_size
from uavbench.world.scenario import SPLITS


def test_the_splits_are_disjoint_by_construction():
    edges = np.array([0, 1, 999, 2**32, 2**61, TRAIN_EPISODES - 1])
    keys = {split: set(episode_keys(split, edges).tolist()) for split in SPLITS}
    assert len(set.union(*keys.values())) == len(SPLITS) * len(edges)
    for place, split in enumerate(SPLITS):
        assert {key >> 62 for key in keys[split]} == {place}


def test_no_two_episodes_of_the_splits_are_alike():
    scenario = load_scenario("Manhattan32-CPP-v0")
    simulator = Simulator(scenario, 1000)
    seen = set()
    for split in SPLITS:
        size = min(1000, split_size(scenario, split))
        simulator.reset(np.arange(size), split, np.arange(size))
        seen |= {target.tobytes() for target in simulator.state.target[:size]}
    assert len(seen) == 2200


def test_starts_and_budgets_are_uniform():
    simulator = Simulator(load_scenario("Manhattan32-DH-v0"), 9000)
    simulator.reset(np.arange(9000), "train", np.arange(9000))
    state = simulator.state
    cells = np.unique(state.position[:, 0], axis=0, return_counts=True)[1]
    budgets = np.bincount(state.budget[:, 0] - 50, minlength=101)
    counts = np.bincount(simulator.mission.devices.number - 3, minlength=8)
    for found in (cells, budgets, counts):
        assert stats.chisquare(found).pvalue > 0.001
    assert len(cells) == 18


def test_an_episode_does_not_depend_on_its_slot_or_company():
    scenario = load_scenario("Urban50-DH-v0")
    one, many = Simulator(scenario, 1), Simulator(scenario, 9)
    many.reset(np.arange(9), "train", np.arange(100, 109))
    many.reset([8, 2], "train", [4, 5])
    for slot, number in ((8, 4), (2, 5), (0, 100)):
        one.reset([0], "train", [number])
        assert np.array_equal(one.state.target[0], many.state.target[slot])
        assert one.state.budget[0, 0] == many.state.budget[slot, 0]
        assert many.episode(slot) == ("train", number)


@pytest.mark.parametrize("split", ["tset", "", None, 3])
def test_an_unknown_split_is_refused(split):
    with pytest.raises(ValueError, match="train, validation, test"):
        check_split(split)


@pytest.mark.parametrize(("split", "number"), [("test", 1000), ("validation", 200), ("train", 2**62), ("test", -1)])
def test_a_number_out_of_range_is_refused(split, number):
    with pytest.raises(ValueError, match="out of range"):
        check_number(load_scenario("Block8-CPP-v0"), split, number)


@pytest.mark.parametrize("number", [1.5, "1", None, True])
def test_a_number_that_is_none_is_refused(number):
    with pytest.raises(ValueError, match="not an integer"):
        check_number(load_scenario("Block8-CPP-v0"), "test", number)


def test_numpy_integers_are_numbers():
    assert check_number(load_scenario("Block8-CPP-v0"), "test", np.int64(7)) == 7
