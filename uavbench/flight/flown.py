"""Flights of recorded episodes with physics: whether a real quadrotor survives the path, and what it covers or collects."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavbench.flight.energy import power
from uavbench.flight.frame import cells_of, metres_of
from uavbench.flight.ground import altitude_of, cell_size
from uavbench.flight.quadrotor import Box, Trace, fly_track
from uavbench.flight.route import Flight, FlightError, Route
from uavbench.flight.track import Track, track_along
from uavbench.flight.wind import wind_of
from uavbench.simulation.along import collected_along
from uavbench.world.city import City
from uavbench.world.episode import episode_keys

_HIGH, _LOW = 2.0, 0.5  # heights of buildings and of low buildings, in flying altitudes: maps do not tell
_LIMITS = {
    "speed": (0.2, 20.0, "m/s"),
    "wind": (0.0, 20.0, "m/s"),
    "acceleration": (0.2, 5.0, "m/s²"),
    "tolerance": (0.05, 5.0, "m"),
}


@dataclass(frozen=True)
class Conditions:
    """How a recorded episode is flown.

    Attributes
    ----------
    speed : float
        In m/s.
    wind : float
        The mean wind in m/s; 0 for none, also without gusts.
    acceleration : float
        The largest one that the track asks for, in m/s².
    tolerance : float
        How far from a corner the track may pass, in metres.
    """

    speed: float = 3.0
    wind: float = 0.0
    acceleration: float = 2.0
    tolerance: float = 1.0


@dataclass(frozen=True)
class UavFlown:
    """What one quadrotor did.

    Attributes
    ----------
    trace : Trace
    track : Track
    seconds : float
        From take-off to landing.
    energy : float
        In Wh, by `power`.
    off_track : float
        The largest distance from the path on the grid, in metres; corners that are cut count.
    clearance : float
        The least distance to a building that is not low, in metres; infinite if there is none.
    zone : bool
        Whether it entered a no-fly zone, buildings not counted.
    hit : bool
        Whether it hit a building or the ground on its way.
    """

    trace: Trace
    track: Track
    seconds: float
    energy: float
    off_track: float
    clearance: float
    zone: bool
    hit: bool

    @property
    def safe(self) -> bool:
        """Whether it neither hit anything nor entered a no-fly zone."""
        return not (self.hit or self.zone)


@dataclass(frozen=True)
class Flown:
    """A recorded episode, flown with physics.

    Attributes
    ----------
    flight : Flight
        The recorded episode.
    conditions : Conditions
    uavs : tuple of UavFlown
    cr : float
        CR as flown, in [0, 1]: the camera and the radio along the true way, by the rules of the mission.
    """

    flight: Flight
    conditions: Conditions
    uavs: tuple[UavFlown, ...]
    cr: float

    @property
    def safe(self) -> bool:
        """Whether no UAV hit anything or entered a no-fly zone."""
        return all(uav.safe for uav in self.uavs)


def fly(flight: Flight, conditions: Conditions | None = None, on_uav: Callable[[object], None] = lambda uav: None) -> Flown:
    """Fly a recorded episode with physics; each UAV of a team flies alone.

    Parameters
    ----------
    flight : Flight
    conditions : Conditions, optional
    on_uav : callable
        Called when a UAV has flown.

    Raises
    ------
    FlightError
        When a condition is out of range, or a library is missing.
    """
    conditions = conditions or Conditions()
    for name, (least, most, unit) in _LIMITS.items():
        value = getattr(conditions, name)
        if not (math.isfinite(value) and least <= value <= most):
            raise FlightError(f"--{name} {value:g}: it must be from {least:g} to {most:g} {unit}")
    cell, altitude = cell_size(flight.scenario), altitude_of(flight.scenario)
    key = int(episode_keys(flight.split, np.array([flight.episode]))[0])
    boxes = boxes_of(flight.city, cell, altitude)
    uavs: list[UavFlown] = []
    for number, route in enumerate(flight.routes):
        track = track_of(route, flight.city, cell, conditions)
        length = float(track.seconds[-1]) + 4 * altitude + 60.0
        wind = wind_of(key + number, conditions.wind, altitude, conditions.speed, length) if conditions.wind else None
        trace = fly_track(track, altitude, boxes, wind, key + number)
        uavs.append(_judged(trace, track, route, flight.city, cell))
        on_uav(uavs[-1])
    period = cell / conditions.speed / _samples_in_a_step(flight)
    ways = [_places(uav.trace, flight.city, cell, period) for uav in uavs]
    return Flown(flight, conditions, tuple(uavs), collected_along(flight.scenario, flight.split, flight.episode, ways))


def track_of(route: Route, city: City, cell: float, conditions: Conditions) -> Track:
    """Return the track along a route."""
    stops = metres_of(np.array([stop.cell for stop in route.stops], dtype=np.float64), city.shape, cell)
    waits = np.array([stop.wait for stop in route.stops]) * cell / conditions.speed
    return track_along(
        stops, waits, speed=conditions.speed, acceleration=conditions.acceleration, tolerance=conditions.tolerance
    )


def boxes_of(city: City, cell: float, altitude: float) -> list[Box]:
    """Return the buildings as boxes: rows of cells that are buildings side by side, and equal rows below each other, are one.

    Maps do not tell heights. Buildings are twice as high as the flying altitude, and low buildings half as high.
    """
    high, low = np.asarray(city.building & city.no_fly), np.asarray(city.building & ~city.no_fly)
    boxes: list[Box] = []
    for cells, height in ((high, _HIGH * altitude), (low, _LOW * altitude)):
        for top, left, bottom, right in _rectangles(cells):
            (west, north), (east, south) = metres_of(
                np.array([[top - 0.5, left - 0.5], [bottom + 0.5, right + 0.5]]), city.shape, cell
            )
            boxes.append((float(west), float(south), float(east), float(north), height))
    return boxes


def _rectangles(cells: NDArray[np.bool_]) -> list[tuple[int, int, int, int]]:
    """Return rectangles, first row, first column, last row and last column, that together are the cells that are True."""
    growing: dict[tuple[int, int], int] = {}  # the first and last column of rectangles that may still grow → their first row
    found: list[tuple[int, int, int, int]] = []
    for row, line in enumerate([*cells, np.zeros(cells.shape[1], dtype=np.bool_)]):
        edges: list[int] = np.flatnonzero(np.diff(np.pad(line.astype(np.int8), 1))).tolist()
        now = {(left, right - 1) for left, right in zip(edges[::2], edges[1::2], strict=True)}
        ended = [each for each in growing if each not in now]
        found += [(growing.pop((left, right)), left, row - 1, right) for left, right in ended]
        for columns in now:
            growing.setdefault(columns, row)
    return sorted(found)


def _samples_in_a_step(flight: Flight) -> int:
    """Return how often a UAV covers or collects in the time of a move: in DH once for each communication step."""
    return int(getattr(flight.scenario.mission, "communication_steps", 10))


def _places(trace: Trace, city: City, cell: float, period: float) -> NDArray[np.float64]:
    """Return the rows and columns of a trace on its track, one for each period."""
    first, last = trace.on_track
    seconds, places = trace.seconds[first:last], trace.places[first:last, :2]
    if len(seconds) == 0:
        return np.zeros((0, 2))
    even = np.arange(seconds[0] + period, seconds[-1] + 1e-9, period)
    return cells_of(np.column_stack([np.interp(even, seconds, places[:, axis]) for axis in range(2)]), city.shape, cell)


def _judged(trace: Trace, track: Track, route: Route, city: City, cell: float) -> UavFlown:
    """Return what is to be said of a trace."""
    stops = metres_of(np.array([stop.cell for stop in route.stops], dtype=np.float64), city.shape, cell)
    places = trace.places[:, :2]
    first, last = trace.on_track
    rows, cols = city.shape
    here = np.clip(np.rint(cells_of(places, city.shape, cell)).astype(int), 0, [rows - 1, cols - 1])
    zone = np.asarray(city.no_fly & ~city.building)[here[:, 0], here[:, 1]]
    times = np.diff(trace.seconds, prepend=trace.seconds[0])
    return UavFlown(
        trace=trace,
        track=track,
        seconds=float(trace.seconds[-1]),
        energy=float((power(trace.airspeeds) * times).sum()) / 3600.0,
        off_track=float(_distances(places[first:last], stops).max(initial=0.0)),
        clearance=_clearance(places, city, cell),
        zone=bool(zone.any()),
        hit=trace.hit,
    )


def _distances(places: NDArray[np.float64], stops: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance of each place to the way along stops."""
    least = np.linalg.norm(places - stops[0], axis=1)
    for one, other in itertools.pairwise(stops):
        way = other - one
        part = np.clip((places - one) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
        least = np.minimum(least, np.linalg.norm(places - one - part[:, None] * way, axis=1))
    return least


def _clearance(places: NDArray[np.float64], city: City, cell: float) -> float:
    """Return the least distance of places to a building that is not low."""
    boxes: Sequence[Box] = [box for box in boxes_of(city, cell, 1.0) if box[4] > 1.0]
    least = math.inf
    for west, south, east, north, _ in boxes:
        across = np.maximum(np.maximum(west - places[:, 0], places[:, 0] - east), 0.0)
        along = np.maximum(np.maximum(south - places[:, 1], places[:, 1] - north), 0.0)
        least = min(least, float(np.hypot(across, along).min()))
    return least
