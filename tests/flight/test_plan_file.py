"""Plan files: valid by a schema of the format, and read back they are the mission."""

import json

import numpy as np
import pytest

from uavbench.flight.mission import NO_PLACE
from uavbench.flight.plan_file import plan_text
from uavbench.flight.zones import areas_without_holes, centres_of

jsonschema = pytest.importorskip("jsonschema")
shapely = pytest.importorskip("shapely", reason="fences need shapely: pip install 'uavbench[cities]'")

NUMBER, WHOLE = {"type": "number"}, {"type": "integer"}
LATITUDE, LONGITUDE = {"type": "number", "minimum": -90, "maximum": 90}, {"type": "number", "minimum": -180, "maximum": 180}


def record(required, **more):
    return {"type": "object", "required": list(required), "properties": {**required, **more}}


def place(*more):
    return {"type": "array", "prefixItems": [LATITUDE, LONGITUDE, *more], "minItems": 2 + len(more), "maxItems": 2 + len(more)}


#: Written from the tables of QGroundControl's developer guide, "Plan file format".
ITEM = record(
    {
        "type": {"const": "SimpleItem"},
        "autoContinue": {"type": "boolean"},
        "command": {"type": "integer", "minimum": 16, "maximum": 65535},
        "doJumpId": {"type": "integer", "minimum": 1},
        "frame": {"enum": [0, 2, 3, 10]},
        "params": {"type": "array", "items": {"type": ["number", "null"]}, "minItems": 7, "maxItems": 7},
    },
    AMSLAltAboveTerrain={"type": ["number", "null"]},
    Altitude=NUMBER,
    AltitudeMode={"enum": [0, 1, 2, 3, 4]},
)
POLYGON = record(
    {"version": {"const": 1}, "inclusion": {"type": "boolean"}, "polygon": {"type": "array", "items": place(), "minItems": 3}}
)
SCHEMA = record(
    {
        "fileType": {"const": "Plan"},
        "version": {"const": 1},
        "groundStation": {"type": "string"},
        "mission": record(
            {
                "version": {"const": 2},
                "firmwareType": {"enum": [0, 3, 12]},
                "vehicleType": {"enum": [1, 2]},
                "cruiseSpeed": NUMBER,
                "hoverSpeed": NUMBER,
                "plannedHomePosition": place(NUMBER),
                "items": {"type": "array", "items": ITEM, "minItems": 1},
            },
            globalPlanAltitudeMode=WHOLE,
        ),
        "geoFence": record(
            {"version": {"const": 2}, "circles": {"type": "array"}, "polygons": {"type": "array", "items": POLYGON}}
        ),
        "rallyPoints": record({"version": {"const": 2}, "points": {"type": "array", "items": place(NUMBER)}}),
    }
)


def test_a_plan_is_valid_and_is_the_mission(mission):
    plan = json.loads(plan_text(mission))
    jsonschema.Draft202012Validator(SCHEMA).validate(plan)
    items = plan["mission"]["items"]
    assert [item["doJumpId"] for item in items] == list(range(1, len(items) + 1))
    for found, item in zip(items, mission.items(), strict=True):
        assert (found["command"], found["frame"], found["params"]) == (item.command, item.frame, [*item.params, *item.place])
        assert found.get("Altitude") == (None if item.frame == NO_PLACE else item.place[2])
    assert plan["mission"]["plannedHomePosition"] == [*mission.home(), 0]


def test_the_fence_keeps_the_uav_on_the_map_and_out_of_what_may_not_be_flown(mission):
    plan, city = json.loads(plan_text(mission)), mission.flight.city
    polygons = [(each["inclusion"], shapely.Polygon(each["polygon"])) for each in plan["geoFence"]["polygons"]]
    assert [inside for inside, _ in polygons].count(True) == 1
    for cell in np.ndindex(city.no_fly.shape):
        there = shapely.Point(mission.ground.degrees(*cell))
        inside = [polygon.contains(there) for inclusion, polygon in polygons if inclusion]
        outside = [polygon.contains(there) for inclusion, polygon in polygons if not inclusion]
        assert inside == [True]
        assert any(outside) == bool(city.no_fly[cell])
    assert len(polygons) == 1 + len(areas_without_holes(np.asarray(city.no_fly)))


def test_rally_points_are_in_landing_zones(mission):
    city, points = mission.flight.city, json.loads(plan_text(mission))["rallyPoints"]["points"]
    cells = centres_of(np.asarray(city.landing))
    assert all(city.landing[cell] for cell in cells)
    assert points == [[*mission.ground.degrees(*cell), mission.altitude] for cell in cells]
    assert points
