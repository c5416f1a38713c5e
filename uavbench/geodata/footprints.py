"""Footprints of buildings and no-fly zones, as files hold them: in degrees of longitude and latitude."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from uavbench.geodata.heights import Basis, building_height
from uavbench.geodata.libraries import GeodataError, Geometry, library

Kind = Literal["building", "no-fly"]
#: West, south, east and north, in degrees.
Box = tuple[float, float, float, float]
Ring = Sequence[tuple[float, float]]
#: What else a file may hold, in singular and plural.
Noun = tuple[str, str]
POINT: Noun = ("point", "points")
LINE: Noun = ("line", "lines")

_MOST = 1_000_000  # footprints in memory
_WIDEST = 180.0  # degrees; what seems to be wider crosses the antimeridian
_POLYGON = 3  # shapely's number of this type of geometry
_NO_BUILDING = ("no", "false", "0", "none")
_AERODROMES = ("aerodrome", "airstrip", "heliport", "helipad", "runway")
_MILITARY = ("airfield", "barracks", "base", "danger_area", "naval_base", "range", "training_area")


class Footprint(NamedTuple):
    """A building.

    Attributes
    ----------
    shape : shapely.Polygon or shapely.MultiPolygon
        In degrees, longitude first, valid.
    height : float or None
        In metres; None if the file does not tell.
    basis : {"height", "levels", "default"}
        What the height comes from.
    """

    shape: Geometry
    height: float | None
    basis: Basis


def kind_of(tags: Mapping[str, Any]) -> Kind | None:
    """Return what the tags of an area make it: a building, a no-fly zone (an aerodrome or military), or neither."""
    building = tags.get("building")
    if building is not None and str(building).lower() not in _NO_BUILDING:
        return None if str(tags.get("location")) == "underground" else "building"
    if tags.get("aeroway") in _AERODROMES or tags.get("landuse") == "military" or tags.get("military") in _MILITARY:
        return "no-fly"
    return None


@dataclass
class Extract:
    """What was read of a file.

    Attributes
    ----------
    near : (float, float, float, float), optional
        West, south, east and north of what is wanted: footprints that are not near it are counted, but not kept.
    buildings : list of Footprint
    no_fly : list of geometries
        In degrees, valid.
    count : int
        How many buildings the file has, near or not.
    zones : int
        How many no-fly zones the file has, near or not.
    skipped : int
        How many footprints could not be used: they have missing points or no area, or cross the antimeridian.
    rest : dict of (str, str) to int
        How many other things the file has where buildings or no-fly zones could be, by what they are: points, lines, …
    extent : (float, float, float, float), optional
        West, south, east and north of all buildings.
    """

    near: Box | None = None
    buildings: list[Footprint] = field(default_factory=list[Footprint])
    no_fly: list[Geometry] = field(default_factory=list[Geometry])
    count: int = 0
    zones: int = 0
    skipped: int = 0
    rest: Counter[Noun] = field(default_factory=Counter[Noun])
    extent: Box | None = None

    @property
    def empty(self) -> bool:
        """Whether nothing was found that is a building or a no-fly zone, or could be one."""
        return not (self.count or self.zones or self.skipped or self.rest)

    def add(self, shape: Geometry | None, kind: Kind, tags: Mapping[str, Any]) -> None:
        """Add the footprint of a building or of a no-fly zone, or count that it cannot be used.

        Raises
        ------
        GeodataError
            When there are too many.
        """
        valid = None if shape is None else polygonal(shape)
        if valid is None or valid.bounds[2] - valid.bounds[0] >= _WIDEST:
            self.skipped += 1
            return
        west, south, east, north = box = valid.bounds
        if kind == "building":
            self.count += 1
            seen = self.extent or box
            self.extent = (min(seen[0], west), min(seen[1], south), max(seen[2], east), max(seen[3], north))
        else:
            self.zones += 1
        near = self.near
        if near and not (west < near[2] and east > near[0] and south < near[3] and north > near[1]):
            return
        if kind == "building":
            self.buildings.append(Footprint(valid, *building_height(tags)))
        else:
            self.no_fly.append(valid)
        if len(self.buildings) + len(self.no_fly) > _MOST:
            raise GeodataError(f"more than {_MOST:,} footprints: give --centre, or cut your district out of the file first")


def polygon(rings: Sequence[Ring]) -> Geometry | None:
    """Return the polygon of an outer ring and of the rings of its holes; None if the outer ring has too few points."""
    shapely = library("shapely")
    if not rings or len(rings[0]) < 4:
        return None
    return shapely.Polygon(rings[0], [ring for ring in rings[1:] if len(ring) >= 4])


def polygonal(shape: Geometry) -> Geometry | None:
    """Return what has an area of a geometry, repaired if it is not valid; None if nothing has."""
    shapely = library("shapely")
    if not shape.is_valid:
        shape = shapely.make_valid(shape)
    if shape.geom_type not in ("Polygon", "MultiPolygon"):
        parts = shapely.get_parts(shapely.get_parts([shape]))
        shape = shapely.union_all(parts[shapely.get_type_id(parts) == _POLYGON])
    return shape if shape.area > 0 else None
