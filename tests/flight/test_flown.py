"""Recorded flights with physics: what is reported is what happened, and paths survive at a moderate speed."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import uavbench_command
from flights import flight_of

from uavbench import load_scenario
from uavbench.flight.flown import Conditions, boxes_of, fly
from uavbench.flight.route import FlightError, Route, Stop, recorded_flight
from uavbench.leaderboard.submission import load_submission
from uavbench.world.city import city_of

pytest.importorskip("PyFlyt", reason="flights need PyFlyt: pip install 'uavbench[flight]'")


@pytest.mark.parametrize("name", ["Manhattan32-CPP-v0", "Urban50-CPP-v0", "Helsinki50-CPP-v0"])
def test_boxes_are_the_buildings(name):
    city = city_of(load_scenario(name))
    rows, cols = city.shape
    heights = np.zeros(city.shape)
    for west, south, east, north, height in boxes_of(city, 10.0, 10.0):
        top, left = round(rows / 2 - north / 10), round(west / 10 + cols / 2)
        bottom, right = round(rows / 2 - south / 10), round(east / 10 + cols / 2)
        assert (heights[top:bottom, left:right] == 0).all()  # no two boxes share a cell
        heights[top:bottom, left:right] = height
    np.testing.assert_array_equal(heights > 10.0, np.asarray(city.building & city.no_fly))
    np.testing.assert_array_equal((heights > 0) & (heights < 10.0), np.asarray(city.building & ~city.no_fly))
    assert len(boxes_of(city, 10.0, 10.0)) < city.building.sum() / 2


def test_a_flight_is_flown_and_covers_what_it_covers_on_the_grid():
    flight = flight_of("Block8-CPP-v0", 1)
    flown = fly(flight, Conditions(speed=3.0))
    (uav,) = flown.uavs
    assert flown.safe
    assert uav.safe
    assert uav.off_track < 2.0
    assert 3.0 < uav.clearance < 8.0
    assert flown.cr == pytest.approx(flight.cr, abs=0.05)
    assert uav.seconds > flight.routes[0].moves * 10 / 3.0
    assert 130.0 / 3600 * uav.seconds * 0.9 < uav.energy < 180.0 / 3600 * uav.seconds  # between the least power and hovering


def test_devices_are_served_along_the_true_way():
    flown = fly(flight_of("Block8-DH-v0", 1), Conditions(speed=3.0))
    assert flown.safe
    assert flown.cr == pytest.approx(flown.flight.cr, abs=0.25)


def test_the_same_flight_is_the_same_each_time():
    one, same = (fly(flight_of("Block8-CPP-v0", 2), Conditions(speed=4.0, wind=3.0)) for _ in range(2))
    assert one.uavs[0].trace.places.tobytes() == same.uavs[0].trace.places.tobytes()
    assert (one.cr, one.uavs[0].energy) == (same.cr, same.uavs[0].energy)


def test_a_path_through_a_building_hits_it_and_one_through_a_zone_enters_it():
    flight = flight_of("Block8-CPP-v0", 1)
    city = flight.city
    inside = np.argwhere(np.asarray(city.building & city.no_fly))[0].tolist()
    free = next(
        cell
        for cell in np.argwhere(~np.asarray(city.no_fly)).tolist()
        if abs(cell[0] - inside[0]) + abs(cell[1] - inside[1]) == 1
    )
    through = Route((Stop(tuple(free), 0), Stop(tuple(inside), 0)), 1, True)
    flown = fly(replace(flight, routes=(through,)))
    assert flown.uavs[0].hit
    assert not flown.safe
    assert flown.uavs[0].clearance == pytest.approx(0.0, abs=0.6)
    zones = np.argwhere(np.asarray(city.no_fly & ~city.building))
    assert len(zones)
    cell = tuple(zones[0].tolist())
    flown = fly(replace(flight, routes=(Route((Stop(cell, 2),), 0, True),)))
    assert flown.uavs[0].zone
    assert not flown.safe
    assert not flown.uavs[0].hit


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        (Conditions(speed=0.0), "--speed 0: it must be from 0.2 to 20 m/s"),
        (Conditions(wind=-1.0), "--wind -1: it must be from 0 to 20 m/s"),
        (Conditions(acceleration=math.inf), "--acceleration inf: it must be"),
        (Conditions(tolerance=0.0), "--tolerance 0: it must be"),
    ],
)
def test_conditions_out_of_range_are_refused(said, reason):
    with pytest.raises(FlightError) as error:
        fly(flight_of("Block8-CPP-v0"), said)
    assert reason in str(error.value)


def test_the_command_reports_draws_and_films(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert uavbench_command("evaluate", "--agent", "greedy", "--scenario", "Block8-CPP-v0", "--episodes", "2").exit_code == 0
    folder = "results/Block8-CPP-v0/greedy"
    told = uavbench_command("fly", folder, "--episode", "1", "--speed", "5", "--out", "a.png", "--film", "a.gif")
    assert told.exit_code == 0, told.output
    for said in ("hit something", "largest distance off the track", "CR as flown", "a.png", "a.gif"):
        assert said in told.output
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "a.gif").read_bytes().startswith(b"GIF")
    for wrong, reason in (
        (["--episode", "7"], "--episode 7"),
        (["--speed", "99"], "--speed 99"),
        (["--out", "a.doc"], "write to a file that ends in .png"),
        (["--film", "a.avi"], "write to a file that ends in .mp4 or .gif"),
    ):
        told = uavbench_command("fly", folder, *wrong)
        assert (told.exit_code, reason in told.output, "Traceback" in told.output) == (2, True, False), told.output


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Manhattan32-CPP-v0", "Urban50-CPP-v0", "Manhattan32-DH-v0", "Helsinki32-CPP-v0"])
def test_a_flight_of_planner_at_two_metres_a_second_hits_nothing(name):
    """One of each city; docs/flight.md says how ten of each went, which takes too long for a test."""
    submissions = Path(__file__).parents[2] / "leaderboard" / "submissions"
    flown = fly(recorded_flight(load_submission(submissions / "planner" / name).result, 0), Conditions(speed=2.0))
    assert flown.safe
    assert flown.cr == pytest.approx(flown.flight.cr, abs=0.1)
