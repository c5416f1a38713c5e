"""Power by airspeed, as the cited model has it."""

import numpy as np
import pytest

from uavbench.flight.energy import power


def test_hovering_and_known_points_of_the_curve():
    assert power(np.array([0.0]))[0] == pytest.approx(79.86 + 88.63)
    speeds = np.linspace(0, 30, 301)
    curve = power(speeds)
    assert 9.0 < speeds[curve.argmin()] < 11.5  # the speed of the longest flight, about 10 m/s in the paper's figure 2
    assert 120.0 < curve.min() < 132.0
    assert curve[-1] > 300.0


def test_the_terms_one_by_one():
    v = 12.0
    profile = 79.86 * (1 + 3 * v**2 / 120**2)
    induced = 88.63 * ((1 + v**4 / (4 * 4.03**4)) ** 0.5 - v**2 / (2 * 4.03**2)) ** 0.5
    drag = 0.5 * 0.6 * 1.225 * 0.05 * 0.503 * v**3
    assert power(np.array([v]))[0] == pytest.approx(profile + induced + drag)
