"""Coverage by simulated annealing over whole flights (Kirkpatrick, Gelatt, Vecchi, Science 1983).

A flight is the sequence of cells from the start to a landing cell; it covers what the camera sees from every cell except the
first. The search keeps how often each target is seen, so that it counts again only what a change affects.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uavbench.planning.changes import propose
from uavbench.planning.distances import Distances, distances_of
from uavbench.planning.flights import Cell, Plan, landing_numbers, pack, unpack
from uavbench.planning.paths import pick
from uavbench.planning.tours import first_flight
from uavbench.planning.turns import turned
from uavbench.planning.views import Views, enter, in_view, leave, views_of
from uavbench.world.city import City, city_of
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_uniform
from uavbench.world.parameters import Coverage
from uavbench.world.scenario import Scenario

LENGTH_PRICE = 0.05  # targets that a move costs in the search: shorter flights leave budget for other moves
HOT, _COLD = 2.0, 0.15
_STOPS = 2_000  # the most places that a tour chooses from
_FEWEST = 0.3  # places from which the camera newly sees a smaller share of its square are left to the search


def search(
    scenario: Scenario,
    target: NDArray[np.float32],
    starts: Sequence[Cell],
    budgets: Sequence[int],
    *,
    seed: int,
    moves: int,
    first: Sequence[Sequence[Cell]] | None = None,
    hot: float = HOT,
    turn_cost: float = 0.0,
    city: City | None = None,
) -> Plan:
    """Search for flights that together cover as many targets as possible.

    Parameters
    ----------
    scenario : Scenario
        A CPP scenario.
    target : ndarray, shape (M, N)
        The target map: cells above 0 are still to cover.
    starts : sequence of (int, int)
        The UAVs' cells. What a UAV sees from there counts only if it hovers there or comes back.
    budgets : sequence of int
        Actions left; each UAV must be able to land with them.
    seed : int
        The search is the same for the same seed, on any machine.
    moves : int
        How many changes are tried.
    first : sequence of flights, optional
        The flights to start from, as in `Plan`; by default shortest paths to the nearest landing cell.
    hot : float
        The initial temperature, in target cells; with a low one, the search only makes small improvements to ``first``.
    turn_cost : float
        How many moves a turn by 90° counts as, in the length of a flight and in what it may take of the budget.
    city : City, optional
        The city; by default the scenario's only one. In a scenario with many cities, give it: agents read ``state.city``.

    Raises
    ------
    ValueError
        When the scenario has many cities and ``city`` is not given.
    """
    city = city or city_of(scenario)
    views = views_of(scenario, target, city)
    cursor = np.array([seed], dtype=np.uint64)
    paths, lengths = pack(city, starts, budgets, first, cursor)
    covered = anneal(
        paths,
        lengths,
        np.array(budgets, dtype=np.int64) - 1,
        distances_of(city),
        city.shape,
        landing_numbers(city),
        views,
        np.flatnonzero(target > 0),
        cursor,
        moves,
        hot,
        turn_cost,
    )
    return Plan(unpack(city, paths, lengths), float(covered))


def first_flights(
    scenario: Scenario,
    target: NDArray[np.float32],
    starts: Sequence[Cell],
    budgets: Sequence[int],
    city: City,
    *,
    seed: int,
    changes: int,
) -> list[list[Cell]]:
    """Return flights for `search` to start from on a large map: tours of places from which the camera sees many targets.

    Each UAV plans for the targets that those before it leave. The parameters are those of `search`; ``changes`` of each tour
    are tried.
    """
    views = views_of(scenario, target, city)
    assert isinstance(scenario.mission, Coverage)
    fewest = _FEWEST * scenario.mission.camera_size**2
    flights: list[list[Cell]] = []
    covered = np.zeros(max(1, int((target > 0).sum())), dtype=np.bool_)
    for start, budget in zip(starts, budgets, strict=True):
        stops, prizes = _cover(views, covered.copy(), fewest)
        best = np.sort(np.argsort(-prizes, kind="stable")[:_STOPS])
        cells = np.stack(np.divmod(stops[best], city.shape[1]), axis=1).astype(np.int32)
        flight = first_flight(city, start, budget, cells, prizes[best], seed, changes)
        for r, c in flight[1:]:
            covered[in_view(views, r * city.shape[1] + c)] = True
        flights.append(flight)
    return flights


@kernel
def _cover(views: Views, covered: NDArray[np.bool_], fewest: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return cells that together see most targets, and how many each adds to those before it: a greedy set cover.

    A cell that adds less than ``fewest`` targets is left out. Marks in ``covered`` the targets that are seen.
    """
    fresh = np.empty(views.cells, dtype=np.int32)  # how many targets each cell adds; what is out of date is too large
    for cell in range(views.cells):
        fresh[cell] = len(in_view(views, cell))
    cells, prizes = [np.int64(0) for _ in range(0)], [0.0 for _ in range(0)]
    for level in range(fresh.max(), 0, -1):
        if level < fewest:
            break
        for cell in range(len(fresh)):
            if fresh[cell] < level:
                continue
            fresh[cell] = 0
            for target in in_view(views, cell):
                fresh[cell] += not covered[target]
            if fresh[cell] == level:
                cells.append(np.int64(cell))
                prizes.append(float(level))
                covered[in_view(views, cell)] = True
                fresh[cell] = 0
    return np.array(cells, dtype=np.int64), np.array(prizes)


