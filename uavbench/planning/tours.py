"""First flights for searches on large maps: a tour of the places that pay most, within the budget.

A search changes a flight only a little at a time, so on a large map it cannot find out which districts to visit, and in which
order. This is the orienteering problem (Golden, Levy and Vohra, Naval Research Logistics 34, 1987): stops have prizes, and the
moves from stop to stop and to a landing zone must fit the budget. It is solved by simulated annealing over the order of stops.
"""

import math

import numpy as np
from numpy.typing import NDArray

from uavbench.planning.flights import Cell
from uavbench.planning.paths import follow, pick
from uavbench.world.city import City
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_uniform

_NEAR = 10  # the nearest stops of each stop, next to which it may be put
_ANYWHERE = 8  # one in so many changes puts a stop anywhere
_HOT, _COLD = 1.0, 0.02  # temperatures, in mean prizes
_PRICE = 0.05  # mean prizes that a tour pays for as many moves as there are from a stop to the nearest one
_FAR = np.iinfo(np.int32).max // 4


def first_flight(
    city: City, start: Cell, budget: int, stops: NDArray[np.int32], prizes: NDArray[np.float64], seed: int, changes: int
) -> list[Cell]:
    """Return a flight over stops with a large sum of prizes, from ``start`` to a landing cell.

    Parameters
    ----------
    city : City
        The city.
    start : (int, int)
        The UAV's cell.
    budget : int
        Actions left; the UAV must be able to land with them.
    stops : ndarray of int32, shape (K, 2)
        The cells of the stops; those that cannot be reached are left out.
    prizes : ndarray of float64, shape (K,)
        What a visit is worth.
    seed : int
        The flight is the same for the same seed, on any machine.
    changes : int
        How many changes of the tour are tried.
    """
    rows, cols = stops.T
    reached = (city.distances(start)[rows, cols] >= 0) & (city.distance_to_landing[rows, cols] >= 0)
    stops, prizes = stops[reached], prizes[reached]
    tour = [start]
    cursor = np.array([seed], dtype=np.uint64)
    if len(stops):
        cells = np.concatenate((np.array([start], dtype=np.int32), stops))
        away = np.stack([city.distances(cell)[cells[:, 0], cells[:, 1]] for cell in cells.tolist()])
        home = city.distance_to_landing[cells[:, 0], cells[:, 1]]
        order = _order(away, home, np.append(0.0, prizes), budget - 1, cursor, changes)
        tour = [(r, c) for r, c in cells[order].tolist()]
    return _flown(city, tour, cursor)


def _flown(city: City, tour: list[Cell], cursor: NDArray[np.uint64]) -> list[Cell]:
    """Return the cells of shortest paths from stop to stop and from the last one to a landing cell."""
    cols = city.shape[1]
    out = np.empty(city.no_fly.size, dtype=np.int32)
    flight = [tour[0]]
    for stop in [*tour[1:], None]:
        onward = city.distance_to_landing if stop is None else city.distances(stop)
        here = flight[-1][0] * cols + flight[-1][1]
        length = follow(onward.reshape(-1), cols, here, cols, here, True, cursor, out, 0)
        flight += [divmod(cell, cols) for cell in out[:length].tolist()]
    return flight


def _order(
    away: NDArray[np.int32],
    home: NDArray[np.int32],
    prizes: NDArray[np.float64],
    longest: int,
    cursor: NDArray[np.uint64],
    changes: int,
) -> NDArray[np.int64]:
    """Return the stops of the best tour found, in order; it begins with stop 0, where the UAV is."""
    others = away + _FAR * np.eye(len(away), dtype=np.int32)
    near = np.argsort(others, axis=1, kind="stable")[:, : min(_NEAR, len(away) - 1)]
    prize = prizes[1:].mean()
    price = _PRICE * prize / max(1.0, float(np.median(others.min(axis=1))))
    return _anneal(away, home, prizes, near, longest, price, prize * _HOT, prize * _COLD, cursor, changes)


@kernel
def _leg(away: NDArray[np.int32], home: NDArray[np.int32], here: int, there: int) -> int:
    """Return the moves between two stops of a tour; ``there`` is −1 for the landing zone at its end."""
    return int(home[here]) if there < 0 else int(away[here, there])


