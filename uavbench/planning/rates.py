"""Expected rates of devices: their mean over the fading, by the place and direction of the UAV's action.

On small maps a table holds the rate of every device in every cell. On large maps only devices near the UAV count, because the
rates of the others are hardly above 0.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.simulation.missions.channel import Channel, channel_of, log_snr_of
from uavbench.world.city import City, city_of
from uavbench.world.kernel import kernel
from uavbench.world.parameters import Harvesting
from uavbench.world.scenario import Scenario

_NODES = 9  # of the Gauss-Hermite rule for means over the fading
_ACTIONS = 5  # the actions with communication: four moves and hovering
_LOWEST = 0.1  # data units per action of hovering in line of sight: devices with less are not near
_FARTHEST = 20  # rows or columns to the farthest device that is near


class NearRates(NamedTuple):
    """The expected rates of the devices near each cell of a large map.

    Attributes
    ----------
    reach : int
        A device is near the cells that are at most so many rows and so many columns away from it.
    cells : ndarray of int32, shape (K, 2)
        The cells of the devices.
    begin : ndarray of int64, shape (MN + 1,)
        Where the devices near a cell (row-major) begin in ``devices`` and ``rates``; those of the next cell follow them.
    devices : ndarray of int32, shape (P,)
        The devices near each cell, for one cell after the other.
    rates : ndarray of float32, shape (P, 5, communication steps)
        Their expected rates in data units per communication step, by the action (0 to 4) that begins in the cell and its
        communication step. 0 for actions that are blocked.
    """

    reach: int
    cells: NDArray[np.int32]
    begin: NDArray[np.int64]
    devices: NDArray[np.int32]
    rates: NDArray[np.float32]


class RankedRates(NamedTuple):
    """Expected rates with the devices in the order of their rates, for each place and direction of the UAV's action.

    Attributes
    ----------
    devices : ndarray of int32, shape (MN, 5, communication steps, K)
        The numbers of the devices, the one with the highest rate first; of equal rates, that of the lower number.
    rates : ndarray of float32, shape (MN, 5, communication steps, K)
        Their rates in data units per communication step, from the highest to the lowest: see `expected_rates`.
    """

    devices: NDArray[np.int32]
    rates: NDArray[np.float32]


def ranked(rates: NDArray[np.float32]) -> RankedRates:
    """Return expected rates with the devices in the order of their rates, so that a search finds the best one at once."""
    devices = np.argsort(-rates, axis=-1, kind="stable")
    return RankedRates(devices.astype(np.int32), np.take_along_axis(rates, devices, axis=-1))


def expected_rates(scenario: Scenario, devices: NDArray[np.int32], city: City | None = None) -> NDArray[np.float32]:
    """Return the expected rate of each device, in data units per communication step.

    Parameters
    ----------
    scenario : Scenario
        A DH scenario.
    devices : ndarray of int32, shape (K, 2)
        Their cells.
    city : City, optional
        The city; by default the scenario's only one. In a scenario with many cities, give it: agents read ``state.city``.

    Returns
    -------
    ndarray of float32, shape (MN, 5, communication steps, K)
        By the cell (row-major) where an action begins, the action (0 to 4), its communication step, and the device. 0 for
        actions that are blocked.

    Raises
    ------
    ValueError
        When the scenario has many cities and ``city`` is not given.
    """
    assert isinstance(scenario.mission, Harvesting)
    city = city or city_of(scenario)
    channel = channel_of(scenario.mission, city.shape)
    rates = np.zeros((city.no_fly.size, _ACTIONS, channel.steps, len(devices)), dtype=np.float32)
    _fill_rates(devices, _sight(city, devices), city.no_fly, channel, *_quadrature(), rates)
    return rates


def near_rates(scenario: Scenario, devices: NDArray[np.int32], city: City) -> NearRates:
    """Return the expected rates of the devices near each cell; the parameters are those of `expected_rates`.

    A device is near a cell if hovering there in line of sight is expected to yield at least 0.1 data units per action, and if
    it is at most 20 rows and columns away.
    """
    assert isinstance(scenario.mission, Harvesting)
    channel = channel_of(scenario.mission, city.shape)
    reach = 1
    while reach < _FARTHEST and channel.steps * _mean_rate(channel, 0, reach + 1, 0.0, 0.0, 1, *_quadrature()) >= _LOWEST:
        reach += 1
    begin = np.zeros(city.no_fly.size + 1, dtype=np.int64)
    _count_near(devices, city.shape, reach, begin)
    near = np.empty(int(begin[-1]), dtype=np.int32)
    rates = np.zeros((len(near), _ACTIONS, channel.steps), dtype=np.float32)
    _fill_near_rates(devices, _sight(city, devices), city.no_fly, channel, *_quadrature(), reach, begin, near, rates)
    return NearRates(reach, np.asarray(devices, dtype=np.int32), begin, near, rates)


def _sight(city: City, devices: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return from which cells each device is seen, shape (K, M, N)."""
    return np.array([city.visible(cell) for cell in devices.tolist()], dtype=np.bool_).reshape(-1, *city.shape)


