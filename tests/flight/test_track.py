"""Tracks: within the tolerance of the path, the speed and the acceleration, and all the way."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uavbench.flight.track import track_along

ways = st.lists(st.sampled_from([(0, 1), (1, 0), (0, -1), (-1, 0)]), min_size=1, max_size=15).flatmap(
    lambda turns: st.tuples(
        st.just(turns),
        st.lists(st.integers(1, 4), min_size=len(turns), max_size=len(turns)),
        st.lists(st.sampled_from([0.0, 0.0, 3.0]), min_size=len(turns) + 1, max_size=len(turns) + 1),
    )
)


def stops_of(turns, lengths):
    legs = 10.0 * np.array(turns, dtype=float) * np.array(lengths)[:, None]
    return np.concatenate([[[0.0, 0.0]], np.cumsum(legs, axis=0)])


def distances(places, stops):
    least = np.full(len(places), np.inf)
    for one, other in itertools.pairwise(stops):
        way = other - one
        part = np.clip((places - one) @ way / (way @ way), 0, 1)
        least = np.minimum(least, np.linalg.norm(places - one - part[:, None] * way, axis=1))
    return least


@settings(max_examples=60, deadline=None)
@given(way=ways, speed=st.sampled_from([1.0, 3.0, 8.0]), tolerance=st.sampled_from([0.3, 1.0, 3.0]))
def test_a_track_keeps_its_limits(way, speed, tolerance):
    turns, lengths, waits = way
    stops, waits = stops_of(turns, lengths), np.array(waits)
    track = track_along(stops, waits, speed=speed, acceleration=2.0, tolerance=tolerance)
    assert np.diff(track.seconds) == pytest.approx(0.05)
    assert track.places[0] == pytest.approx(stops[0], abs=1e-6)
    assert track.places[-1] == pytest.approx(stops[-1], abs=1e-3)
    assert np.linalg.norm(track.velocities, axis=1).max() <= 1.01 * speed
    # Smoothing over time cuts corners a little more, by at most a(T/2)²/2.
    assert distances(track.places, stops).max() <= tolerance + 2.0 * 0.4**2 / 2
    assert np.linalg.norm(track.accelerations, axis=1).max() <= 2.0 * 2**0.5 + 0.6  # across and along together
    for stop in stops:
        assert np.linalg.norm(track.places - stop, axis=1).min() <= 1.5 * tolerance + 0.2
    assert track.seconds[-1] >= 10.0 * sum(lengths) / speed - 2 * 1.5 * tolerance * len(turns) / speed + waits.sum()


def test_it_slows_down_at_turns_and_rests_where_it_waits():
    stops, waits = stops_of([(0, 1), (1, 0), (-1, 0)], [5, 5, 5]), np.array([0.0, 0.0, 2.0, 0.0])
    track = track_along(stops, waits, speed=8.0, acceleration=2.0, tolerance=1.0)
    speeds = np.linalg.norm(track.velocities, axis=1)
    first = track.seconds < track.seconds[-1] / 3  # the way comes back to the corner at its end
    corner = np.linalg.norm(track.places[first] - stops[1], axis=1).argmin()
    assert 0.5 < speeds[corner] < 3.0  # √(2 · 1 / (√2 − 1)) = 2.2
    assert speeds.max() > 7.0
    there = np.linalg.norm(track.places - stops[2], axis=1) < 0.05
    assert there.sum() * 0.05 >= 2.0
    assert speeds[there].min() < 0.01
    place, velocity, acceleration = track.at(1e6)
    assert (place == track.places[-1]).all()
    assert not velocity.any()
    assert not acceleration.any()
    assert (track.at(-1.0)[0] == track.places[0]).all()
    half = track.at(0.5 * (track.seconds[40] + track.seconds[41]))
    assert half[0] == pytest.approx((track.places[40] + track.places[41]) / 2)


def test_more_tolerance_is_faster_and_less_speed_slower():
    stops, waits = stops_of([(0, 1), (1, 0)] * 6, [2] * 12), np.zeros(13)
    times = [
        track_along(stops, waits, speed=speed, acceleration=2.0, tolerance=tolerance).seconds[-1]
        for speed, tolerance in ((2.0, 0.5), (5.0, 0.5), (5.0, 2.0))
    ]
    assert times[0] > times[1] > times[2]


def test_a_flight_that_stays_is_a_track_that_stays():
    track = track_along(np.zeros((1, 2)), np.array([4.0]), speed=3.0, acceleration=2.0, tolerance=1.0)
    assert not track.places.any()
    assert track.seconds[-1] >= 4.0
