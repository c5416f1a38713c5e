"""Wind with gusts: the Dryden model of turbulence near the ground, in its simplest form.

The mean wind is constant, from a direction that belongs to the flight's key. Gusts along and across it are first-order
processes with the intensities and the lengths of MIL-F-8785C for low altitudes h, which that standard gives in feet:
σ_w = 0.1 W, σ_u = σ_w / (0.177 + 0.000823 h)^0.4 and L_u = h / (0.177 + 0.000823 h)^1.2, where W is the wind at 20 feet. The
vertical wind is 0.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_FOOT = 0.3048
_PERIOD = 0.1  # seconds between two values of the gusts, between which they change evenly


@dataclass(frozen=True)
class Wind:
    """The wind that a UAV meets.

    Attributes
    ----------
    mean : ndarray, shape (2,)
        East and north, in m/s.
    gusts : ndarray, shape (T, 2)
        What is added to it, every 0.1 s; after the end, the last one.
    """

    mean: NDArray[np.float64]
    gusts: NDArray[np.float64]

    def at(self, seconds: float) -> NDArray[np.float64]:
        """Return the wind at a time, east and north, in m/s."""
        k = min(max(seconds, 0.0) / _PERIOD, len(self.gusts) - 1)
        low = min(int(k), len(self.gusts) - 2)
        part = k - low
        return self.mean + (1 - part) * self.gusts[low] + part * self.gusts[low + 1]


def wind_of(key: int, speed: float, altitude: float, airspeed: float, seconds: float) -> Wind:
    """Return the wind of a flight, which is the same for the same arguments.

    Parameters
    ----------
    key : int
        The key of the episode.
    speed : float
        The mean wind, in m/s.
    altitude : float
        In metres.
    airspeed : float
        How fast the UAV flies through the gusts, in m/s.
    seconds : float
        How long the flight may take.
    """
    random = np.random.Generator(np.random.PCG64([key & (2**64 - 1), 7]))
    towards = random.uniform(0.0, 2 * math.pi)
    along = np.array([math.sin(towards), math.cos(towards)])
    feet = max(altitude / _FOOT, 10.0)
    factor = 0.177 + 0.000823 * feet
    deviation, length = 0.1 * speed / factor**0.4, feet / factor**1.2 * _FOOT
    keeps = math.exp(-_PERIOD * max(airspeed + speed, 0.1) / length)
    steps = max(2, math.ceil(seconds / _PERIOD) + 1)
    drawn: Any = random.standard_normal((steps, 2))
    gusts = np.empty((steps, 2))
    gusts[0] = drawn[0]
    for k in range(1, steps):
        gusts[k] = keeps * gusts[k - 1] + math.sqrt(1 - keeps**2) * drawn[k]
    across = np.array([-along[1], along[0]])
    return Wind(speed * along, deviation * (gusts[:, :1] * along + gusts[:, 1:] * across))
