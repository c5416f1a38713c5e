"""Data harvesting by simulated annealing over whole flights, on expected rates.

A flight is the sequence of cells from the start to a landing cell, hovering included. Its value is the data that it collects
if every rate is equal to its mean over the fading, and the device with the highest mean is served.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uavbench.planning.changes import propose
from uavbench.planning.flights import Cell, Plan, landing_numbers, pack, unpack
from uavbench.planning.paths import distance_table, pick
from uavbench.simulation.missions.channel import Channel, channel_of, log_snr_of
from uavbench.world.city import City, city_of
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_uniform
from uavbench.world.parameters import Harvesting
from uavbench.world.scenario import Scenario

_LENGTH_PRICE = 0.02  # data units that a move costs in the search: shorter flights leave budget for other moves
HOT, _COLD = 1.5, 0.03
_NODES = 9  # of the Gauss-Hermite rule for means over the fading
_ACTIONS = 5  # the actions with communication: four moves and hovering


def expected_rates(scenario: Scenario, devices: NDArray[np.int32], city: City | None = None) -> NDArray[np.float32]:
    """Return the expected rate of each device, in data units per communication step.

    Parameters
    ----------
    scenario : Scenario
        A DH scenario.
    devices : ndarray of int32, shape (K, 2)
        Their cells.
    city : City, optional
        The city; by default the scenario's only one.

    Returns
    -------
    ndarray of float32, shape (MN, 5, communication steps, K)
        By the cell (row-major) where an action begins, the action (0 to 4), its communication step, and the device. 0 for
        actions that are blocked.
    """
    assert isinstance(scenario.mission, Harvesting)
    city = city or city_of(scenario)
    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    channel = channel_of(scenario.mission, city.shape)
    sight = np.array([city.visible(cell) for cell in devices.tolist()], dtype=np.bool_).reshape(-1, *city.shape)
    rates = np.zeros((city.no_fly.size, _ACTIONS, channel.steps, len(devices)), dtype=np.float32)
    _fill_rates(devices, sight, city.no_fly, channel, nodes, weights / weights.sum(), rates)
    return rates


def search(
    scenario: Scenario,
    rates: NDArray[np.float32],
    devices: NDArray[np.int32],
    data: NDArray[np.float64],
    starts: Sequence[Cell],
    budgets: Sequence[int],
    *,
    seed: int,
    moves: int,
    first: Sequence[Sequence[Cell]] | None = None,
    hot: float = HOT,
    city: City | None = None,
) -> Plan:
    """Search for flights that together are expected to collect as much data as possible.

    Parameters
    ----------
    scenario : Scenario
        A DH scenario.
    rates : ndarray of float32
        `expected_rates` of the devices.
    devices : ndarray of int32, shape (K, 2)
        Their cells.
    data : ndarray of float64, shape (K,)
        Data left at each device.
    starts, budgets, seed, moves, first, hot, city
        As for `uavbench.planning.coverage.search`; the temperature is in data units.
    """
    city = city or city_of(scenario)
    cols = city.shape[1]
    cursor = np.array([seed], dtype=np.uint64)
    paths, lengths = pack(city, starts, budgets, first, cursor)
    value = _anneal(
        paths,
        lengths,
        np.array(budgets, dtype=np.int64) - 1,
        distance_table(city),
        cols,
        landing_numbers(city),
        (devices[:, 0] * cols + devices[:, 1]).astype(np.int64),
        rates,
        np.asarray(data, dtype=np.float64),
        cursor,
        moves,
        hot,
    )
    return Plan(unpack(city, paths, lengths), float(value))


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
                    level = log_snr_of(channel, devices[j, 0], devices[j, 1], r, c, clear)
                    mean = 0.0
                    for n in range(len(nodes)):
                        mean += weights[n] * math.log2(1.0 + math.exp(level + channel.fading[clear] * nodes[n]))
                    rates[cell, action, k, j] = mean


@kernel
def _serve(here: int, there: int, cols: int, rates: NDArray[np.float32], left: NDArray[np.float64]) -> float:
    """Serve devices during the action from cell ``here`` to ``there`` (a move or hovering); return the data collected."""
    action = 4
    if there == here - cols:
        action = 0
    elif there == here + 1:
        action = 1
    elif there == here + cols:
        action = 2
    elif there == here - 1:
        action = 3
    collected = 0.0
    for k in range(rates.shape[2]):
        best, highest = -1, 0.0
        for j in range(len(left)):
            if left[j] > 0.0 and rates[here, action, k, j] > highest:
                best, highest = j, rates[here, action, k, j]
        if best >= 0:
            served = min(highest, left[best])
            left[best] -= served
            collected += served
    return collected


@kernel
def _simulate(
    paths: NDArray[np.int32],
    lengths: NDArray[np.int64],
    begin: int,
    cols: int,
    rates: NDArray[np.float32],
    left: NDArray[np.float64],
    total: NDArray[np.float64],
) -> float:
    """Fly all flights from step ``begin`` on, in each step one UAV after the other; return the data collected.

    ``left[t]`` and ``total[t]`` are the data left and collected after step t; up to step ``begin`` − 1 they are given.
    """
    last = lengths.max()
    for t in range(begin, last + 1):
        left[t] = left[t - 1]
        total[t] = total[t - 1]
        for u in range(len(paths)):
            if t <= lengths[u]:
                total[t] += _serve(paths[u, t - 1], paths[u, t], cols, rates, left[t])
    return float(total[last])


@kernel
def _anneal(
    paths: NDArray[np.int32],
    lengths: NDArray[np.int64],
    longest: NDArray[np.int64],
    distance: NDArray[np.int16],
    cols: int,
    landing: NDArray[np.int32],
    aims: NDArray[np.int64],
    rates: NDArray[np.float32],
    data: NDArray[np.float64],
    cursor: NDArray[np.uint64],
    moves: int,
    hot: float,
) -> float:
    """Anneal the flights in place (cells 0 to ``lengths`` of each row); return the data that the best flights collect."""
    left = np.zeros((paths.shape[1], len(data)))
    total = np.zeros(paths.shape[1])
    left[0] = data
    collected = _simulate(paths, lengths, 1, cols, rates, left, total)
    new_left, new_total = left.copy(), total.copy()
    value = collected - _LENGTH_PRICE * lengths.sum()
    best, best_lengths, best_value, best_collected = paths.copy(), lengths.copy(), value, collected
    served = np.zeros(len(aims), dtype=np.int32)  # always 0: flights should come near to all devices
    new = np.empty(2 * paths.shape[1] + 8 * distance.shape[0], dtype=np.int32)
    before = np.empty(paths.shape[1], dtype=np.int32)
    temperature, cooling = hot, (_COLD / hot) ** (1.0 / max(1, moves))
    for _ in range(moves):
        temperature *= cooling
        u = pick(cursor, len(paths))
        path, length = paths[u], lengths[u]
        first, after, size = propose(path, length, distance, cols, landing, aims, served, True, cursor, new)
        grown = length + size - (after - first - 1)
        if size < 0 or grown > longest[u]:
            continue
        before[first + 1 : length + 1] = path[first + 1 : length + 1]
        path[first + 1 : first + 1 + size] = new[:size]
        path[first + 1 + size : grown + 1] = before[after : length + 1]
        lengths[u] = grown
        new_left[first], new_total[first] = left[first], total[first]
        found = _simulate(paths, lengths, first + 1, cols, rates, new_left, new_total)
        worth = found - _LENGTH_PRICE * lengths.sum()
        gain = worth - value
        if gain >= 0.0 or next_uniform(cursor, 0.0, 1.0) < math.exp(gain / temperature):
            last = lengths.max()
            left[first + 1 : last + 1] = new_left[first + 1 : last + 1]
            total[first + 1 : last + 1] = new_total[first + 1 : last + 1]
            value, collected = worth, found
            if value > best_value + 1e-9:
                best_value, best_collected = value, collected
                best[:], best_lengths[:] = paths, lengths
        else:
            path[first + 1 : length + 1] = before[first + 1 : length + 1]
            lengths[u] = length
    paths[:], lengths[:] = best, best_lengths
    return best_collected
