"""GeoJSON: shapely reads the path, the zones and what is covered or collected."""

import json

import numpy as np
import pytest
from flights import mission_of

from uavbench.flight.geojson_file import geojson_text

shapely = pytest.importorskip("shapely", reason="zones need shapely: pip install 'uavbench[cities]'")
pyproj = pytest.importorskip("pyproj", reason="places on earth need pyproj: pip install 'uavbench[cities]'")


def features(mission):
    found = {}
    for each in json.loads(geojson_text(mission))["features"]:
        assert each["type"] == "Feature"
        shape = shapely.from_geojson(json.dumps(each["geometry"]))
        found.setdefault(each["properties"]["kind"], []).append((shape, each["properties"]))
    return found


def middle(mission, cell):
    lat, lon = mission.ground.degrees(*cell)
    return shapely.Point(lon, lat)


def test_the_path_is_the_route(mission):
    ((line, told),) = features(mission)["path"]
    assert told["distance_m"] == mission.distance
    length = pyproj.Geod(ellps="WGS84").geometry_length(shapely.force_2d(line))
    assert length == pytest.approx(mission.distance, rel=1e-5, abs=0.1)
    assert {z for _, _, z in line.coords} == {mission.altitude}
    assert told["landed"] is True
    assert told["seconds"] == pytest.approx(mission.seconds)
    waits = features(mission).get("wait", [])
    assert len(waits) == sum(stop.wait > 0 for stop in mission.route.stops)


def test_zones_are_the_cells(mission):
    found, flight = features(mission), mission.flight
    zones = {"landing": np.asarray(flight.city.landing), "no_fly": np.asarray(flight.city.no_fly)}
    if "CPP" in flight.scenario.id:
        zones |= {"covered": (flight.target > 0) & (flight.left == 0), "missed": flight.left > 0}
        assert "device" not in found
    for kind, cells in zones.items():
        ((area, told),) = found[kind]
        assert area.is_valid
        assert told["cells"] == cells.sum()
        inside = [[area.contains(middle(mission, (r, c))) for c in range(cells.shape[1])] for r in range(cells.shape[0])]
        np.testing.assert_array_equal(inside, cells)
        for polygon in area.geoms:
            assert polygon.exterior.is_ccw  # as RFC 7946 wants it
            assert not any(hole.is_ccw for hole in polygon.interiors)


@pytest.mark.parametrize("name", ["Block8-DH-v0", "Helsinki32-DH-v0"])
def test_devices_have_what_they_had_and_have_left(name):
    mission = mission_of(name, 1)
    found = features(mission)["device"]
    assert len(found) == (mission.flight.target > 0).sum()
    assert sum(told["data"] for _, told in found) == pytest.approx(mission.flight.target.sum())
    assert sum(told["left"] for _, told in found) == pytest.approx(mission.flight.left.sum())
    for point, told in found:
        cell = next(each for each in np.argwhere(mission.flight.target > 0).tolist() if middle(mission, each).equals(point))
        assert told["data"] == pytest.approx(float(mission.flight.target[tuple(cell)]))