def _quadrature() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the nodes and the weights of the means over the fading."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    return nodes, weights / weights.sum()


@kernel
def _mean_rate(
    channel: Channel,
    y: int,
    x: int,
    r: float,
    c: float,
    clear: int,
    nodes: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> float:
    """Return the mean over the fading of the rate between a UAV at (r, c) and a device in cell (y, x)."""
    level = log_snr_of(channel, y, x, r, c, clear)
    mean = 0.0
    for n in range(len(nodes)):
        mean += weights[n] * math.log2(1.0 + math.exp(level + channel.fading[clear] * nodes[n]))
    return mean


@kernel
def _fill_rates(
    devices: NDArray[np.int32],
    sight: NDArray[np.bool_],
    no_fly: NDArray[np.bool_],
    channel: Channel,
    nodes: NDArray[np.float64],
    weights: NDArray[np.float64],
    rates: NDArray[np.float32],
) -> None:
    """Write the expected rates for every action that is not blocked."""
    rows, cols = no_fly.shape
    for cell in range(rows * cols):
        r0, c0 = cell // cols, cell % cols
        for action in range(5):
            r1 = r0 + (-1, 0, 1, 0, 0)[action]
            c1 = c0 + (0, 1, 0, -1, 0)[action]
            if not (0 <= r1 < rows and 0 <= c1 < cols) or no_fly[r0, c0] or no_fly[r1, c1]:
                continue
            for k in range(channel.steps):
                share = (k + 1) / channel.steps
                r, c = r0 + share * (r1 - r0), c0 + share * (c1 - c0)
                y, x = round(r), round(c)
                for j in range(len(devices)):
                    clear = int(sight[j, y, x])
                    mean = _mean_rate(channel, devices[j, 0], devices[j, 1], r, c, clear, nodes, weights)
                    rates[cell, action, k, j] = mean


@kernel
def _count_near(devices: NDArray[np.int32], shape: tuple[int, int], reach: int, begin: NDArray[np.int64]) -> None:
    """Write where the devices near each cell begin in a list of all: see `NearRates`."""
    rows, cols = shape
    for j in range(len(devices)):
        for r in range(max(0, devices[j, 0] - reach), min(rows, devices[j, 0] + reach + 1)):
            for c in range(max(0, devices[j, 1] - reach), min(cols, devices[j, 1] + reach + 1)):
                begin[r * cols + c + 1] += 1
    for cell in range(rows * cols):
        begin[cell + 1] += begin[cell]


@kernel
def _fill_near_rates(
    devices: NDArray[np.int32],
    sight: NDArray[np.bool_],
    no_fly: NDArray[np.bool_],
    channel: Channel,
    nodes: NDArray[np.float64],
    weights: NDArray[np.float64],
    reach: int,
    begin: NDArray[np.int64],
    near: NDArray[np.int32],
    rates: NDArray[np.float32],
) -> None:
    """Write the devices near each cell, and their expected rates for every action that is not blocked."""
    rows, cols = no_fly.shape
    count = np.zeros(rows * cols, dtype=np.int64)
    for j in range(len(devices)):
        for r0 in range(max(0, devices[j, 0] - reach), min(rows, devices[j, 0] + reach + 1)):
            for c0 in range(max(0, devices[j, 1] - reach), min(cols, devices[j, 1] + reach + 1)):
                cell = r0 * cols + c0
                n = begin[cell] + count[cell]
                count[cell] += 1
                near[n] = j
                for action in range(5):
                    r1 = r0 + (-1, 0, 1, 0, 0)[action]
                    c1 = c0 + (0, 1, 0, -1, 0)[action]
                    if not (0 <= r1 < rows and 0 <= c1 < cols) or no_fly[r0, c0] or no_fly[r1, c1]:
                        continue
                    for k in range(channel.steps):
                        share = (k + 1) / channel.steps
                        r, c = r0 + share * (r1 - r0), c0 + share * (c1 - c0)
                        clear = int(sight[j, round(r), round(c)])
                        mean = _mean_rate(channel, devices[j, 0], devices[j, 1], r, c, clear, nodes, weights)
                        rates[n, action, k] = mean


@kernel
def action_of(here: int, there: int, cols: int) -> int:
    """Return the action that leads from a cell (row-major) to one beside it, or hovering if both are the same."""
    if there == here - cols:
        return 0
    if there == here + 1:
        return 1
    if there == here + cols:
        return 2
    if there == here - 1:
        return 3
    return 4
