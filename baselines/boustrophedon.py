"""Boustrophedon: split the targets into zones, sweep each zone in lanes, and order the zones as a tour. Coverage only.

The textbook method of coverage path planning. A line sweeps over the map. Where obstacles or the ends of the targets split or
join the parts of this line that are to be flown over, new zones begin (Choset, Coverage of known spaces: the boustrophedon
cellular decomposition, Autonomous Robots 9, 2000). Each zone is swept back and forth, beginning at any of its four corners; the
distance between lanes is the width of the camera's view. Choosing the order of the zones and their corners is a generalised
travelling salesman problem (Xie, Carrillo and Jin, An integrated traveling salesman and coverage path planning problem, IEEE
Control Systems Letters 3(1), 2019); it is solved by local search, with the lengths of shortest paths between zones. On large
maps with many zones, only those are ordered that see most targets per move, as many as the budget suffices for. If a tour is
too long for the budget, the lanes that see the fewest targets per move are dropped.

A plan is made for lanes along rows and along columns, and for every offset of the lanes; the plan that covers most is flown.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from uavbench.planning.shortest import grid_of, moves_between
from uavbench.planning.zone_tours import Field, Zones, tour_within, whole_tour
from uavbench.simulation.missions.coverage import camera_gain, camera_views
from uavbench.world.city import EAST, HOVER, LAND, NORTH, SOUTH, WEST
from uavbench.world.kernel import kernel

FEW_ZONES = 50  # that are ordered all; this takes seconds already


class Agent:
    """Plans at the first decision of an episode, and then follows the plan, because nothing random happens in CPP.

    In this class, cell (r, c) of a map with N columns is the number r · N + c. A lane is an array of its cells in the order in
    which they are flown over. A way through one zone, and a tour through all zones, are lists of lanes.
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
        self._city, self._grid = city, grid_of(city)
        self._home = city.distance_to_landing.reshape(-1)

    def act(self, observation, info):
        """Return the plan's next action."""
        if not self._actions:
            self._actions = self._plan(info["state"])[::-1]
        return self._actions.pop()

    def _plan(self, state):
        """Return the actions of the plan that covers most."""
        city = state.city
        self._look_at(city)
        start = state.position[0] * city.shape[1] + state.position[1]
        views = camera_views(self._scenario, city)
        self._sight = Sight(_targets_in_view(views, self._size, state.target > 0), self._size, np.zeros(city.shape, np.int32))
        self._gain = camera_gain(self._scenario, state.target, city).reshape(-1)
        wanted = (city.distances(state.position) >= 0) & (self._gain.reshape(city.shape) > 0)
        paths = [[start], [start, start]] if state.budget > 1 else [[start]]
        for along_columns in (False, True):
            for offset in range(self._size):
                zones = _decompose(self._lines(wanted, along_columns, offset))
                tour = self._shorten(start, self._tour(start, zones, state.budget), state.budget)
                paths.append(self._path(start, tour))
        covered = [_covered(path[1:], self._sight) for path in paths]  # a reset covers nothing
        best = paths[max(range(len(paths)), key=lambda k: (covered[k], -len(paths[k])))]
        actions = {offset: action for action, offset in self._offsets.items()}
        return [actions[after - before] for before, after in pairwise(best)] + [LAND]

    def _lines(self, wanted, along_columns, offset):
        """Return, for each of the parallel lines, its lanes as triples: begin and end on the line, and the lane's cells.

        A lane is a series of adjacent cells that are ``wanted``: the UAV can reach them, and sees targets from each of them.
        ``begin`` and ``end`` are those of the whole series; the lane leaves out cells at its ends that show no further targets.
        """
        reach = self._size // 2
        grid = np.arange(wanted.size).reshape(wanted.shape)
        grid, wanted = (grid.T, wanted.T) if along_columns else (grid, wanted)
        lines = []
        for middle in range(offset - self._size, len(grid) + reach, self._size):
            if middle + reach < 0:
                continue
            line = min(max(middle, 0), len(grid) - 1)  # the outermost may lie beyond the edge
            edges = np.flatnonzero(np.diff(wanted[line].astype(np.int8), prepend=0, append=0)).reshape(-1, 2).tolist()
            lines.append(
                [(begin, end, _trimmed(np.ascontiguousarray(grid[line, begin:end]), self._sight)) for begin, end in edges]
            )
        return lines

    def _moves(self, here, there):
        """Return the number of moves between two cells."""
        return moves_between(self._grid, here, there)

    def _ways(self, zone):
        """Return the four ways to sweep a zone: beginning with its first or its last lane, at either end of that lane."""
        ways = []
        for lanes in (zone, zone[::-1]):
            for first in (lanes[0], lanes[0][::-1]):
                way = [first]
                for lane in lanes[1:]:
                    last = way[-1][-1]
                    way.append(lane if self._moves(last, lane[0]) <= self._moves(last, lane[-1]) else lane[::-1])
                ways.append(way)
        return ways

    def _length(self, way):
        """Return the number of moves from the beginning of a way to its end."""
        return sum(len(lane) - 1 for lane in way) + sum(self._moves(a[-1], b[0]) for a, b in pairwise(way))

    def _tour(self, start, zones, budget):
        """Return a short tour through all zones, or, if there are many, through as many of them as the budget suffices for."""
        if not zones:
            return []
        ways = [self._ways(zone) for zone in zones]
        table = Zones(
            np.array([[way[0][0] for way in four] for four in ways]),
            np.array([[way[-1][-1] for way in four] for four in ways]),
            np.array([[self._length(way) for way in four] for four in ways]),
            np.array([_covered(np.concatenate(zone), self._sight) for zone in zones]),
        )
        field = Field(self._city, self._grid, start)
        few = len(zones) <= FEW_ZONES
        order, chosen = whole_tour(field, table) if few else tour_within(field, table, budget - 1)  # one action is for landing
        return [lane for k, way in zip(order.tolist(), chosen.tolist(), strict=True) for lane in ways[k][way]]

    def _shorten(self, start, tour, budget):
        """Drop lanes until the tour fits the budget: each time the one with the fewest targets of its own per move.

        A lane's own targets are those that no other lane sees.
        """
        length = self._length([[start], *tour]) + self._home[tour[-1][-1] if tour else start] + 1  # + 1 to land
        costs = [self._cost(start, tour, k) for k in range(len(tour))]
        while tour and length > budget:
            own = _own_targets(np.concatenate(tour), np.cumsum([len(lane) for lane in tour]), self._sight)
            worst = int(np.argmin(own / np.maximum(costs, 0.5)))
            length -= costs[worst]
            del tour[worst], costs[worst]
            for k in range(max(worst - 1, 0), min(worst + 1, len(tour))):
                costs[k] = self._cost(start, tour, k)
        return tour

    def _cost(self, start, tour, k):
        """Return the number of moves that a tour saves without its lane ``k``."""
        lane = tour[k]
        before = tour[k - 1][-1] if k else start
        after = tour[k + 1][0] if k + 1 < len(tour) else None
        return self._moves(before, lane[0]) + len(lane) - 1 + self._onward(lane[-1], after) - self._onward(before, after)

    def _onward(self, cell, goal):
        """Return the number of moves from a cell to another one, or to a landing zone if ``goal`` is None."""
        return self._home[cell] if goal is None else self._moves(cell, goal)

    def _path(self, start, tour):
        """Return the cells of a tour from the start to a landing zone."""
        path = [start]
        for lane in tour:
            self._fly(path, int(lane[0]))
            path += lane[1:].tolist()
        self._fly(path, None)
        return path

    def _fly(self, path, goal):
        """Extend a path to a cell, or to a landing zone, as short as possible, each time by the neighbour that sees most."""
        allowed = self._city.action_mask.reshape(-1, LAND + 1)
        for left in range(self._onward(path[-1], goal) - 1, -1, -1):
            near = [path[-1] + offset for action, offset in self._offsets.items() if allowed[path[-1], action]]
            path.append(max((c for c in near if self._onward(c, goal) == left), key=self._gain.__getitem__))


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


