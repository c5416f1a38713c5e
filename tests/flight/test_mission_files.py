"""Mission files: what is written is what was flown, and what cannot be flown is refused in one line."""

import json
import math
from dataclasses import replace

import pytest
from commands import uavbench_command
from flights import ORIGIN, SCENARIOS, flight_of, mission_of, result_of

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.flight.ground import Ground, altitude_of, cell_size, read_origin
from uavbench.flight.mission import LAND, LOITER_TIME, NO_PLACE, TAKE_OFF, TRIGGER_CAMERA, WAYPOINT, Settings
from uavbench.flight.mission_files import FORMATS, write_missions
from uavbench.flight.route import FlightError

pyproj = pytest.importorskip("pyproj", reason="places on earth need pyproj: pip install 'uavbench[cities]'")
GEOD = pyproj.Geod(ellps="WGS84")


def metres(places):
    """The length of a way over the ellipsoid."""
    lats, lons = zip(*places, strict=True)
    return GEOD.line_length(lons, lats)


def test_the_way_over_the_earth_is_as_long_as_the_way_on_the_grid(mission):
    places = [item.place[:2] for item in mission.items() if item.frame != NO_PLACE]
    assert metres(places) == pytest.approx(mission.distance, rel=1e-5, abs=0.1)
    assert mission.distance == mission.route.moves * mission.ground.cell


def test_a_mission_takes_off_flies_the_route_and_lands(mission):
    items, route = mission.items(), mission.route
    assert items[0].command == TAKE_OFF
    assert items[-1].command == LAND
    assert items[0].place == (*mission.ground.degrees(*route.stops[0].cell), mission.altitude)
    assert items[-1].place == (*mission.ground.degrees(*route.stops[-1].cell), 0.0)
    flown = [item for item in items if item.command in (WAYPOINT, LOITER_TIME)]
    stops = [stop for k, stop in enumerate(route.stops) if k or stop.wait]
    assert [item.place[:2] for item in flown] == [mission.ground.degrees(*stop.cell) for stop in stops]
    seconds = mission.ground.cell / mission.settings.speed
    for item, stop in zip(flown, stops, strict=True):
        assert item.command == (LOITER_TIME if stop.wait else WAYPOINT)
        assert item.params[0] == pytest.approx(stop.wait * seconds)
    camera = [item.params[0] for item in items if item.command == TRIGGER_CAMERA]
    assert camera == ([mission.ground.cell, 0.0] if "CPP" in mission.flight.scenario.id else [])
    waits = sum(item.params[0] for item in items if item.command == LOITER_TIME)
    assert mission.seconds == pytest.approx(mission.distance / mission.settings.speed + waits)


def test_some_missions_wait():
    flights = [flight_of(name, k) for name in ("Block8-DH-v0", "Helsinki32-DH-v0") for k in range(4)]
    assert any(stop.wait for flight in flights for stop in flight.routes[0].stops)


def test_uavs_of_a_team_have_files_of_their_own_at_altitudes_of_their_own(tmp_path):
    flight = next(flight_of(SCENARIOS[-1], k) for k in range(4) if len(flight_of(SCENARIOS[-1], k).routes) > 1)
    settings = Settings(altitude=20.0, altitude_step=3.0)
    paths = write_missions(flight, "plan", settings=settings, origin=ORIGIN, out=tmp_path / "team.plan")
    assert [path.name for path in paths] == [f"team-uav{k + 1}.plan" for k in range(len(flight.routes))]
    for k, path in enumerate(paths):
        assert json.loads(path.read_text())["mission"]["items"][0]["Altitude"] == 20.0 + 3.0 * k


def test_the_middle_of_the_map_is_the_origin_and_north_is_up():
    ground = Ground(load_scenario("Block8-CPP-v0"), ORIGIN)
    lat, lon = ground.degrees(3.5, 3.5)
    assert (lat, lon) == pytest.approx(ORIGIN, abs=1e-7)
    north, east = ground.degrees(2.5, 3.5), ground.degrees(3.5, 4.5)
    assert GEOD.inv(lon, lat, north[1], north[0])[0::2] == pytest.approx((0.0, 10.0), abs=0.02)
    assert GEOD.inv(lon, lat, east[1], east[0])[0::2] == pytest.approx((90.0, 10.0), abs=0.02)


