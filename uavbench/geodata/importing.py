"""Importing a city: from a file of footprints to a scenario that is ready to fly."""

import hashlib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.errors import one_line
from uavbench.geodata.city_file import check_out, city_toml, write_city
from uavbench.geodata.footprints import Box, Extract, polygonal
from uavbench.geodata.geojson_file import read_geojson
from uavbench.geodata.heights import Basis
from uavbench.geodata.landing import Zone, choose_zones, close_unreachable, place_zones
from uavbench.geodata.libraries import GeodataError, Geometry, library
from uavbench.geodata.names import MissionName, name_city
from uavbench.geodata.osm_file import OSM_LICENCE, read_osm
from uavbench.geodata.projection import Projection, check_centre, near
from uavbench.geodata.rasterise import Grid
from uavbench.geodata.rasterise import cells as rasterise
from uavbench.geodata.reasons import no_building_cell, no_buildings, no_room, no_zones, none_on_map, useless_zones
from uavbench.geodata.window import densest
from uavbench.world.cells import BUILDING, LOW_BUILDING, NO_FLY
from uavbench.world.files import FileError
from uavbench.world.maps import check_shape
from uavbench.world.provenance import Provenance
from uavbench.world.scenario import Scenario

_LONGEST_LICENCE = 300  # characters
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
        Flying altitude in metres. Higher buildings block flight and sight, the others only sight. In data harvesting it is also
        the height of UAVs above the devices, and so sets the distances of radio links.
    shape : (int, int)
        Rows and columns of the map.
    centre : (float, float), optional
        Latitude and longitude of the map's centre, in degrees; by default the window with the most buildings is taken.
    default_height : float
        Height in metres of the buildings of which the file gives neither height nor levels.
    mission : {"cpp", "dh"}, optional
        Coverage or data harvesting; by default the mission that the id names, and coverage if it names none.
    no_fly : Path, optional
        A GeoJSON file, of which every polygon is a no-fly zone.
    landing : sequence of (int, int, int, int)
        First row and column, height and width of each landing zone, in cells; without any, two are chosen.
    scenario_id : str, optional
        The scenario's id; by default it follows from the name of the file that is written, and from the mission.
    licence : str, optional
        The licence of the data; by default the one that the file states, and OpenStreetMap's for its own formats.
    """

    cell: float = 10.0
    altitude: float = 25.0
    shape: tuple[int, int] = (50, 50)
    centre: tuple[float, float] | None = None
    default_height: float = 12.0
    mission: MissionName | None = None
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
        How many outlines of buildings and no-fly zones could not be used: they lack points, have no area or cross 180° of
        longitude.
    share : float
        The part of the map's cells that are buildings, low ones included.
    no_fly : int
        How many cells are in no-fly zones of the data.
    closed : int
        How many cells were closed because no UAV could get there.
    landing : list of (int, int, int, int)
        First row and column, height and width of each landing zone.
    warnings : list of str
        What is probably not as it was meant, and what to change.
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
    warnings: list[str]


def import_city(
    source: str | Path, out: str | Path, options: CityOptions | None = None, *, overwrite: bool = False
) -> ImportedCity:
    """Turn the outlines of buildings on the ground into a scenario, and write its TOML file and its map.

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
    name, mission = name_city(out, options.scenario_id, options.mission)
    for needed in ("shapely", "pyproj"):  # now, rather than after reading a large file
        library(needed)
    extract, stated = _read(source, options)
    given = _read_zones(options)
    lat, lon = options.centre or densest(extract.buildings, *options.metres)
    centre = float(lat), float(lon)
    plane = Projection(centre)
    bounds = plane.bounds(*options.metres)
    city = _Flat(extract, given, plane, near(centre, *options.metres), options)
    if not city.buildings:
        raise GeodataError(f"{one_line(source)}: {none_on_map(extract, centre)}")
    open_map = rasterise(city.high, city.low, city.no_fly, city.grid)
    zones = list(options.landing) or choose_zones(open_map)
    if not zones:
        covering = [*city.high, *city.low, *city.no_fly]
        raise GeodataError(no_room(open_map, covering, city.grid, options.no_fly is not None))
    cells, closed = close_unreachable(place_zones(open_map, zones))
    provenance = Provenance(
        source=one_line(source.name),  # a file of the user may have any name
        sha256=_sha256(source),
        licence=(options.licence or stated or _UNSTATED).strip(),
        centre=centre,
        bounds=bounds,
        projection=plane.text,
        cell_size=float(options.cell),
        altitude=float(options.altitude),
        default_height=float(options.default_height),
    )
    scenario = write_city(out, city_toml(name, out, mission, cells, provenance), cells)
    return ImportedCity(
        scenario=scenario,
        in_file=extract.count,
        buildings=city.buildings,
        higher=len(city.high),
        skipped=extract.skipped + given.skipped,
        share=float(np.isin(cells, (BUILDING, LOW_BUILDING)).mean()),
        no_fly=int((open_map == NO_FLY).sum()),
        closed=closed,
        landing=zones,
        warnings=_warnings(cells, city, given, options),
    )