@kernel
def anneal(
    paths: NDArray[np.int32],
    lengths: NDArray[np.int64],
    longest: NDArray[np.int64],
    distance: Distances,
    shape: tuple[int, int],
    landing: NDArray[np.int32],
    views: Views,
    targets: NDArray[np.int64],
    cursor: NDArray[np.uint64],
    moves: int,
    hot: float,
    turn_cost: float,
) -> int:
    """Anneal the flights in place (cells 0 to ``lengths`` of each row); return how many targets the best flights cover."""
    counts = np.zeros(max(1, len(targets)), dtype=np.int32)
    covered = 0
    for u in range(len(paths)):
        covered += enter(paths[u], 1, lengths[u] + 1, -1, views, counts)
    value = covered - LENGTH_PRICE * lengths.sum()
    best, best_lengths, best_covered, best_value = paths.copy(), lengths.copy(), covered, value
    new = np.empty(2 * paths.shape[1] + 8 * shape[0] * shape[1], dtype=np.int32)
    tail = np.empty(paths.shape[1], dtype=np.int32)
    temperature, cooling = hot, (_COLD / hot) ** (1.0 / max(1, moves))
    for _ in range(moves):
        temperature *= cooling
        u = pick(cursor, len(paths))
        path, length = paths[u], lengths[u]
        first, after, size = propose(
            path, length, longest[u], distance, shape, landing, targets, counts, False, length + 1, cursor, new
        )
        price = turned(path, length, longest[u], first, after, size, new, shape[1], turn_cost) if size >= 0 else math.inf
        if price == math.inf:
            continue
        grown = length + size - (after - first - 1)
        before = int(path[first]) if first > 0 else -1
        joint = int(new[size - 1]) if size > 0 else before  # the cell after which the old flight goes on
        end = min(after, length) + 1  # cell ``after`` itself comes to view by another way
        change = -leave(path, first + 1, end, before, views, counts)
        change += enter(new, 0, size, before, views, counts) + enter(path, after, end, joint, views, counts)
        gain = change - LENGTH_PRICE * (grown - length + price)
        if gain >= 0.0 or next_uniform(cursor, 0.0, 1.0) < math.exp(gain / temperature):
            rest = length + 1 - after
            tail[:rest] = path[after : length + 1]
            path[first + 1 : first + 1 + size] = new[:size]
            path[first + 1 + size : grown + 1] = tail[:rest]
            lengths[u] = grown
            covered += change
            value += gain
            if value > best_value + 1e-9:
                best_value, best_covered = value, covered
                best[:], best_lengths[:] = paths, lengths
        else:
            leave(new, 0, size, before, views, counts)
            leave(path, after, end, joint, views, counts)
            enter(path, first + 1, end, before, views, counts)
    paths[:], lengths[:] = best, best_lengths
    return best_covered
