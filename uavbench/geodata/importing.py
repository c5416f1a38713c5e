"""Importing a city: from a file of footprints to a scenario that is ready to fly."""

import hashlib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from uavbench.errors import one_line
from uavbench.geodata.city_file import MissionName, check_out, city_toml, default_id, write_city
from uavbench.geodata.footprints import Box, Extract, polygonal
from uavbench.geodata.geojson_file import read_geojson
from uavbench.geodata.heights import Basis
from uavbench.geodata.landing import Zone, choose_zones, close_unreachable, place_zones
from uavbench.geodata.libraries import GeodataError, Geometry, library
from uavbench.geodata.osm_file import OSM_LICENCE, read_osm
from uavbench.geodata.projection import Projection, check_centre, near
from uavbench.geodata.rasterise import Grid
from uavbench.geodata.rasterise import cells as rasterise
from uavbench.geodata.window import densest
from uavbench.world.cells import BUILDING, LOW_BUILDING, NO_FLY
from uavbench.world.files import FileError
from uavbench.world.maps import check_shape
from uavbench.world.provenance import Provenance
from uavbench.world.scenario import Scenario

_UNSTATED = "not stated: ask whoever made the file"
_METRES = {"cell": (0.1, 1000.0), "altitude": (0.1, 10_000.0), "default_height": (0.1, 1000.0)}  # the ranges of options


@dataclass(frozen=True)
class CityOptions:
    """How a city becomes a map.

    Attributes
    ----------
    cell : float
        Side of a cell in metres.
    altitude : float
        Flying altitude in metres. Higher buildings block flight and sight, the others only sight.
    shape : (int, int)
        Rows and columns of the map.
    centre : (float, float), optional
        Latitude and longitude of the map's centre, in degrees; by default the window with the most buildings is taken.
    default_height : float
        Height in metres of the buildings of which the file gives neither height nor levels.
    mission : {"cpp", "dh"}
        Coverage or data harvesting.
    no_fly : Path, optional
        A GeoJSON file, of which every polygon is a no-fly zone.
    landing : sequence of (int, int, int, int)
        First row and column, height and width of each landing zone, in cells; without any, two are chosen.
    scenario_id : str, optional
        The scenario's id; by default it follows from the name of the file that is written.
    licence : str, optional
        The licence of the data; by default the one that the file states, and OpenStreetMap's for its own formats.
    """

    cell: float = 10.0
    altitude: float = 25.0
    shape: tuple[int, int] = (50, 50)
    centre: tuple[float, float] | None = None
    default_height: float = 12.0
    mission: MissionName = "cpp"
    no_fly: Path | None = None
    landing: Sequence[Zone] = ()
    scenario_id: str | None = None
    licence: str | None = None

    @property
    def metres(self) -> tuple[float, float]:
        """Height and width of the map in metres."""
        return self.shape[0] * self.cell, self.shape[1] * self.cell


class ImportedCity(NamedTuple):
    """What `import_city` made.

    Attributes
    ----------
    scenario : Scenario
        As loaded from the file that was written.
    in_file : int
        How many buildings the source has.
    buildings : dict of str to int
        How many buildings lie on the map at least in part, by what their height comes from: ``height``, ``levels`` or
        ``default``.
    higher : int
        How many of them are higher than the altitude.
    skipped : int
        How many footprints of the source could not be used: they have missing points, or no area.
    share : float
        The part of the map's cells that are buildings, low ones included.
    no_fly : int
        How many cells are in no-fly zones of the data.
    closed : int
        How many cells were closed because no UAV could get there.
    landing : list of (int, int, int, int)
        First row and column, height and width of each landing zone.
    """

    scenario: Scenario
    in_file: int
    buildings: dict[Basis, int]
    higher: int
    skipped: int
    share: float
    no_fly: int
    closed: int
    landing: list[Zone]


