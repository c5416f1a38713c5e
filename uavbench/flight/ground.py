"""Where a cell of a map is on earth: latitude, longitude and metres."""

import math
from collections.abc import Sequence

import numpy as np

from uavbench.errors import one_line
from uavbench.flight.frame import cells_of, metres_of
from uavbench.flight.route import FlightError
from uavbench.geodata.libraries import GeodataError
from uavbench.geodata.projection import Projection
from uavbench.world.scenario import Scenario

#: Side of a cell in metres, where a scenario does not give it (the paper's).
CELL = 10.0
_ALTITUDE = 10.0


class Ground:
    """The ground of a scenario's map.

    Parameters
    ----------
    scenario : Scenario
    origin : (float, float), optional
        Latitude and longitude of the middle of the map, in degrees (WGS 84). A scenario of a real place has its own.

    Attributes
    ----------
    cell : float
        Side of a cell in metres.
    projection : Projection
        From degrees to metres around the middle of the map.

    Raises
    ------
    FlightError
        When the map has no place on earth and none is given, it has one and another is given, or it is no place.
    """

    def __init__(self, scenario: Scenario, origin: tuple[float, float] | None = None) -> None:
        provenance = scenario.provenance
        if provenance is None and origin is None:
            raise FlightError(f"{scenario.id} is no real place: say where its map is, --origin LAT,LON of its middle")
        if provenance is not None and origin is not None:
            raise FlightError(
                f"--origin: {scenario.id} is a real place, at {provenance.centre[0]},{provenance.centre[1]}: leave it out"
            )
        self.cell = cell_size(scenario)
        self._shape = scenario.shape
        try:
            self.projection = Projection(provenance.centre if provenance else origin or (0.0, 0.0))
        except GeodataError as error:
            raise FlightError(f"--origin: {error}") from None

    def degrees(self, row: float, col: float) -> tuple[float, float]:
        """Return latitude and longitude of a point of the map, in degrees with seven digits (about a centimetre)."""
        ((east, north),) = metres_of(np.array([[row, col]]), self._shape, self.cell).tolist()
        return self.projection.to_degrees(east, north)

    def cell_at(self, lat: float, lon: float) -> tuple[int, int]:
        """Return row and column of the cell in which a place is; they may be off the map."""
        ((row, col),) = cells_of(np.array([self.projection.from_degrees(lat, lon)]), self._shape, self.cell).tolist()
        return math.floor(row + 0.5), math.floor(col + 0.5)

    def bounds_text(self) -> str:
        """Return where the map is, for messages."""
        rows, cols = self._shape
        corners = self.ring([(0, 0), (0, cols), (rows, cols), (rows, 0)])
        lats, lons = zip(*corners, strict=True)
        return f"which is from {min(lats):.5f},{min(lons):.5f} to {max(lats):.5f},{max(lons):.5f}"

    def ring(self, corners: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        """Return latitudes and longitudes of the corners of cells; the corner (0, 0) is the north-west one of the map."""
        return [self.degrees(row - 0.5, col - 0.5) for row, col in corners]


def cell_size(scenario: Scenario) -> float:
    """Return the side of a cell in metres."""
    if scenario.provenance is not None:
        return scenario.provenance.cell_size
    return float(getattr(scenario.mission, "cell_size", CELL))


def altitude_of(scenario: Scenario) -> float:
    """Return the flying altitude of a scenario in metres; 10 where it does not give one (the paper's)."""
    if scenario.provenance is not None:
        return scenario.provenance.altitude
    return float(getattr(scenario.mission, "altitude", _ALTITUDE))


def read_origin(text: str, option: str = "--origin") -> tuple[float, float]:
    """Return latitude and longitude from the text ``LAT,LON`` of an option.

    Raises
    ------
    FlightError
        When the text is no two numbers.
    """
    parts = text.split(",")
    try:
        lat, lon = (float(part) for part in parts)
    except ValueError:
        raise FlightError(f"{option} {one_line(text)}: write latitude and longitude in degrees, as in 60.17,24.94") from None
    return lat, lon
