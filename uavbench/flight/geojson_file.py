"""Missions as GeoJSON (RFC 7946): the path, the zones, and what is covered or collected."""

import itertools
import json
from typing import Any

import numpy as np

from uavbench.flight.mission import Mission
from uavbench.flight.zones import Area, areas_of


def geojson_text(mission: Mission) -> str:
    """Return the text of the file: a FeatureCollection, whose features say what they are in the property ``kind``."""
    flight, ground = mission.flight, mission.ground
    path = [_point(ground.degrees(*stop.cell), mission.altitude) for stop in mission.route.stops]
    told: dict[str, Any] = {
        "title": mission.title,
        "altitude_m": mission.altitude,
        "speed_m_s": mission.settings.speed,
        "distance_m": mission.distance,
        "seconds": mission.seconds,
        "landed": mission.route.landed,
    }
    if mission.warning:
        told["warning"] = mission.warning
    line = {"type": "LineString", "coordinates": path if len(path) > 1 else path * 2}  # a line has two places at least
    features = [_feature("path", line, told)]
    waits = [(stop.cell, stop.wait) for stop in mission.route.stops if stop.wait]
    seconds = ground.cell / mission.settings.speed
    features += [
        _feature(
            "wait",
            {"type": "Point", "coordinates": _point(ground.degrees(*cell), mission.altitude)},
            {"seconds": steps * seconds},
        )
        for cell, steps in waits
    ]
    features += [
        _zone(mission, "landing", np.asarray(flight.city.landing)),
        _zone(mission, "no_fly", np.asarray(flight.city.no_fly)),
    ]
    if mission.marks:
        for cell in np.argwhere(flight.target > 0).tolist():
            amounts = {"data": float(flight.target[tuple(cell)]), "left": float(flight.left[tuple(cell)])}
            features.append(_feature("device", {"type": "Point", "coordinates": _point(ground.degrees(*cell))}, amounts))
    else:
        features += [_zone(mission, "covered", mission.done()), _zone(mission, "missed", mission.missed())]
    return json.dumps({"type": "FeatureCollection", "features": features}, ensure_ascii=False, indent=1) + "\n"


def _zone(mission: Mission, kind: str, cells: Any) -> dict[str, Any]:
    """Return a feature of cells. Outlines run against the clock and holes with it, as the RFC wants them."""
    polygons = [_rings(mission, area) for area in areas_of(cells)]
    return _feature(kind, {"type": "MultiPolygon", "coordinates": polygons}, {"cells": int(cells.sum())})


def _rings(mission: Mission, area: Area) -> list[list[list[float]]]:
    outline, holes = area
    rings = [_turned(outline, against_the_clock=True), *(_turned(hole, against_the_clock=False) for hole in holes)]
    return [[_point(place) for place in mission.ground.ring(ring)] for ring in rings]


def _turned(ring: list[tuple[float, float]], against_the_clock: bool) -> list[tuple[float, float]]:
    """Return a ring of corners (row, column) in a direction, as it looks on a map with north at the top."""
    twice = sum((c0 * -r1) - (c1 * -r0) for (r0, c0), (r1, c1) in itertools.pairwise(ring))
    return ring if (twice > 0) == against_the_clock else ring[::-1]


def _point(place: tuple[float, float], *altitude: float) -> list[float]:
    """Return a position: longitude, latitude, and an altitude if there is one."""
    return [place[1], place[0], *altitude]


def _feature(kind: str, geometry: dict[str, Any], told: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": {"kind": kind, **told}}
