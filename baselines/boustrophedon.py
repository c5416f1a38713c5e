"""Boustrophedon: split the targets into zones, sweep each zone in lanes, and order the zones as a tour. Coverage only.

The textbook method of coverage path planning. A line sweeps over the map. Where obstacles or the ends of the targets split or
join the parts of this line that are to be flown over, new zones begin (Choset, Coverage of known spaces: the boustrophedon
cellular decomposition, Autonomous Robots 9, 2000). Each zone is swept back and forth, beginning at any of its four corners; the
distance between lanes is the width of the camera's view. Choosing the order of the zones and their corners is a generalised
travelling salesman problem (Xie, Carrillo and Jin, An integrated traveling salesman and coverage path planning problem, IEEE
Control Systems Letters 3(1), 2019); it is solved by local search, with the lengths of shortest paths between zones. If a tour
is too long for the budget, the lanes that see the fewest targets per move are dropped.

A plan is made for lanes along rows and along columns, and for every offset of the lanes; the plan that covers most is flown.
"""

from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from uavbench.simulation.missions.coverage import camera_views
from uavbench.world.city import EAST, HOVER, LAND, NORTH, SOUTH, WEST
from uavbench.world.kernel import kernel


class Agent:
    """Plans at the first decision of an episode, and then follows the plan, because nothing random happens in CPP.

    In this class, cell (r, c) of a map with N columns is the number r · N + c, and a set of cells is an integer with one bit
    for each cell. A lane is the list of its cells in the order in which they are flown over. A way through one zone, and a tour
    through all zones, are lists of lanes.
    """

    track = "state"

    def __init__(self, scenario):
        if scenario.mission.kind != "coverage" or scenario.team:
            raise ValueError(
                f"boustrophedon is for coverage by one UAV (Manhattan32-CPP-v0 and its like), not for {scenario.id}: "
                "for data harvesting by one UAV there is tsp, for teams planner"
            )
        self._scenario, self._size = scenario, scenario.mission.camera_size
        self._city: Any = None
        columns = scenario.shape[1]
        self._offsets = {HOVER: 0, EAST: 1, WEST: -1, SOUTH: columns, NORTH: -columns}
        self._actions = []

    def reset(self, info):
        """Forget the plan."""
        self._actions = []

    def _look_at(self, city):
        """Prepare for a city, if it is another one than before."""
        if city is self._city:
            return
        self._city, columns = city, city.shape[1]
        self._views = _view_sets(camera_views(self._scenario, city), self._size)
        self._home = city.distance_to_landing.reshape(-1)
        self._moves = lru_cache(maxsize=4096)(lambda cell: city.distances(divmod(cell, columns)).reshape(-1))

    def act(self, observation, info):
        """Return the plan's next action."""
        if not self._actions:
            self._actions = self._plan(info["state"])[::-1]
        return self._actions.pop()

    def _plan(self, state):
        """Return the actions of the plan that covers most."""
        self._look_at(state.city)
        start = state.position[0] * state.city.shape[1] + state.position[1]
        targets = sum(1 << cell for cell in np.flatnonzero(state.target).tolist())
        seen = [view & targets for view in self._views]
        paths = [[start], [start, start]] if state.budget > 1 else [[start]]
        for along_columns in (False, True):
            for offset in range(self._size):
                zones = _decompose(self._lines(start, seen, along_columns, offset))
                tour = self._shorten(start, self._tour(start, zones), state.budget, seen)
                paths.append(self._path(start, tour, seen))
        covered = [_union(seen[cell] for cell in path[1:]).bit_count() for path in paths]  # a reset covers nothing
        best = paths[max(range(len(paths)), key=lambda k: (covered[k], -len(paths[k])))]
        actions = {offset: action for action, offset in self._offsets.items()}
        return [actions[after - before] for before, after in pairwise(best)] + [LAND]

    def _lines(self, start, seen, along_columns, offset):
        """Return, for each of the parallel lines, its lanes as triples: begin and end on the line, and the lane's cells.

        A lane is a series of adjacent cells that the UAV can reach, and from each of which it sees targets. ``begin`` and
        ``end`` are those of the whole series; the lane leaves out cells at its ends that show no further targets.
        """
        reach = self._size // 2
        reachable = self._moves(start) >= 0
        grid = np.arange(reachable.size).reshape(self._city.shape)
        grid = grid.T if along_columns else grid
        lines = []
        for middle in range(offset - self._size, len(grid) + reach, self._size):
            if middle + reach < 0:
                continue
            lanes, lane = [], []
            line = grid[min(max(middle, 0), len(grid) - 1)].tolist()  # the outermost may lie beyond the edge
            for end, cell in enumerate([*line, None]):
                if cell is not None and reachable[cell] and seen[cell]:
                    lane.append(cell)
                elif lane:
                    lanes.append((end - len(lane), end, _trimmed(lane, seen)))
                    lane = []
            lines.append(lanes)
        return lines

    def _ways(self, zone):
        """Return the four ways to sweep a zone: beginning with its first or its last lane, at either end of that lane."""
        ways = []
        for lanes in (zone, zone[::-1]):
            for first in (lanes[0], lanes[0][::-1]):
                way = [first]
                for lane in lanes[1:]:
                    moves = self._moves(way[-1][-1])
                    way.append(lane if moves[lane[0]] <= moves[lane[-1]] else lane[::-1])
                ways.append(way)
        return ways

    def _length(self, way):
        """Return the number of moves from the beginning of a way to its end."""
        return sum(len(lane) - 1 for lane in way) + sum(self._moves(a[-1])[b[0]] for a, b in pairwise(way))

    def _tour(self, start, zones):
        """Return a short tour through all zones."""
        if not zones:
            return []
        ways = [self._ways(zone) for zone in zones]
        enter = np.array([[way[0][0] for way in four] for four in ways])
        leave = np.array([[way[-1][-1] for way in four] for four in ways])
        within = np.array([[self._length(way) for way in four] for four in ways])
        between = np.array([[self._moves(cell)[enter] for cell in four] for four in leave.tolist()])
        order, chosen = _best_order(self._moves(start)[enter] + within, between + within, self._home[leave])
        return [lane for k, way in zip(order.tolist(), chosen.tolist(), strict=True) for lane in ways[k][way]]

    def _shorten(self, start, tour, budget, seen):
        """Drop lanes until the tour fits the budget: each time the one with the fewest targets of its own per move.

        A lane's own targets are those that no other lane sees.
        """
        views = [_union(seen[cell] for cell in lane) for lane in tour]
        while tour and self._length([[start], *tour]) + self._home[tour[-1][-1]] + 1 > budget:  # + 1 to land
            once = twice = 0
            for view in views:
                twice |= once & view
                once |= view
            values = []
            for before, lane, after, view in zip([[start], *tour], tour, [*tour[1:], None], views, strict=False):
                cost = self._onward(before[-1], lane) + len(lane) - 1 + self._onward(lane[-1], after)
                cost -= self._onward(before[-1], after)
                values.append((view & ~twice).bit_count() / max(cost, 0.5))
            worst = min(range(len(tour)), key=values.__getitem__)
            del tour[worst], views[worst]
        return tour

    def _onward(self, cell, lane):
        """Return the moves from a cell to the beginning of ``lane``, or to a landing zone if ``lane`` is None."""
        return self._home[cell] if lane is None else self._moves(cell)[lane[0]]

    def _path(self, start, tour, seen):
        """Return the cells of a tour from the start to a landing zone."""
        path = [start]
        for lane in tour:
            self._fly(path, self._moves(lane[0]), seen)
            path += lane[1:]
        self._fly(path, self._home, seen)
        return path

    def _fly(self, path, moves, seen):
        """Extend a path to a cell where ``moves`` is 0, as short as possible, each time by the neighbour that sees most."""
        allowed = self._city.action_mask.reshape(-1, LAND + 1)
        while moves[path[-1]] > 0:
            here = path[-1]
            near = [here + offset for action, offset in self._offsets.items() if allowed[here, action]]
            path.append(max((c for c in near if moves[c] < moves[here]), key=lambda cell: seen[cell].bit_count()))