@kernel
def _anneal(
    away: NDArray[np.int32],
    home: NDArray[np.int32],
    prizes: NDArray[np.float64],
    near: NDArray[np.int64],
    longest: int,
    price: float,
    hot: float,
    cold: float,
    cursor: NDArray[np.uint64],
    changes: int,
) -> NDArray[np.int64]:
    """Anneal a tour, which begins as the direct way home; return the best one.

    ``tour`` holds the stops in order and then −1, the landing zone; ``place`` holds where each stop is in it, or −1.
    """
    count = len(prizes)
    tour = np.full(count + 1, -1)
    place = np.full(count, -1)
    tour[0] = place[0] = 0
    size, length, prize = 1, int(home[0]), 0.0
    best, best_value = tour[:1].copy(), 0.0
    temperature, cooling = hot, (cold / hot) ** (1.0 / max(1, changes))
    for _ in range(changes):
        temperature *= cooling
        kind = pick(cursor, 4)
        stop = 1 + pick(cursor, count - 1)
        beside = int(near[stop, pick(cursor, near.shape[1])] if pick(cursor, _ANYWHERE) else tour[pick(cursor, size)])
        here, at = int(place[stop]), int(place[beside])
        behind = at + pick(cursor, 2)  # a stop is put there: before or after the stop beside it
        more, longer = 0.0, 0
        low = high = -1
        if kind == 0 and here >= 0:  # leave out
            more = -prizes[stop]
            longer = _bridge(away, home, tour, here)
        elif at < 0 or (kind != 3 and behind == 0):
            continue
        elif kind == 0:  # put in
            more, longer = prizes[stop], _detour(away, home, tour, stop, behind)
        elif kind == 1:  # exchange for the stop beside it
            if here >= 0 or at == 0:
                continue
            more = prizes[stop] - prizes[beside]
            before, after = int(tour[at - 1]), int(tour[at + 1])
            longer = _leg(away, home, stop, after) + away[before, stop]
            longer -= _leg(away, home, beside, after) + away[before, beside]
        elif kind == 2:  # move to another place
            if here < 0 or behind == here or behind == here + 1:
                continue
            longer = _bridge(away, home, tour, here) + _detour(away, home, tour, stop, behind)
        else:  # reverse the stops from low to high, after which the stop and the one beside it follow each other
            if here < 0:
                continue
            low, high = (here + 1, at) if here < at else (at + 1, here)
            if behind == at:  # ... or the stop before them
                low, high = low - 1, high - 1
            if low < 1 or high <= low:
                continue
            before, after = int(tour[low - 1]), int(tour[high + 1])
            longer = away[before, tour[high]] + _leg(away, home, int(tour[low]), after)
            longer -= away[before, tour[low]] + _leg(away, home, int(tour[high]), after)
        if length + longer > longest:
            continue
        gain = more - price * longer
        if gain < 0.0 and next_uniform(cursor, 0.0, 1.0) >= math.exp(gain / temperature):
            continue
        length += longer
        prize += more
        if kind == 3:
            while low < high:
                tour[low], tour[high] = tour[high], tour[low]
                place[tour[low]], place[tour[high]] = low, high
                low, high = low + 1, high - 1
        elif kind == 1:
            tour[at], place[stop], place[beside] = stop, at, -1
        else:
            if here >= 0:
                _shift(tour, place, here, size, -1)
                size -= 1
                place[stop] = -1
                behind -= int(behind > here)
            if kind == 2 or here < 0:
                _shift(tour, place, behind, size, 1)
                size += 1
                tour[behind], place[stop] = stop, behind
        value = prize - 0.01 * price * length
        if value > best_value + 1e-9:
            best, best_value = tour[:size].copy(), value
    return best


@kernel
def _bridge(away: NDArray[np.int32], home: NDArray[np.int32], tour: NDArray[np.int64], index: int) -> int:
    """Return how much longer a tour becomes without the stop at ``index``; this is 0 or negative."""
    before, stop, after = int(tour[index - 1]), int(tour[index]), int(tour[index + 1])
    return _leg(away, home, before, after) - int(away[before, stop]) - _leg(away, home, stop, after)


@kernel
def _detour(away: NDArray[np.int32], home: NDArray[np.int32], tour: NDArray[np.int64], stop: int, index: int) -> int:
    """Return how much longer a tour becomes with another stop at ``index``."""
    before, after = int(tour[index - 1]), int(tour[index])
    return int(away[before, stop]) + _leg(away, home, stop, after) - _leg(away, home, before, after)


@kernel
def _shift(tour: NDArray[np.int64], place: NDArray[np.int64], index: int, size: int, step: int) -> None:
    """Make room for a stop at ``index`` if ``step`` is 1, or close the gap of the stop there if it is −1."""
    if step > 0:
        for k in range(size, index, -1):
            tour[k] = tour[k - 1]
            place[tour[k]] = k
    else:
        for k in range(index, size - 1):
            tour[k] = tour[k + 1]
            place[tour[k]] = k
        tour[size - 1] = -1
