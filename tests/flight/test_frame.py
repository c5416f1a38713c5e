"""Cells and metres."""

import numpy as np
import pytest

from uavbench.flight.frame import cells_of, metres_of


def test_north_is_up_and_the_middle_of_the_map_is_zero():
    corners = np.array([[-0.5, -0.5], [-0.5, 5.5], [3.5, 2.5], [1.5, 2.5]])
    assert metres_of(corners, (4, 6), 10.0).tolist() == [[-30.0, 20.0], [30.0, 20.0], [0.0, -20.0], [0.0, 0.0]]


def test_there_and_back():
    places = np.random.default_rng(0).uniform(-3, 30, (50, 2))
    assert cells_of(metres_of(places, (20, 31), 7.5), (20, 31), 7.5) == pytest.approx(places)