def _decompose(lines):
    """Return the zones, each a list of lanes.

    A zone continues with a lane of the next line if this lane is beside the zone's last lane and both are beside no other.
    """
    zones, previous = [], []
    for lanes in lines:
        current = []
        for begin, end, lane in lanes:
            facing = [(b, e, zone) for b, e, zone in previous if b < end and begin < e]
            goes_on = len(facing) == 1 and sum(facing[0][0] < e and b < facing[0][1] for b, e, _ in lanes) == 1
            zone = facing[0][2] if goes_on else []
            if not goes_on:
                zones.append(zone)
            zone.append(lane)
            current.append((begin, end, zone))
        previous = current
    return zones


def _trimmed(lane, seen):
    """Return the lane without the cells at its beginning, and then at its end, that show no further targets."""
    everything = _union(seen[cell] for cell in lane)
    while len(lane) > 1 and _union(seen[cell] for cell in lane[1:]) == everything:
        lane = lane[1:]
    while len(lane) > 1 and _union(seen[cell] for cell in lane[:-1]) == everything:
        lane = lane[:-1]
    return lane


def _union(sets):
    """Return the union of sets of cells."""
    union = 0
    for each in sets:
        union |= each
    return union


def _view_sets(views, size):
    """Return, for each cell, the set of cells that the camera sees from it; ``views`` are those of `camera_views`."""
    columns, reach = views.shape[1], size // 2
    sets = []
    for cell, view in enumerate(views.reshape(-1).tolist()):
        r, c = divmod(cell, columns)
        shifted = 0  # the set, shifted so that squares that begin before cell 0 fit
        for i in range(size):
            shifted |= (view >> i * size & (1 << size) - 1) << (r + i) * columns + c
        sets.append(shifted >> reach * columns + reach)
    return sets


