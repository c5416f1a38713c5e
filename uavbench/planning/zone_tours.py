"""Short tours through zones, each of which can be swept in several ways: the generalised travelling salesman problem.

A way begins at one cell of a zone and ends at another one. A tour is an order of zones, with a way for each of them.

`whole_tour` is a local search that tries each zone in each position: for few zones. `tour_within` is for any number: it inserts
zones until the budget is used up, and applies that local search to short parts of the tour.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.planning.shortest import Grid, moves_between
from uavbench.world.city import City
from uavbench.world.kernel import kernel

_PART = 8  # zones of a tour that are ordered anew at a time
_ROUNDS = 3  # how often parts are ordered anew, and more zones are inserted for the moves that this has saved
_FAR = 1 << 40  # more moves than any flight has

Tour = tuple[NDArray[np.int64], NDArray[np.int64]]


class Zones(NamedTuple):
    """K zones, each with W ways to sweep it. Cell (r, c) of a map with N columns has the number r · N + c.

    Attributes
    ----------
    enter, leave : ndarray of int64, shape (K, W)
        The cells where each way begins and ends.
    within : ndarray of int64, shape (K, W)
        The number of moves from the beginning to the end of each way.
    worth : ndarray of int64, shape (K,)
        What it is worth to sweep each zone, for example its number of targets.
    """

    enter: NDArray[np.int64]
    leave: NDArray[np.int64]
    within: NDArray[np.int64]
    worth: NDArray[np.int64]


@dataclass(frozen=True)
class Field:
    """Where tours are flown: from a start to a landing zone.

    Attributes
    ----------
    city : City
        The city.
    grid : Grid
        The city's cells, from `grid_of`.
    start : int
        The UAV's cell.
    """

    city: City
    grid: Grid
    start: int

    @property
    def home(self) -> NDArray[np.int32]:
        """Return the number of moves from each cell to the nearest landing cell, shape (MN,)."""
        return self.city.distance_to_landing.reshape(-1)


def whole_tour(field: Field, zones: Zones) -> Tour:
    """Return a short tour through all zones; the time that this takes grows with the fourth power of their number.

    Returns
    -------
    order, ways : ndarray of int64, shape (K,)
        The zones in the order of the tour, and the way to sweep each of them, in the same order.
    """
    return best_order(*_tables(field.grid, field.home, zones, np.arange(len(zones.worth)), field.start, -1))


def tour_within(field: Field, zones: Zones, budget: int) -> Tour:
    """Return a short tour through as many zones as the budget suffices for, and one more, unless it suffices for all.

    Parameters
    ----------
    field : Field
    zones : Zones
    budget : int
        The number of moves from the start to a landing zone.

    Returns
    -------
    order, ways : ndarray of int64, shape (k,)
        The zones in the order of the tour, and the way to sweep each of them, in the same order.
    """
    insertion = _Insertion(field, zones)
    order: list[int] = []
    ways: list[int] = []
    for _ in range(_ROUNDS):
        before = len(order)
        insertion.insert(order, ways, budget)
        if len(order) == before:
            break
        for first in range(0, len(order), _PART // 2):
            _improve(field, zones, order, ways, first)
    return np.array(order), np.array(ways)


class _Insertion:
    """Inserts zones into a tour, each time the one that is worth most per further move.

    A tour of k zones has k + 1 gaps: from the start to the first zone, between the zones, and from the last zone to a landing
    zone.
    """

    def __init__(self, field: Field, zones: Zones) -> None:
        self._field, self._zones = field, zones
        self._kept: dict[int, tuple[NDArray[np.int32], NDArray[np.int32]]] = {}

    def _moves(self, cell: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return the numbers of moves from a cell to where ways begin, and to it from where they end; both of shape (K, W).

        The cell −1 stands for the landing zones.
        """
        if cell not in self._kept:
            city = self._field.city
            moves = self._field.home if cell < 0 else city.distances(divmod(cell, city.shape[1])).reshape(-1)
            self._kept[cell] = moves[self._zones.enter], moves[self._zones.leave]
        return self._kept[cell]

    def _gap(self, order: list[int], ways: list[int], place: int) -> tuple[int, NDArray[np.int64], NDArray[np.int64]]:
        """Return the moves in a gap, and for each zone how few further moves it takes to sweep it there, and in which way."""
        enter, leave = self._zones.enter, self._zones.leave
        here = int(leave[order[place - 1], ways[place - 1]]) if place else self._field.start
        there = int(enter[order[place], ways[place]]) if place < len(order) else -1
        gap = _onward(self._field.grid, self._field.home, here, there)
        further = self._moves(here)[0] + self._zones.within + self._moves(there)[1] - gap
        return gap, further.min(axis=1), further.argmin(axis=1)

    def insert(self, order: list[int], ways: list[int], budget: int) -> None:
        """Insert zones, in place, until the tour is longer than the budget or there is no other zone."""
        gaps = [self._gap(order, ways, place) for place in range(len(order) + 1)]
        length = sum(gap for gap, _, _ in gaps) + int(self._zones.within[order, ways].sum())
        while len(order) < len(self._zones.worth) and length <= budget:
            further = np.array([more for _, more, _ in gaps])
            value = self._zones.worth / np.maximum(further.min(axis=0), 0.5)
            value[order] = -1.0
            zone = int(np.argmax(value))
            place = int(np.argmin(further[:, zone]))
            length += int(further[place, zone])
            order.insert(place, zone)
            ways.insert(place, int(gaps[place][2][zone]))
            gaps[place : place + 1] = [self._gap(order, ways, place), self._gap(order, ways, place + 1)]