class _Flat:
    """The part of an extract that lies on a map, in metres.

    Attributes
    ----------
    grid : Grid
    high, low, no_fly : list of geometries
        The buildings that are higher than the altitude, the others, and all no-fly zones.
    given : list of geometries
        The no-fly zones that the user gave.
    buildings : dict of str to int
        How many buildings there are, by what their height comes from.
    """

    def __init__(self, extract: Extract, given: Extract, plane: Projection, around: Box, options: CityOptions) -> None:
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
        self.given = [shape for shape in map(self._flat, given.no_fly) if shape is not None]
        self.no_fly = [shape for shape in map(self._flat, extract.no_fly) if shape is not None] + self.given

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
    if options.licence is not None:
        _check_licence(options.licence.strip())


def _check_licence(text: str) -> None:
    """Refuse a text that is not one line that names a licence: it is printed, and stands in the scenario for ever."""
    if not any(letter.isalnum() for letter in text):
        raise GeodataError(f"licence: {one_line(text, repr)} names no licence: write its name, or leave out --licence")
    if not text.isprintable():
        raise GeodataError(f"licence: {one_line(text, repr)} has a line break or a control character: write one line of text")
    if len(text) > _LONGEST_LICENCE:
        raise GeodataError(f"licence: has {len(text):,} characters: at most {_LONGEST_LICENCE} are allowed")


def _read(source: Path, options: CityOptions) -> tuple[Extract, str | None]:
    """Return what a file holds, and the licence of the data if it is known.

    Raises
    ------
    FileError, GeodataError
        When the file cannot be used, or has no buildings; the message names it and the reason.
    """
    extract = Extract(_sought(options))
    name, areas = source.name.lower(), "closed lines or multipolygons with the tag building"
    stated: str | None = OSM_LICENCE
    if name.endswith(".pbf"):
        read_osm(source, "pbf", extract)
    elif name.endswith(".osm"):
        read_osm(source, "osm", extract)
    elif name.endswith((".geojson", ".json")):
        stated, areas = read_geojson(source, extract), "polygons"
    else:
        raise GeodataError(f"{one_line(source)}: is neither .osm, .osm.pbf nor .geojson: the name must end in one of them")
    if not extract.count:
        raise GeodataError(f"{one_line(source)}: {no_buildings(extract, areas)}")
    return extract, stated


def _read_zones(options: CityOptions) -> Extract:
    """Return what the file of no-fly zones holds, if there is one.

    Raises
    ------
    FileError, GeodataError
        When the file cannot be used, or has no zones; the message names it and the reason.
    """
    given = Extract(_sought(options))
    if options.no_fly is not None:
        read_geojson(options.no_fly, given, every="no-fly")
        if not given.zones:
            raise GeodataError(f"--no-fly {one_line(options.no_fly)}: {no_zones(given)}")
    return given


def _sought(options: CityOptions) -> Box | None:
    """Return the box outside of which nothing needs to be kept; None if the map may lie anywhere."""
    return near(options.centre, *options.metres) if options.centre else None


def _warnings(cells: NDArray[np.uint8], city: _Flat, given: Extract, options: CityOptions) -> list[str]:
    """Return what is probably not as the user meant it."""
    found = [no_building_cell(cells, sum(city.buildings.values()), city.grid)]
    if options.no_fly is not None:
        found.append(useless_zones(one_line(options.no_fly), given.zones, city.given, city.grid))
    return [text for text in found if text is not None]


def _sha256(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise FileError(f"{one_line(path)}: cannot be read: {error.strerror}") from None
