"""Targets of a person's own: an area as GeoJSON, or devices as CSV, as the mission's option of ``reset`` has them."""

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.errors import one_line
from uavbench.flight.ground import Ground
from uavbench.flight.route import FlightError
from uavbench.geodata.footprints import Extract
from uavbench.geodata.geojson_file import read_geojson
from uavbench.geodata.libraries import GeodataError
from uavbench.geodata.rasterise import HALF, Grid, coverage
from uavbench.world.city import City
from uavbench.world.files import TABLE_BYTES, FileError, read_text

_COLUMNS = ("lat", "lon", "data")


def read_area(path: Path, ground: Ground, city: City) -> NDArray[np.bool_]:
    """Return the cells of which the polygons of a GeoJSON file cover at least half, without buildings, shape (M, N).

    Raises
    ------
    FlightError
        When the file cannot be read, holds no polygon, or covers no cell of the map.
    """
    extract = Extract()
    try:
        read_geojson(path, extract, "no-fly")  # so every polygon is read as one
    except (GeodataError, FileError) as error:
        raise FlightError(f"--targets {error}") from None
    if not extract.no_fly:
        raise FlightError(f"--targets {one_line(path)}: it holds no polygon")
    rows, cols = city.shape
    shapes = [ground.projection.to_metres(shape) for shape in extract.no_fly]
    covered = coverage(shapes, Grid(rows, cols, ground.cell)) >= HALF
    if not covered.any():
        raise FlightError(f"--targets {one_line(path)}: its polygons cover no cell of the map, {ground.bounds_text()}")
    cells = covered & ~np.asarray(city.building)
    if not cells.any():
        raise FlightError(f"--targets {one_line(path)}: on the map, its polygons cover buildings only")
    return cells


def read_devices(path: Path, ground: Ground, city: City) -> list[list[float]]:
    """Return the devices of a CSV file with the columns lat, lon and data, as rows [row, column, data].

    Devices in one cell become one, with their data together.

    Raises
    ------
    FlightError
        When the file cannot be read, or a device has no place on the map.
    """
    name = f"--targets {one_line(path)}"
    try:
        lines = list(csv.DictReader(read_text(path, TABLE_BYTES).splitlines(), strict=True))
    except (FileError, csv.Error) as error:
        raise FlightError(f"--targets {one_line(error)}") from None
    if not lines or not set(_COLUMNS) <= lines[0].keys():
        raise FlightError(f"{name}: it must begin with the line lat,lon,data, and hold a device in each further line")
    together: dict[tuple[int, int], float] = {}
    for number, line in enumerate(lines, 2):
        where = f"{name}: line {number}"
        row, col, data = _device(line, where, ground)
        if not (0 <= row < city.shape[0] and 0 <= col < city.shape[1]):
            raise FlightError(f"{where}: the device is not on the map, {ground.bounds_text()}")
        for layer in ("building", "landing"):
            if getattr(city, layer)[row, col]:
                raise FlightError(f"{where}: the device is in a {layer} cell, ({row}, {col}), where none may be")
        together[row, col] = together.get((row, col), 0.0) + data
    return [[row, col, data] for (row, col), data in together.items()]


def _device(line: dict[str | Any, str | Any], where: str, ground: Ground) -> tuple[int, int, float]:
    """Return row, column and data of a line."""
    try:
        lat, lon, data = (float(line[name] or "") for name in _COLUMNS)
    except (ValueError, TypeError):
        raise FlightError(f"{where}: lat, lon and data must be numbers") from None
    if not (abs(lat) <= 90 and abs(lon) <= 180):
        raise FlightError(f"{where}: {lat:g}, {lon:g} is no place: latitude is −90 to 90, and longitude −180 to 180")
    if not (math.isfinite(data) and data > 0):
        raise FlightError(f"{where}: data: {data:g} is not above 0")
    row, col = ground.cell_at(lat, lon)
    return row, col, data