def test_a_real_place_is_where_its_file_says():
    scenario = load_scenario("Helsinki50-CPP-v0")
    south, west, north, east = scenario.provenance.bounds
    ground, (rows, cols) = Ground(scenario), scenario.shape
    corners = ground.ring([(0, 0), (0, cols), (rows, cols), (rows, 0)])
    assert max(lat for lat, _ in corners) == pytest.approx(north, abs=2e-6)
    assert min(lat for lat, _ in corners) == pytest.approx(south, abs=2e-6)
    assert max(lon for _, lon in corners) == pytest.approx(east, abs=2e-6)
    assert min(lon for _, lon in corners) == pytest.approx(west, abs=2e-6)
    assert (cell_size(scenario), altitude_of(scenario)) == (10.0, 25.0)
    assert (cell_size(load_scenario("Urban50-DH-v0")), altitude_of(load_scenario("Urban50-CPP-v0"))) == (10.0, 10.0)


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"origin": None}, "Block8-CPP-v0 is no real place: say where its map is, --origin LAT,LON"),
        ({"origin": (91.0, 0.0)}, "--origin: centre: 91, 0 is no place"),
        ({"origin": (0.0, 181.0)}, "--origin: centre: 0, 181 is no place"),
        ({"origin": (89.0, 0.0)}, "too near to a pole"),
        ({"origin": (math.nan, 0.0)}, "--origin: centre: nan, 0 is no place"),
        ({"settings": Settings(speed=0.0)}, "--speed 0: it must be from 0.1 to 50 m/s"),
        ({"settings": Settings(speed=math.nan)}, "--speed nan: it must be"),
        ({"settings": Settings(altitude=-5.0)}, "--altitude -5: it must be"),
        ({"settings": Settings(altitude_step=-1.0)}, "--altitude-step -1: it must be"),
        ({"settings": Settings(camera_distance=0.0)}, "--camera-distance 0: it must be"),
        ({"format_": "pdf"}, "--format pdf: choose one of plan, waypoints, geojson, kml"),
    ],
)
def test_what_cannot_be_a_mission_is_refused(given, reason, tmp_path):
    words = {"format_": "plan", "origin": ORIGIN, "out": tmp_path / "a.plan", **given}
    with pytest.raises(FlightError) as error:
        write_missions(flight_of("Block8-CPP-v0"), **words)
    assert reason in str(error.value)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_a_real_place_has_no_other_origin(tmp_path):
    with pytest.raises(FlightError, match="--origin: Helsinki32-CPP-v0 is a real place"):
        write_missions(flight_of("Helsinki32-CPP-v0"), "plan", origin=ORIGIN, out=tmp_path / "a.plan")


@pytest.mark.parametrize("format_", FORMATS)
def test_a_flight_that_crashed_is_written_on_purpose_only_and_says_so(format_, tmp_path):
    flight = flight_of("Block8-CPP-v0")
    crashed = replace(flight, routes=tuple(replace(route, landed=False) for route in flight.routes))
    with pytest.raises(FlightError, match=r"did not land within its budget.*--unsafe"):
        write_missions(crashed, format_, origin=ORIGIN, out=tmp_path / "a")
    assert not list(tmp_path.iterdir())
    (path,) = write_missions(crashed, format_, origin=ORIGIN, out=tmp_path / "a", unsafe=True)
    assert "UNSAFE" in path.read_text(encoding="utf-8")
    (path,) = write_missions(flight, format_, origin=ORIGIN, out=tmp_path / "a", unsafe=True)
    assert "UNSAFE" not in path.read_text(encoding="utf-8")


def test_random_flights_crash():
    """So that the test above is about what happens."""
    records = list(evaluate(Job(find_agent("random"), load_scenario("Manhattan32-CPP-v0"), "test"), range(20)))
    number = next(record.episode for record in records if not record.landed)
    assert not flight_of_random(number).landed


def flight_of_random(number):
    from uavbench.flight.route import recorded_flight

    return recorded_flight(result_of("Manhattan32-CPP-v0", "random", 20), number)


@pytest.mark.parametrize(("text", "place"), [("60.17,24.94", (60.17, 24.94)), (" -1e1 , 5", (-10.0, 5.0))])
def test_an_origin_is_two_numbers(text, place):
    assert read_origin(text) == place
    for wrong in ("", "60.17", "1,2,3", "a,b", "60,17,24,94"):
        with pytest.raises(FlightError, match="write latitude and longitude in degrees"):
            read_origin(wrong)


def test_the_command_writes_a_file_and_says_where(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["evaluate", "--agent", "greedy", "--scenario", "Block8-DH-v0", "--episodes", "3"]
    assert uavbench_command(*words).exit_code == 0
    folder = "results/Block8-DH-v0/greedy"
    for name, (_, ending) in FORMATS.items():
        told = uavbench_command("mission", folder, "--episode", "2", "--format", name, "--origin", "48.1,11.5")
        assert told.exit_code == 0, told.output
        assert told.output.strip() == f"Block8-DH-v0-greedy-2{ending}"
        assert (tmp_path / told.output.strip()).stat().st_size > 300
    before = sorted(path.name for path in tmp_path.iterdir())
    for wrong, reason in (
        (["--episode", "3"], "--episode 3: results/Block8-DH-v0/greedy holds the episodes 0 to 2"),
        ([], "is no real place"),
        (["--origin", "north"], "--origin north: write latitude and longitude"),
        (["--origin", "95,0"], "95, 0 is no place"),
        (["--origin", "48,11", "--out", "missing/file/a.plan", "--speed", "100"], "--speed 100"),
    ):
        told = uavbench_command("mission", folder, *wrong)
        assert (told.exit_code, reason in told.output, "Traceback" in told.output) == (2, True, False), told.output
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_a_result_of_another_version_of_the_scenario_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    uavbench_command("evaluate", "--agent", "greedy", "--scenario", "Block8-CPP-v0", "--episodes", "2")
    path = tmp_path / "results" / "Block8-CPP-v0" / "greedy" / "summary.json"
    summary = json.loads(path.read_text())
    path.write_text(json.dumps({**summary, "scenario_digest": "0" * 64}))
    told = uavbench_command("mission", path.parent, "--origin", "48.1,11.5")
    assert (told.exit_code, "scenario_digest" in told.output) == (2, True), told.output


def test_missions_are_the_same_each_time_and_differ_between_episodes():
    texts = []
    for episode in (1, 2):
        for format_, (text, _) in FORMATS.items():
            one, other = (text(mission_of("Block8-DH-v0", episode)) for _ in range(2))
            assert one == other, format_
            texts.append(one)
    assert len(set(texts)) == 8
