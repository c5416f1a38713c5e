"""Reading footprints from GeoJSON (RFC 7946)."""

import json
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

from uavbench.errors import one_line
from uavbench.geodata.footprints import LINE, POINT, Extract, Kind, Noun, Ring, kind_of, polygon
from uavbench.geodata.libraries import GeodataError
from uavbench.geodata.osm_file import OSM_LICENCE
from uavbench.world.files import read_text

_BYTES = 2**27
_DEGREES = ("crs84", "4326", "wgs84", "wgs 84")  # in the names of the coordinate systems that are in degrees
_LICENCE_KEYS = ("licence", "license", "copyright", "attribution")
_DEEPEST = 20  # collections in collections
_KINDS = {"Point": POINT, "MultiPoint": POINT, "LineString": LINE, "MultiLineString": LINE}
_NOTHING: Noun = ("feature without a geometry", "features without a geometry")
_OTHER: Noun = ("feature that is no building by its properties", "features that are no buildings by their properties")


def read_geojson(path: Path, extract: Extract, every: Kind | None = None) -> str | None:
    """Add the polygons of a file to ``extract``, and return the licence that the file states, if it does.

    If a feature of the file has the property ``building``, only features with it are buildings. Otherwise every polygon is one,
    except those whose properties make them no-fly zones.

    Parameters
    ----------
    path : Path
    extract : Extract
    every : {"building", "no-fly"}, optional
        What every polygon is, whatever its properties are.

    Raises
    ------
    FileError
        When the file does not exist, is too large or is not text.
    GeodataError
        When it is not GeoJSON, or has coordinates that are no degrees.
    """
    text = read_text(path, _BYTES)
    try:
        found: Any = json.loads(text)
        if not isinstance(found, dict):
            raise GeodataError("is not GeoJSON: it has no object at the top")
        top = cast("dict[str, Any]", found)
        _check_degrees(top)
        features = list(_features(top))
        tagged = any("building" in properties for properties, _ in features)
        for properties, geometry in features:
            kind = every or kind_of(properties) or (None if tagged else "building")
            if kind is None:
                extract.rest[_OTHER] += 1
                continue
            for rings in _polygons(geometry, 0, extract.rest):
                extract.add(polygon(rings), kind, properties)
    except GeodataError as error:
        raise GeodataError(f"{one_line(path)}: {error}") from None
    except RecursionError:
        raise GeodataError(f"{one_line(path)}: is not GeoJSON: its values are nested too deeply") from None
    except ValueError as error:
        raise GeodataError(f"{one_line(path)}: is not JSON: {one_line(error)}") from None
    return _licence(top)


def _features(top: dict[str, Any]) -> Iterator[tuple[dict[str, Any], Any]]:
    """Yield the properties and the geometry of each feature; a geometry alone is a feature without properties."""
    kind = top.get("type")
    if kind not in ("FeatureCollection", "Feature", "Polygon", "MultiPolygon", "GeometryCollection"):
        raise GeodataError(f"is not GeoJSON with polygons: its type is {one_line(kind, repr)}")
    if kind == "FeatureCollection":
        features: Any = top.get("features")
        if not isinstance(features, list):
            raise GeodataError("is not GeoJSON: a FeatureCollection has a list of features")
    else:
        features = [top if kind == "Feature" else {"type": "Feature", "geometry": top}]
    for n, feature in enumerate(cast("list[Any]", features)):
        if not isinstance(feature, dict):
            raise GeodataError(f"is not GeoJSON: feature {n} is no object")
        each = cast("dict[str, Any]", feature)
        properties: Any = each.get("properties")
        yield (cast("dict[str, Any]", properties) if isinstance(properties, dict) else {}), each.get("geometry")


def _polygons(geometry: Any, depth: int, rest: Counter[Noun]) -> Iterator[list[Ring]]:
    """Yield the rings of each polygon in a geometry, and count in ``rest`` what is no polygon."""
    if geometry is None:
        rest[_NOTHING] += 1
        return
    if depth > _DEEPEST:
        raise GeodataError(f"is not GeoJSON that can be read: more than {_DEEPEST} collections are nested")
    if not isinstance(geometry, dict):
        raise GeodataError(f"is not GeoJSON: {one_line(geometry, repr)[:60]} is no geometry")
    each = cast("dict[str, Any]", geometry)
    kind = each.get("type")
    if kind == "GeometryCollection":
        for part in _list(each.get("geometries")):
            yield from _polygons(part, depth + 1, rest)
    elif kind == "Polygon":
        yield [_ring(ring) for ring in _list(each.get("coordinates"))]
    elif kind == "MultiPolygon":
        for rings in _list(each.get("coordinates")) or [[]]:
            yield [_ring(ring) for ring in _list(rings)]
    else:
        name = one_line(kind, repr)[:40]
        rest[_KINDS.get(str(kind), (f"geometry of the unknown type {name}", f"geometries of the unknown type {name}"))] += 1


def _ring(points: Any) -> Ring:
    return [_point(point) for point in _list(points)]


def _point(point: Any) -> tuple[float, float]:
    """Return longitude and latitude of a point."""
    match _list(point):
        case [int() | float() as lon, int() | float() as lat, *_] if not isinstance(lon, bool) and not isinstance(lat, bool):
            if abs(lon) <= 180 and abs(lat) <= 90 and not math.isnan(lon) and not math.isnan(lat):
                return float(lon), float(lat)
            raise GeodataError(f"the point {one_line(point)} is out of range: GeoJSON has degrees, longitude first")
        case _:
            raise GeodataError(f"is not GeoJSON: {one_line(point, repr)[:60]} is no point")


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise GeodataError(f"is not GeoJSON: {one_line(value, repr)[:60]} is no list of coordinates or geometries")
    return cast("list[Any]", value)


def _check_degrees(top: dict[str, Any]) -> None:
    """Refuse a file that says that its coordinates are in another system: older GeoJSON could."""
    crs = top.get("crs")
    if crs is not None and not any(name in str(crs).lower() for name in _DEGREES):
        raise GeodataError(f"its coordinates are in {one_line(crs)[:80]}: convert them to degrees (WGS 84) first")


def _licence(top: dict[str, Any]) -> str | None:
    """Return the licence that a file states; Overpass writes that of OpenStreetMap as a sentence under ``copyright``."""
    for key in _LICENCE_KEYS:
        stated = top.get(key)
        if isinstance(stated, str) and stated.strip():
            return OSM_LICENCE if "openstreetmap" in stated.lower() else one_line(stated)
    return None
