"""The track of a quadrotor along a route: corners are cut by arcs within a tolerance, and the speed allows for them.

At a turn, the track leaves the straight way, follows a circular arc and meets the next straight way. The arc's radius r keeps
it within the tolerance e of the corner: r (1 / cos(φ/2) − 1) ≤ e for a turn by φ. The speed v on it keeps the acceleration
across the track, v² / r, below a limit. Along the track, the speed changes within the same limit, so that the quadrotor slows
down in time. At reversals, where it waits, and at the end, the speed is 0. At last the places are smoothed over time, so that
the acceleration has no jumps, which no quadrotor can follow.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_APART = 0.05  # metres between two points at which the speed is planned
_PERIOD = 0.05  # seconds between two points of the track
_SMOOTHED = 0.8  # seconds over which places are averaged
_SLOWEST = 0.05  # m/s with which the track is flown where the planned speed is 0, so that it goes on


@dataclass(frozen=True)
class Track:
    """Where a quadrotor should be.

    Attributes
    ----------
    seconds : ndarray, shape (T,)
        Times from 0, evenly spaced.
    places : ndarray, shape (T, 2)
        Metres east and north of the middle of the map.
    velocities, accelerations : ndarray, shape (T, 2)
        In m/s and m/s².
    """

    seconds: NDArray[np.float64]
    places: NDArray[np.float64]
    velocities: NDArray[np.float64]
    accelerations: NDArray[np.float64]

    def at(self, seconds: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return place, velocity and acceleration at a time; before the beginning and after the end, at rest."""
        k = seconds / _PERIOD
        low = math.floor(k)
        if low < 0 or low >= len(self.seconds) - 1:
            return self.places[0 if low < 0 else -1], np.zeros(2), np.zeros(2)
        part, found = k - low, (self.places, self.velocities, self.accelerations)
        place, velocity, acceleration = ((1 - part) * each[low] + part * each[low + 1] for each in found)
        return place, velocity, acceleration


def track_along(
    stops: NDArray[np.float64], waits: NDArray[np.float64], *, speed: float, acceleration: float, tolerance: float
) -> Track:
    """Return the track along straight ways between stops.

    Parameters
    ----------
    stops : ndarray, shape (S, 2)
        Metres east and north; neighbours are apart.
    waits : ndarray, shape (S,)
        Seconds at each stop.
    speed, acceleration : float
        Limits, in m/s and m/s².
    tolerance : float
        How far from a corner the track may pass, in metres.
    """
    seconds, places, clock = [np.zeros(1)], [stops[:1]], 0.0
    breaks = [k for k in range(len(stops)) if waits[k] > 0 or k in (0, len(stops) - 1) or _reverses(stops[k - 1 : k + 2])]
    for k, first in enumerate(breaks):
        if waits[first] > 0:
            clock += float(waits[first])
            seconds.append(np.array([clock]))
            places.append(stops[first : first + 1])
        if k + 1 < len(breaks):
            when, where = _flown(stops[first : breaks[k + 1] + 1], speed, acceleration, tolerance)
            seconds.append(clock + when[1:])
            places.append(where[1:])
            clock += float(when[-1])
    known, there = np.concatenate(seconds), np.concatenate(places)
    even = np.arange(0.0, clock + _SMOOTHED + 2 * _PERIOD, _PERIOD)
    found = _smoothed(np.column_stack([np.interp(even - _SMOOTHED / 2, known, there[:, axis]) for axis in range(2)]))
    velocities = np.gradient(found, _PERIOD, axis=0)
    return Track(even, found, velocities, np.gradient(velocities, _PERIOD, axis=0))


def _smoothed(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return places that are averaged over time, with less weight for what is farther away."""
    half = round(_SMOOTHED / _PERIOD / 2)
    weights = np.hanning(2 * half + 3)[1:-1]
    padded = np.pad(places, ((half, half), (0, 0)), mode="edge")
    weights /= weights.sum()
    found = np.empty_like(places)
    for axis in range(places.shape[1]):
        found[:, axis] = np.convolve(padded[:, axis], weights, mode="valid")
    return found


def _reverses(three: NDArray[np.float64]) -> bool:
    """Say whether the way turns back at the middle one of three stops."""
    before, after = np.diff(three, axis=0)
    return bool(np.dot(before, after) < -0.99 * np.linalg.norm(before) * np.linalg.norm(after))


def _flown(
    stops: NDArray[np.float64], speed: float, acceleration: float, tolerance: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times and places of a flight from rest to rest, which rounds the corners."""
    points, fastest = _rounded(stops, float(speed), acceleration, tolerance)
    far: NDArray[np.float64] = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    even: NDArray[np.float64] = np.linspace(0.0, float(far[-1]), max(2, math.ceil(far[-1] / _APART) + 1))
    places = np.column_stack([np.interp(even, far, points[:, axis]) for axis in range(2)])
    pieces = np.clip(np.searchsorted(far, even) - 1, 0, len(fastest) - 1)  # of the way, on which the points are
    limit = fastest[pieces]
    limit[0] = limit[-1] = 0.0
    squares, step = limit**2, 2 * acceleration * np.diff(even)
    for k in range(1, len(squares)):
        squares[k] = min(squares[k], squares[k - 1] + step[k - 1])
    for k in range(len(squares) - 2, -1, -1):
        squares[k] = min(squares[k], squares[k + 1] + step[k])
    speeds = np.sqrt(squares)
    means = np.maximum((speeds[1:] + speeds[:-1]) / 2, _SLOWEST)
    return np.concatenate([[0.0], np.cumsum(np.diff(even) / means)]), places


def _rounded(
    stops: NDArray[np.float64], speed: float, acceleration: float, tolerance: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points of the way with arcs at its corners, shape (P, 2), and the largest speed on each piece, shape (P − 1,)."""
    points: list[NDArray[np.float64]] = [stops[0]]
    fastest: list[float] = []
    legs = np.diff(stops, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    for k in range(1, len(stops) - 1):
        before, after = legs[k - 1] / lengths[k - 1], legs[k] / lengths[k]
        turn = math.acos(float(np.clip(np.dot(before, after), -1.0, 1.0)))
        if turn < 1e-6:
            continue
        half = turn / 2
        radius = tolerance / (1 / math.cos(half) - 1)
        cut = min(radius * math.tan(half), min(lengths[k - 1], lengths[k]) / 2)  # so much of each leg is replaced by the arc
        radius = cut / math.tan(half)
        allowed = min(speed, math.sqrt(acceleration * radius))
        side = np.sign(before[0] * after[1] - before[1] * after[0])
        across = np.array([-before[1], before[0]]) * side
        centre = stops[k] - before * cut + across * radius
        angles = np.linspace(0.0, turn, max(3, math.ceil(radius * turn / (4 * _APART)) + 1))
        arc = centre + radius * (np.outer(np.sin(angles), before) - np.outer(np.cos(angles), across))
        points += list(arc)
        fastest += [speed, *[allowed] * (len(arc) - 1)]
    return np.array([*points, stops[-1]]), np.array([*fastest, speed])