def _improve(field: Field, zones: Zones, order: list[int], ways: list[int], first: int) -> None:
    """Order the part of a tour that begins at position ``first`` anew, in place; the tour does not become longer."""
    part = np.array(order[first : first + _PART])
    after = first + len(part)
    start = int(zones.leave[order[first - 1], ways[first - 1]]) if first else field.start
    goal = int(zones.enter[order[after], ways[after]]) if after < len(order) else -1
    places, chosen = best_order(*_tables(field.grid, field.home, zones, part, start, goal))
    order[first:after], ways[first:after] = part[places].tolist(), chosen.tolist()


@kernel
def _tables(
    grid: Grid, home: NDArray[np.int32], zones: Zones, part: NDArray[np.int64], start: int, goal: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the tables of `best_order` for some of the zones, and for tours from ``start`` to ``goal`` (see `_onward`)."""
    number, ways = len(part), zones.enter.shape[1]
    first = np.empty((number, ways), dtype=np.int64)
    between = np.zeros((number, ways, number, ways), dtype=np.int64)
    last = np.empty((number, ways), dtype=np.int64)
    for k in range(number):
        for w in range(ways):
            leave = zones.leave[part[k], w]
            first[k, w] = moves_between(grid, start, zones.enter[part[k], w]) + zones.within[part[k], w]
            last[k, w] = _onward(grid, home, leave, goal)
            for j in range(number):
                for v in range(ways):
                    if j != k:
                        moves = moves_between(grid, leave, zones.enter[part[j], v])
                        between[k, w, j, v] = moves + zones.within[part[j], v]
    return first, between, last


@kernel
def _onward(grid: Grid, home: NDArray[np.int32], cell: int, goal: int) -> int:
    """Return the number of moves from a cell to another one, or to the nearest landing cell if ``goal`` is −1."""
    return home[cell] if goal < 0 else moves_between(grid, cell, goal)


@kernel
def best_order(first: NDArray[np.int64], between: NDArray[np.int64], last: NDArray[np.int64]) -> Tour:
    """Solve the generalised travelling salesman problem by local search: move one zone, or reverse a part (2-opt).

    Parameters
    ----------
    first : ndarray of int, shape (K, W)
        Number of moves to fly from the start to zone k and sweep it in way w.
    between : ndarray of int, shape (K, W, K, W)
        Number of moves to fly from the end of a way of one zone to another zone and sweep that in one of its ways.
    last : ndarray of int, shape (K, W)
        Number of moves from the end of a way of a zone to the nearest landing cell.

    Returns
    -------
    order, ways : ndarray of int64, shape (K,)
        The zones in the order of the tour, and the way to sweep each of them, in the same order.
    """
    order = np.arange(len(first))
    shortest = best_ways(order, first, between, last)[0]
    improved = True
    while improved:
        improved = False
        for i in range(len(order)):
            for j in range(len(order)):
                for trial in (_moved(order, i, j), _turned(order, i, j)):
                    length = best_ways(trial, first, between, last)[0]
                    if length < shortest:
                        shortest, order, improved = length, trial, True
    return order, best_ways(order, first, between, last)[1]


@kernel
def _moved(order: NDArray[np.int64], i: int, j: int) -> NDArray[np.int64]:
    """Return the order with the zone at position i moved to position j."""
    rest = np.append(order[:i], order[i + 1 :])
    return np.concatenate((rest[:j], order[i : i + 1], rest[j:]))


@kernel
def _turned(order: NDArray[np.int64], i: int, j: int) -> NDArray[np.int64]:
    """Return the order with the zones from position i to position j reversed (2-opt)."""
    turned = order.copy()
    turned[i : j + 1] = order[i : j + 1][::-1]
    return turned


@kernel
def best_ways(
    order: NDArray[np.int64], first: NDArray[np.int64], between: NDArray[np.int64], last: NDArray[np.int64]
) -> tuple[int, NDArray[np.int64]]:
    """Return the fewest moves for a tour in this order, and the way to sweep each zone, by dynamic programming."""
    number, ways = len(order), first.shape[1]
    moves = np.empty((number, ways), dtype=np.int64)
    before = np.zeros((number, ways), dtype=np.int64)
    moves[0] = first[order[0]]
    for k in range(1, number):
        for w in range(ways):
            moves[k, w] = _FAR
            for v in range(ways):
                reached = moves[k - 1, v] + between[order[k - 1], v, order[k], w]
                if reached < moves[k, w]:
                    moves[k, w], before[k, w] = reached, v
    total = moves[-1] + last[order[-1]]
    chosen = np.empty(number, dtype=np.int64)
    chosen[-1] = np.argmin(total)
    for k in range(number - 1, 0, -1):
        chosen[k - 1] = before[k, chosen[k]]
    return total[chosen[-1]], chosen
