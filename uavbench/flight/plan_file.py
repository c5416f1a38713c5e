"""Missions as ``.plan`` files of QGroundControl: commands, geofence and rally points.

The format: https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html
"""

import json
from typing import Any

import numpy as np

from uavbench.flight.mission import NO_PLACE, Item, Mission
from uavbench.flight.zones import areas_without_holes, centres_of

_PX4, _QUADROTOR = 12, 2  # MAV_AUTOPILOT and MAV_TYPE
_ABOVE_HOME = 1  # QGroundControl's altitude mode


def plan_text(mission: Mission) -> str:
    """Return the text of the file.

    The map's edge is the fence, and cells that may not be flown, no-fly zones and buildings, are areas to keep out of. The
    middle of each landing zone is a rally point.
    """
    city, ground = mission.flight.city, mission.ground
    rows, cols = city.no_fly.shape
    edge = ground.ring([(0, 0), (0, cols), (rows, cols), (rows, 0)])
    fences = [_polygon(edge, inclusion=True)]
    fences += [_polygon(ground.ring(ring[:-1]), inclusion=False) for ring in areas_without_holes(np.asarray(city.no_fly))]
    rally = [[*ground.degrees(*cell), mission.altitude] for cell in centres_of(np.asarray(city.landing))]
    speed = mission.settings.speed
    plan: dict[str, Any] = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            "version": 2,
            "firmwareType": _PX4,
            "vehicleType": _QUADROTOR,
            "cruiseSpeed": speed,
            "hoverSpeed": speed,
            "globalPlanAltitudeMode": _ABOVE_HOME,
            "plannedHomePosition": [*mission.home(), 0],
            "items": [_item(k + 1, item) for k, item in enumerate(mission.items())],
        },
        "geoFence": {"version": 2, "circles": [], "polygons": fences},
        "rallyPoints": {"version": 2, "points": rally},
        "uavbench": {"title": mission.title, **({"warning": mission.warning} if mission.warning else {})},
    }
    return json.dumps(plan, indent=2, ensure_ascii=False) + "\n"


def _polygon(ring: list[tuple[float, float]], inclusion: bool) -> dict[str, Any]:
    return {"version": 1, "inclusion": inclusion, "polygon": [list(corner) for corner in ring]}


def _item(number: int, item: Item) -> dict[str, Any]:
    """Return a command as the file has it; QGroundControl keeps the altitude of a place in three more fields."""
    place = (
        {} if item.frame == NO_PLACE else {"AMSLAltAboveTerrain": None, "Altitude": item.place[2], "AltitudeMode": _ABOVE_HOME}
    )
    head = {"type": "SimpleItem", "doJumpId": number, "command": item.command, "frame": item.frame, "autoContinue": True}
    return {**head, **place, "params": [*item.params, *item.place]}
