"""Wind: the same for the same key, with the mean and the gusts that are asked for."""

import numpy as np
import pytest

from uavbench.flight.wind import wind_of


def test_the_wind_of_a_key_is_always_the_same():
    one, same, other = (wind_of(key, 5.0, 10.0, 3.0, 100.0) for key in (3, 3, 4))
    assert one.gusts.tobytes() == same.gusts.tobytes()
    assert (one.mean == same.mean).all()
    assert not (one.mean == other.mean).all()
    assert not np.array_equal(one.gusts, other.gusts)


def test_mean_and_gusts_are_those_of_the_model():
    found = [wind_of(key, 6.0, 10.0, 4.0, 2_000.0) for key in range(20)]
    assert [np.linalg.norm(wind.mean) for wind in found] == pytest.approx([6.0] * 20)
    directions = np.arctan2(*np.array([wind.mean for wind in found]).T)
    assert np.ptp(directions) > 3.0
    gusts = np.concatenate([wind.gusts for wind in found])
    feet = 10.0 / 0.3048
    factor = 0.177 + 0.000823 * feet
    assert np.abs(gusts.mean(axis=0)).max() < 0.15
    # The axes are mixtures of along and across, which have equal deviations.
    assert gusts.std(axis=0) == pytest.approx(0.6 / factor**0.4, rel=0.1)
    length = feet / factor**1.2 * 0.3048
    one = found[0].gusts[:, 0]
    assert np.corrcoef(one[:-10], one[10:])[0, 1] == pytest.approx(np.exp(-1.0 * 10.0 / length), abs=0.1)


def test_between_two_values_the_wind_changes_evenly_and_after_the_end_it_stays():
    wind = wind_of(1, 5.0, 10.0, 3.0, 10.0)
    assert wind.at(0.35) == pytest.approx(wind.mean + (wind.gusts[3] + wind.gusts[4]) / 2)
    assert wind.at(1e9) == pytest.approx(wind.mean + wind.gusts[-1])
    assert wind.at(-1.0) == pytest.approx(wind.mean + wind.gusts[0])
    assert not wind_of(1, 0.0, 10.0, 3.0, 10.0).at(2.0).any()
