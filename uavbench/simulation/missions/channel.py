"""The radio channel of data harvesting: the signal-to-noise ratio of a link (Bayerlein et al., GLOBECOM 2020)."""

import math
from typing import NamedTuple

import numpy as np

from uavbench.world.kernel import kernel
from uavbench.world.parameters import Harvesting

_NEPERS_PER_DB = math.log(10.0) / 10.0
_LAST_PLACE = 2.0**-52  # the value of the last of the 52 bits of a float64's fraction


class Channel(NamedTuple):
    """The channel's parameters, in the form that the kernels need.

    A pair is indexed by line of sight: 0 without, 1 with.
    """

    log_gain: float  # ln γ
    half_exponent: tuple[float, float]  # α/2, for d² instead of d
    fading: tuple[float, float]  # the standard deviation of ln 10^(η/10)
    cell_size: float
    altitude: float
    steps: int


def channel_of(parameters: Harvesting, shape: tuple[int, int]) -> Channel:
    """Return the channel on a map of ``shape``.

    γ = 10^(s/10) · (√2/2 · M · cell)^α_los, where M is the map's longer side: at the distance √2/2 · M · cell with line of
    sight, the signal-to-noise ratio is s. The same γ, with the exponent for line of sight, is used without line of sight.
    """
    exponent, variance = parameters.path_loss_exponent, parameters.fading_variance
    edge = math.sqrt(2.0) / 2.0 * max(shape) * parameters.cell_size
    return Channel(
        log_gain=parameters.edge_snr * _NEPERS_PER_DB + exponent.los * math.log(edge),
        half_exponent=(exponent.nlos / 2.0, exponent.los / 2.0),
        fading=(math.sqrt(variance.nlos) * _NEPERS_PER_DB, math.sqrt(variance.los) * _NEPERS_PER_DB),
        cell_size=parameters.cell_size,
        altitude=parameters.altitude,
        steps=parameters.communication_steps,
    )


@kernel
def log_snr_of(channel: Channel, y: int, x: int, r: float, c: float, clear: int) -> float:
    """Return ln SNR, without fading, between a UAV at (r, c) and a device in cell (y, x); ``clear`` is 1 with line of sight.

    It returns the logarithm because this takes one call of log, while the ratio itself would take two powers.
    """
    return channel.log_gain - channel.half_exponent[clear] * math.log(square_of(channel, y, x, r, c))


@kernel
def square_of(channel: Channel, y: int, x: int, r: float, c: float) -> float:
    """Return the square of the distance, in m², between a UAV at (r, c) and a device in cell (y, x)."""
    down, right = (y - r) * channel.cell_size, (x - c) * channel.cell_size
    return down * down + right * right + channel.altitude * channel.altitude


@kernel
def log_below(x: float) -> float:
    """Return a lower bound of ln ``x`` that is less than 0.06 too low.

    The bits of a float64, read as an integer, are its exponent followed by its fraction f, and log₂(1 + f) is at least f.
    """
    return (np.float64(np.float64(x).view(np.int64)) * _LAST_PLACE - 1023.0) * math.log(2.0) - 1e-9
