"""Data harvesting by simulated annealing over whole flights, on expected rates.

A flight is the sequence of cells from the start to a landing cell, hovering included. Its value is the data that it collects
if every rate is equal to its mean over the fading, and the device with the highest mean is served.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uavbench.planning import nearby
from uavbench.planning.changes import propose
from uavbench.planning.distances import Distances, distances_of, is_large
from uavbench.planning.flights import Cell, Plan, landing_numbers, pack, unpack
from uavbench.planning.nearby import new_record, new_trial
from uavbench.planning.paths import pick
from uavbench.planning.rates import NearRates, RankedRates, action_of, expected_rates, near_rates, ranked
from uavbench.planning.tours import first_flight
from uavbench.planning.turns import turned
from uavbench.world.city import City, city_of
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_uniform
from uavbench.world.scenario import Scenario

LENGTH_PRICE = 0.02  # data units that a move costs in the search: shorter flights leave budget for other moves
HOT, _COLD = 1.5, 0.03


def rates_for(scenario: Scenario, devices: NDArray[np.int32], city: City) -> RankedRates | NearRates:
    """Return the rates that `search` needs: `expected_rates` by rank, or on a large map `near_rates`."""
    return near_rates(scenario, devices, city) if is_large(city.shape) else ranked(expected_rates(scenario, devices, city))


def search(
    scenario: Scenario,
    rates: NDArray[np.float32] | RankedRates | NearRates,
    devices: NDArray[np.int32],
    data: NDArray[np.float64],
    starts: Sequence[Cell],
    budgets: Sequence[int],
    *,
    seed: int,
    moves: int,
    first: Sequence[Sequence[Cell]] | None = None,
    hot: float = HOT,
    horizon: int | None = None,
    turn_cost: float = 0.0,
    city: City | None = None,
) -> Plan:
    """Search for flights that together are expected to collect as much data as possible.

    Parameters
    ----------
    scenario : Scenario
        A DH scenario.
    rates : RankedRates, NearRates, or ndarray of float32
        `rates_for` the devices; on a small map also `expected_rates`.
    devices : ndarray of int32, shape (K, 2)
        Their cells.
    data : ndarray of float64, shape (K,)
        Data left at each device.
    starts, budgets, seed, moves, first, hot, turn_cost, city
        As for `uavbench.planning.coverage.search`; the temperature is in data units.
    horizon : int, optional
        Only changes that begin in the first cells of a flight, so many, are tried; by default all.

    Raises
    ------
    ValueError
        When the scenario has many cities and ``city`` is not given.

    Notes
    -----
    On a large map, the flights of a team are improved one after the other, each for the data that those before it leave.
    """
    city = city or city_of(scenario)
    cols = city.shape[1]
    cursor = np.array([seed], dtype=np.uint64)
    paths, lengths = pack(city, starts, budgets, first, cursor)
    begins = horizon or paths.shape[1]
    if isinstance(rates, NearRates):
        value = _search_nearby(city, paths, lengths, budgets, rates, data, cursor, moves, hot, begins, turn_cost)
        return Plan(unpack(city, paths, lengths), value)
    value = anneal(
        paths,
        lengths,
        np.array(budgets, dtype=np.int64) - 1,
        distances_of(city),
        city.shape,
        landing_numbers(city),
        (devices[:, 0] * cols + devices[:, 1]).astype(np.int64),
        ranked(rates) if isinstance(rates, np.ndarray) else rates,
        np.asarray(data, dtype=np.float64),
        cursor,
        moves,
        hot,
        begins,
        turn_cost,
    )
    return Plan(unpack(city, paths, lengths), float(value))


def _search_nearby(
    city: City,
    paths: NDArray[np.int32],
    lengths: NDArray[np.int64],
    budgets: Sequence[int],
    rates: NearRates,
    data: NDArray[np.float64],
    cursor: NDArray[np.uint64],
    moves: int,
    hot: float,
    horizon: int,
    turn_cost: float,
) -> float:
    """Anneal flights one after the other, each for the data that those before it leave; return the data they collect."""
    left = np.array(data, dtype=np.float64)
    flown, trial = new_record(rates, paths.shape[1]), new_trial(rates, paths.shape[1])
    fixed = distances_of(city), city.shape, landing_numbers(city), rates
    share = moves // len(paths)
    for u in range(len(paths)):
        lengths[u] = nearby.anneal(
            paths[u], lengths[u], budgets[u] - 1, *fixed, left, cursor, share, hot, horizon, turn_cost, flown, trial
        )
    return float(np.sum(data) - left.sum())


def first_flights(
    data: NDArray[np.float64],
    devices: NDArray[np.int32],
    starts: Sequence[Cell],
    budgets: Sequence[int],
    city: City,
    *,
    seed: int,
    changes: int,
) -> list[list[Cell]]:
    """Return flights for `search` to start from on a large map: tours of the devices, one UAV after the other.

    The parameters are those of `search`; ``changes`` of each tour are tried.
    """
    places = np.array([_place(city, device) for device in devices.tolist()], dtype=np.int32).reshape(-1, 2)
    left = data > 0.0
    flights: list[list[Cell]] = []
    for start, budget in zip(starts, budgets, strict=True):
        stops = np.flatnonzero(left)
        flight = first_flight(city, start, budget, places[stops], data[stops], seed, changes)
        visited = set(flight)
        left &= [tuple(place) not in visited for place in places.tolist()]
        flights.append(flight)
    return flights


def _place(city: City, device: Sequence[int]) -> Cell:
    """Return the cell nearest to a device from which a UAV can fly to a landing cell."""
    rows, cols = np.indices(city.shape)
    square = np.where(city.distance_to_landing >= 0, (rows - device[0]) ** 2 + (cols - device[1]) ** 2, 2 * rows.size)
    r, c = divmod(int(np.argmin(square)), city.shape[1])
    return r, c


@kernel
def _serve(here: int, there: int, cols: int, rates: RankedRates, left: NDArray[np.float64], t: int) -> float:
    """Serve devices in step t, from cell ``here`` to ``there`` (a move or hovering); return the data collected."""
    action = action_of(here, there, cols)
    collected = 0.0
    for k in range(rates.rates.shape[2]):
        for n in range(left.shape[1]):
            rate = rates.rates[here, action, k, n]
            if rate <= 0.0:
                break
            j = rates.devices[here, action, k, n]
            if left[t, j] > 0.0:
                served = min(rate, left[t, j])
                left[t, j] -= served
                collected += served
                break
    return collected


@kernel
def simulate(
    paths: NDArray[np.int32],
    lengths: NDArray[np.int64],
    begin: int,
    cols: int,
    rates: RankedRates,
    left: NDArray[np.float64],
    total: NDArray[np.float64],
) -> float:
    """Fly all flights from step ``begin`` on, in each step one UAV after the other; return the data collected.

    ``left[t]`` and ``total[t]`` are the data left and collected after step t; up to step ``begin`` − 1 they are given.
    """
    last = lengths.max()
    for t in range(begin, last + 1):
        for j in range(left.shape[1]):
            left[t, j] = left[t - 1, j]
        total[t] = total[t - 1]
        for u in range(len(paths)):
            if t <= lengths[u]:
                total[t] += _serve(paths[u, t - 1], paths[u, t], cols, rates, left, t)
    return float(total[last])


@kernel
def anneal(
    paths: NDArray[np.int32],
    lengths: NDArray[np.int64],
    longest: NDArray[np.int64],
    distance: Distances,
    shape: tuple[int, int],
    landing: NDArray[np.int32],
    aims: NDArray[np.int64],
    rates: RankedRates,
    data: NDArray[np.float64],
    cursor: NDArray[np.uint64],
    moves: int,
    hot: float,
    horizon: int,
    turn_cost: float,
) -> float:
    """Anneal the flights in place (cells 0 to ``lengths`` of each row); return the data that the best flights collect."""
    cols = shape[1]
    left = np.zeros((paths.shape[1], len(data)))
    total = np.zeros(paths.shape[1])
    left[0] = data
    collected = simulate(paths, lengths, 1, cols, rates, left, total)
    new_left, new_total = left.copy(), total.copy()
    value = collected - LENGTH_PRICE * lengths.sum()
    turning = 0.0  # the price of the turns, above that of the first flights
    best, best_lengths, best_value, best_collected = paths.copy(), lengths.copy(), value, collected
    served = np.zeros(len(aims), dtype=np.int32)  # always 0: flights should come near to all devices
    new = np.empty(2 * paths.shape[1] + 8 * shape[0] * shape[1], dtype=np.int32)
    before = np.empty(paths.shape[1], dtype=np.int32)
    temperature, cooling = hot, (_COLD / hot) ** (1.0 / max(1, moves))
    for _ in range(moves):
        temperature *= cooling
        u = pick(cursor, len(paths))
        path, length = paths[u], lengths[u]
        first, after, size = propose(
            path, length, longest[u], distance, shape, landing, aims, served, True, horizon, cursor, new
        )
        price = turned(path, length, longest[u], first, after, size, new, cols, turn_cost) if size >= 0 else math.inf
        if price == math.inf:
            continue
        grown = length + size - (after - first - 1)
        before[first + 1 : length + 1] = path[first + 1 : length + 1]
        path[first + 1 : first + 1 + size] = new[:size]
        path[first + 1 + size : grown + 1] = before[after : length + 1]
        lengths[u] = grown
        new_left[first], new_total[first] = left[first], total[first]
        found = simulate(paths, lengths, first + 1, cols, rates, new_left, new_total)
        worth = found - LENGTH_PRICE * lengths.sum()
        gain = worth - value - LENGTH_PRICE * price
        if gain >= 0.0 or next_uniform(cursor, 0.0, 1.0) < math.exp(gain / temperature):
            last = lengths.max()
            left[first + 1 : last + 1] = new_left[first + 1 : last + 1]
            total[first + 1 : last + 1] = new_total[first + 1 : last + 1]
            value, collected = worth, found
            turning += LENGTH_PRICE * price
            if value - turning > best_value + 1e-9:
                best_value, best_collected = value - turning, collected
                best[:], best_lengths[:] = paths, lengths
        else:
            path[first + 1 : length + 1] = before[first + 1 : length + 1]
            lengths[u] = length
    paths[:], lengths[:] = best, best_lengths
    return best_collected
