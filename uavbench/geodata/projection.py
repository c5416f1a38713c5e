"""From degrees to metres around the centre of a map: a transverse Mercator projection, which is true near its centre."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.geodata.footprints import Box
from uavbench.geodata.libraries import GeodataError, Geometry, library

DEGREE = 111_320.0  # metres of a degree of latitude, nearly
_FARTHEST = 84.0  # degrees of latitude: nearer to a pole, meridians of neighbouring cells are no longer nearly parallel


class Projection:
    """The plane that touches the earth at the centre of a map, in metres: x goes east, y goes north.

    Parameters
    ----------
    centre : (float, float)
        Latitude and longitude in degrees.

    Attributes
    ----------
    text : str
        The projection as a PROJ string.

    Raises
    ------
    GeodataError
        When the centre is no place on earth, or too near to a pole.
    """

    def __init__(self, centre: tuple[float, float]) -> None:
        check_centre(centre)
        lat, lon = map(float, centre)
        self.text = f"+proj=tmerc +lat_0={lat!r} +lon_0={lon!r} +k=1 +x_0=0 +y_0=0 +ellps=WGS84 +units=m +no_defs"
        self._transform: Any = library("pyproj").Proj(self.text)

    def to_metres(self, shape: Geometry) -> Geometry:
        """Return a geometry in metres."""
        return library("shapely").transform(shape, self._points)

    def _points(self, degrees: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack(self._transform(degrees[:, 0], degrees[:, 1]))

    def to_degrees(self, x: float, y: float) -> tuple[float, float]:
        """Return latitude and longitude of a point that is ``x`` metres east and ``y`` metres north of the centre.

        They have seven digits after the point, which is about a centimetre.
        """
        lon, lat = self._transform(x, y, inverse=True)
        return round(float(lat), 7), round(float(lon), 7)

    def from_degrees(self, lat: float, lon: float) -> tuple[float, float]:
        """Return how many metres a place is east and north of the centre."""
        x, y = self._transform(lon, lat)
        return float(x), float(y)

    def bounds(self, height: float, width: float) -> tuple[float, float, float, float]:
        """Return south, west, north and east, in degrees, of a map of ``height`` × ``width`` metres around the centre.

        Raises
        ------
        GeodataError
            When the map crosses the antimeridian.
        """
        along = np.linspace(-0.5, 0.5, 21)
        side = np.full_like(along, 0.5)
        x = np.concatenate([along, along, side, -side]) * width
        y = np.concatenate([side, -side, along, along]) * height
        lon, lat = self._transform(x, y, inverse=True)
        south, west, north, east = (round(float(each), 7) for each in (lat.min(), lon.min(), lat.max(), lon.max()))
        if east - west > 180:
            raise GeodataError("the map crosses the antimeridian (180° of longitude), which is not supported: move --centre")
        return south, west, north, east


def check_centre(centre: tuple[float, float]) -> None:
    """Refuse a centre that is no place on earth, or too near to a pole.

    Raises
    ------
    GeodataError
        The message says why.
    """
    lat, lon = centre
    if not (abs(lat) <= 90 and abs(lon) <= 180):
        raise GeodataError(f"centre: {lat:g}, {lon:g} is no place: latitude is −90 to 90, and longitude −180 to 180")
    if abs(lat) > _FARTHEST:
        raise GeodataError(f"centre: latitude {lat:g} is too near to a pole: at most {_FARTHEST:g} is supported")


def near(centre: tuple[float, float], height: float, width: float) -> Box:
    """Return a box in degrees that surely contains a map of ``height`` × ``width`` metres around ``centre``."""
    check_centre(centre)
    lat, lon = centre
    down, right = height / DEGREE, width / (DEGREE * math.cos(math.radians(lat)))
    return lon - right, lat - down, lon + right, lat + down