def import_city(
    source: str | Path, out: str | Path, options: CityOptions | None = None, *, overwrite: bool = False
) -> ImportedCity:
    """Turn building footprints into a scenario, and write its TOML file and its map.

    Parameters
    ----------
    source : str or Path
        A file ``.osm``, ``.osm.pbf`` or ``.geojson``.
    out : str or Path
        The file to write, which ends in ``.toml``; the map is written beside it, with the ending ``.txt``.
    options : CityOptions, optional
        By default a map of 50 × 50 cells of 10 m, flown at 25 m.
    overwrite : bool
        Replace files that exist.

    Returns
    -------
    ImportedCity
        The scenario, and what it was made from.

    Raises
    ------
    GeodataError, FileError
        When a file or an option cannot be used; the message names it and the reason. Nothing is written then.

    Examples
    --------
    >>> from uavbench.geodata import CityOptions, import_city
    >>> made = import_city("helsinki.osm.pbf", "helsinki.toml", CityOptions(shape=(32, 32)))  # doctest: +SKIP
    """
    source, out, options = Path(source), Path(out), options or CityOptions()
    check_out(out, overwrite)
    _check(options)
    for name in ("shapely", "pyproj"):  # now, rather than after reading a large file
        library(name)
    extract, stated = _read(source, options)
    if not extract.count:
        raise GeodataError(f"{one_line(source)}: has no buildings: no area has the tag building")
    lat, lon = options.centre or densest(extract.buildings, *options.metres)
    centre = float(lat), float(lon)
    plane = Projection(centre)
    bounds = plane.bounds(*options.metres)
    city = _Flat(extract, plane, near(centre, *options.metres), options)
    if not city.buildings:
        raise GeodataError(_empty(source, extract, centre))
    open_map = rasterise(city.high, city.low, city.no_fly, city.grid)
    zones = list(options.landing) or choose_zones(open_map)
    cells, closed = close_unreachable(place_zones(open_map, zones))
    provenance = Provenance(
        source=source.name,
        sha256=_sha256(source),
        licence=options.licence or stated or _UNSTATED,
        centre=centre,
        bounds=bounds,
        projection=plane.text,
        cell_size=float(options.cell),
        altitude=float(options.altitude),
        default_height=float(options.default_height),
    )
    name = options.scenario_id or default_id(out, options.mission)
    scenario = write_city(out, city_toml(name, out, options.mission, options.shape, provenance), cells)
    return ImportedCity(
        scenario=scenario,
        in_file=extract.count,
        buildings=city.buildings,
        higher=len(city.high),
        skipped=extract.skipped,
        share=float(np.isin(cells, (BUILDING, LOW_BUILDING)).mean()),
        no_fly=int((open_map == NO_FLY).sum()),
        closed=closed,
        landing=zones,
    )


class _Flat:
    """The part of an extract that lies on a map, in metres.

    Attributes
    ----------
    grid : Grid
    high, low, no_fly : list of geometries
        The buildings that are higher than the altitude, the others, and the no-fly zones.
    buildings : dict of str to int
        How many buildings there are, by what their height comes from.
    """

    def __init__(self, extract: Extract, plane: Projection, around: Box, options: CityOptions) -> None:
        self.grid = Grid(*options.shape, options.cell)
        self._plane = plane
        self._around = library("shapely").box(*around)
        self._window = self.grid.box(0, 0, *options.shape)
        self.high: list[Geometry] = []
        self.low: list[Geometry] = []
        counts: Counter[Basis] = Counter()
        for building in extract.buildings:
            shape = self._flat(building.shape)
            if shape is not None:
                height = options.default_height if building.height is None else building.height
                (self.high if height > options.altitude else self.low).append(shape)
                counts[building.basis] += 1
        self.buildings: dict[Basis, int] = dict(counts)
        self.no_fly = [shape for shape in map(self._flat, extract.no_fly) if shape is not None]

    def _flat(self, shape: Geometry) -> Geometry | None:
        """Return the part of a polygon that lies on the map, in metres; None if none does."""
        part = polygonal(shape.intersection(self._around))  # before far points, which cannot be projected, are
        flat = None if part is None else polygonal(self._plane.to_metres(part))
        return None if flat is None else polygonal(flat.intersection(self._window))


def _check(options: CityOptions) -> None:
    """Refuse options that no map can have.

    Raises
    ------
    GeodataError
        The message names the option.
    """
    for name, (least, most) in _METRES.items():
        value = getattr(options, name)
        if not (math.isfinite(value) and least <= value <= most):
            raise GeodataError(f"{name.replace('_', '-')}: {value:g} m: expected {least:g} to {most:g} m")
    try:
        check_shape(options.shape)
    except ValueError as error:
        raise GeodataError(f"shape: {error}") from None
    if options.centre:
        check_centre(options.centre)


def _read(source: Path, options: CityOptions) -> tuple[Extract, str | None]:
    """Return what a file holds, with the no-fly zones of another file, and the licence of the data if it is known."""
    extract = Extract(near(options.centre, *options.metres) if options.centre else None)
    name = source.name.lower()
    stated: str | None = OSM_LICENCE
    if name.endswith(".pbf"):
        read_osm(source, "pbf", extract)
    elif name.endswith(".osm"):
        read_osm(source, "osm", extract)
    elif name.endswith((".geojson", ".json")):
        stated = read_geojson(source, extract)
    else:
        raise GeodataError(f"{one_line(source)}: is neither .osm, .osm.pbf nor .geojson: the name must end in one of them")
    if options.no_fly:
        read_geojson(options.no_fly, extract, every="no-fly")
    return extract, stated


def _empty(source: Path, extract: Extract, centre: tuple[float, float]) -> str:
    """Return the message that no building is on the map."""
    west, south, east, north = extract.extent or (0.0, 0.0, 0.0, 0.0)
    return (
        f"{one_line(source)}: no building is on the map around {centre[0]:.5f}, {centre[1]:.5f}: the file's "
        f"{extract.count:,} are at latitudes {south:.4f} to {north:.4f} and longitudes {west:.4f} to {east:.4f}"
    )


def _sha256(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise FileError(f"{one_line(path)}: cannot be read: {error.strerror}") from None