@kernel
def _best_order(first, between, last):
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
    shortest = _best_ways(order, first, between, last)[0]
    improved = True
    while improved:
        improved = False
        for i in range(len(order)):
            for j in range(len(order)):
                for trial in (_moved(order, i, j), _turned(order, i, j)):
                    length = _best_ways(trial, first, between, last)[0]
                    if length < shortest:
                        shortest, order, improved = length, trial, True
    return order, _best_ways(order, first, between, last)[1]


@kernel
def _moved(order, i, j):
    """Return the order with the zone at position i moved to position j."""
    rest = np.append(order[:i], order[i + 1 :])
    return np.concatenate((rest[:j], order[i : i + 1], rest[j:]))


@kernel
def _turned(order, i, j):
    """Return the order with the zones from position i to position j reversed (2-opt)."""
    turned = order.copy()
    turned[i : j + 1] = order[i : j + 1][::-1]
    return turned


@kernel
def _best_ways(order, first, between, last):
    """Return the fewest moves for a tour in this order, and the way to sweep each zone, by dynamic programming."""
    number, ways = len(order), first.shape[1]
    moves = np.empty((number, ways), dtype=np.int64)
    before = np.zeros((number, ways), dtype=np.int64)
    moves[0] = first[order[0]]
    for k in range(1, number):
        for w in range(ways):
            reached = moves[k - 1] + between[order[k - 1], :, order[k], w]
            before[k, w] = np.argmin(reached)
            moves[k, w] = reached[before[k, w]]
    total = moves[-1] + last[order[-1]]
    chosen = np.empty(number, dtype=np.int64)
    chosen[-1] = np.argmin(total)
    for k in range(number - 1, 0, -1):
        chosen[k - 1] = before[k, chosen[k]]
    return total[chosen[-1]], chosen
