"""The radio channel, and the shortcuts that find the best device: they must change nothing but the time."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import HARVESTING, scenario

from uavbench.simulation.missions.channel import log_below
from uavbench.simulation.simulator import Simulator

ROWS = ("LL......", "........", "..##..#.", "..##....", "......N.", "........", ".#...#..", "........")


@given(st.floats(1e-300, 1e300))
def test_the_bound_of_a_logarithm_is_close_and_never_above(x):
    assert math.log(x) - 0.0601 < log_below(x) <= math.log(x)


def test_the_bound_holds_beside_powers_of_two():
    for power in range(-40, 41):
        for x in (math.nextafter(2.0**power, 0.0), 2.0**power, math.nextafter(2.0**power, math.inf)):
            assert math.log(x) - 0.0601 < log_below(x) <= math.log(x)


@pytest.mark.parametrize("noise", [True, False])
@settings(max_examples=30)
@given(guesses=st.lists(st.integers(-1, 9), min_size=40, max_size=40), number=st.integers(0, 10_000))
def test_the_guess_at_the_device_served_next_changes_nothing(guesses, number, noise):
    """Whatever device is looked at first, devices beyond those of the episode included."""
    world = scenario(ROWS, {**HARVESTING, "devices": (1, 9)}, budget=(40, 40))
    simulators = [Simulator(world, 1), Simulator(world, 1)]
    actions = np.random.default_rng(number).integers(0, 5, 40)
    for each in simulators:
        each.reset([0], "train", [number])
        each.customise(0, {"noise": noise})
    for action, guess in zip(actions, guesses, strict=True):
        simulators[1].mission._served_last[:] = guess
        for each in simulators:
            each.step([action])
        first, second = ((*each.state.arrays().values(), *each.mission.arrays().values()) for each in simulators)
        assert [part.tobytes() for part in first] == [part.tobytes() for part in second]


def test_of_devices_that_are_equally_good_the_first_is_served():
    world = scenario(ROWS, {**HARVESTING, "devices": (1, 3), "fading_variance": {"los": 0.0, "nlos": 0.0}}, budget=(9, 9))
    for guess in (0, 1, 2):
        simulator = Simulator(world, 1)
        simulator.reset([0], "test", [0])
        simulator.customise(0, {"start": [0, 0], "devices": [[5, 1, 9.0], [1, 5, 9.0], [5, 0, 9.0]]})
        simulator.customise(0, {"start": [0, 0], "devices": [[1, 1, 9.0], [7, 7, 9.0], [6, 7, 9.0]], "noise": False})
        simulator.mission._served_last[:] = guess
        simulator.step([4])
        left = simulator.mission.arrays()["data"][0].tolist()
        assert left[0] < 9.0
        assert left[1:] == [9.0, 9.0]