class Sight(NamedTuple):
    """What is seen, and how often.

    Attributes
    ----------
    targets : ndarray of uint64, shape (M, N)
        The targets that the camera sees from each cell, as bits like those of `camera_views`.
    size : int
        The width of the camera's view.
    counts : ndarray of int32, shape (M, N)
        How often each target is seen from some cells. All are 0 except while a function of this file runs.
    """

    targets: np.ndarray
    size: int
    counts: np.ndarray


@kernel
def _targets_in_view(views, size, target):
    """Return the views of the camera without the cells that are no targets."""
    seen, reach = np.zeros_like(views), size // 2
    for r in range(views.shape[0]):
        for c in range(views.shape[1]):
            for bit in range(size * size):
                one = np.uint64(1) << np.uint64(bit)
                if views[r, c] & one and target[r + bit // size - reach, c + bit % size - reach]:
                    seen[r, c] |= one
    return seen


@kernel
def _count(cells, sight, by):
    """Add ``by``, 1 or −1, to the counts of targets, once for each cell that sees them; return how many become or were 0."""
    columns, reach, changed = sight.targets.shape[1], sight.size // 2, 0
    for cell in cells:
        view = sight.targets[cell // columns, cell % columns]
        for y in range(cell // columns - reach, cell // columns + reach + 1):
            for x in range(cell % columns - reach, cell % columns + reach + 1):
                if view & np.uint64(1):
                    changed += (sight.counts[y, x] == 0) + (sight.counts[y, x] + by == 0)
                    sight.counts[y, x] += by
                view >>= np.uint64(1)
    return changed


def _covered(path, sight):
    """Return how many targets are seen from the cells of a path."""
    cells = np.asarray(path, dtype=np.int64)
    covered = _count(cells, sight, 1)
    _count(cells, sight, -1)
    return covered


@kernel
def _trimmed(lane, sight):
    """Return the lane without the cells at its beginning, and then at its end, that show no further targets."""
    _count(lane, sight, 1)
    first, end = 0, len(lane)
    while end - first > 1 and _spare(lane[first : first + 1], sight):
        first += 1
    while end - first > 1 and _spare(lane[end - 1 : end], sight):
        end -= 1
    _count(lane[first:end], sight, -1)
    return lane[first:end]


@kernel
def _spare(cells, sight):
    """Take the cells out of the counts if every target is still seen without them; return whether it is."""
    lost = _count(cells, sight, -1)
    if lost > 0:
        _count(cells, sight, 1)
    return lost == 0


@kernel
def _own_targets(cells, ends, sight):
    """Return how many targets each lane sees that no other one sees; the lanes are parts of ``cells`` that end at ``ends``."""
    own, begin = np.empty(len(ends), dtype=np.int64), 0
    _count(cells, sight, 1)
    for k in range(len(ends)):
        lane = cells[begin : ends[k]]
        own[k] = _count(lane, sight, -1)
        _count(lane, sight, 1)
        begin = ends[k]
    _count(cells, sight, -1)
    return own
