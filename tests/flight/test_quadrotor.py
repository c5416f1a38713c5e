"""Quadrotors in physics: they keep to their track, hit what is in their way, and do the same each time."""

import subprocess
import sys

import numpy as np
import pytest

from uavbench.flight.quadrotor import fly_track
from uavbench.flight.track import track_along
from uavbench.flight.wind import wind_of

pytest.importorskip("PyFlyt", reason="flights need PyFlyt: pip install 'uavbench[flight]'")

CORNER = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 30.0]])


def track(speed=4.0):
    return track_along(CORNER, np.zeros(3), speed=speed, acceleration=2.0, tolerance=1.0)


@pytest.mark.parametrize("speed", [2.0, 8.0])
def test_it_takes_off_keeps_to_the_track_and_lands(speed):
    wanted = track(speed)
    trace = fly_track(wanted, 10.0, [], None, 1)
    first, last = trace.on_track
    rise = trace.seconds[first]
    planned = [wanted.at(now - rise)[0] for now in trace.seconds]
    away = np.linalg.norm(trace.places[:, :2] - planned, axis=1)
    assert away[first:last].max() < 1.5
    assert np.abs(trace.places[first:last, 2] - 10.0).max() < 0.3
    assert trace.places[0] == pytest.approx([0.0, 0.0, 0.1])
    assert trace.places[-1] == pytest.approx([30.0, 30.0, 0.05], abs=1.0)
    assert not trace.hit
    assert np.diff(trace.seconds) == pytest.approx(0.05, abs=1e-6)
    assert trace.airspeeds == pytest.approx(np.linalg.norm(trace.velocities, axis=1))
    assert trace.airspeeds.max() < 1.2 * speed + 1.0


def test_it_hits_what_is_in_its_way_and_nothing_beside():
    assert fly_track(track(), 10.0, [(12.0, -5.0, 16.0, 5.0, 20.0)], None, 1).hit
    trace = fly_track(track(), 10.0, [(12.0, -5.0, 16.0, 5.0, 20.0)], None, 1)
    assert trace.places[-1][0] == pytest.approx(12.0, abs=0.6)
    assert not fly_track(track(), 10.0, [(12.0, -5.0, 16.0, 5.0, 8.0)], None, 1).hit  # it is flown over
    assert not fly_track(track(), 10.0, [(12.0, 3.0, 16.0, 9.0, 20.0)], None, 1).hit


def test_the_same_key_gives_the_same_flight_to_the_last_bit():
    one, same, other = (fly_track(track(), 10.0, [], wind_of(seed, 3.0, 10.0, 4.0, 100.0), seed) for seed in (5, 5, 6))
    for name in ("seconds", "places", "velocities", "angles", "airspeeds"):
        assert getattr(one, name).tobytes() == getattr(same, name).tobytes()
    assert not np.array_equal(one.places, other.places)


def test_wind_is_felt():
    still, windy = fly_track(track(), 10.0, [], None, 5), fly_track(track(), 10.0, [], wind_of(5, 6.0, 10.0, 4.0, 100.0), 5)
    first, last = still.on_track
    moved = np.linalg.norm(windy.places[first:last, :2] - still.places[first:last, :2], axis=1)
    assert 0.1 < moved.max() < 6.0
    assert abs(windy.airspeeds[first:last].mean() - still.airspeeds[first:last].mean()) > 0.2


def test_nothing_is_printed_by_the_library():
    flight = (
        "fly_track(track_along(np.array([[0.0, 0.0], [9.0, 0.0]]), np.zeros(2), speed=4.0, acceleration=2.0, tolerance=1.0)"
    )
    code = f"""
import numpy as np
from uavbench.flight.quadrotor import fly_track
from uavbench.flight.track import track_along
{flight}, 10.0, [], None, 1)
"""  # the library says when it was built as it is imported, so that takes a process of its own
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")
