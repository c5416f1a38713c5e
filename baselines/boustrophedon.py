"""Boustrophedon: split the targets into zones, sweep each in lanes, order them as a tour. Coverage only.

The textbook pipeline of coverage path planning. A line that sweeps over the map splits what is to be flown over into zones,
wherever it is divided or joined by obstacles or by where targets end (Choset, Coverage of known spaces: the
boustrophedon cellular decomposition, Autonomous Robots 9, 2000). Each zone is swept to and fro in lanes as far apart as the
camera sees, beginning at any of its four corners. The order of the zones and their corners are a generalised travelling
salesman problem (Xie, Carrillo and Jin, An integrated traveling salesman and coverage path planning problem, IEEE Control
Systems Letters 3(1), 2019), solved by local search over flown distances. Of a tour that is too long for the budget those
lanes are dropped that see least for the moves they cost.

A plan is made for lanes along rows and along columns and for every offset of the lanes; the one that covers most is flown.
"""

from functools import lru_cache
from itertools import pairwise

import numpy as np

from uavbench.simulation.missions.coverage import camera_views
from uavbench.world.city import EAST, HOVER, LAND, NORTH, SOUTH, WEST, city_of
from uavbench.world.kernel import kernel


class Agent:
    """Plans at the first decision of an episode, and follows the plan: nothing in coverage is left to chance.

    In here, (r, c) is cell r · N + c on a map of N columns, a set of cells is an integer with a bit for
    each, a lane is the list of its cells in the order in which they are flown over, and a way or a tour is a list of lanes.
    """

    track = "state"

    def __init__(self, scenario):
        if scenario.mission.kind != "coverage" or scenario.team:
            raise ValueError(
                f"boustrophedon is for coverage by one UAV (Manhattan32-CPP-v0 and its like), not for {scenario.id}: "
                "for data harvesting by one UAV there is tsp, for teams planner"
            )
        self._city = city = city_of(scenario)
        self._size = scenario.mission.camera_size
        self._views = _view_sets(camera_views(scenario), self._size)
        self._home = city.distance_to_landing.reshape(-1)
        columns = city.shape[1]
        self._moves = lru_cache(maxsize=4096)(lambda cell: city.distances(divmod(cell, columns)).reshape(-1))
        self._offsets = {HOVER: 0, EAST: 1, WEST: -1, SOUTH: columns, NORTH: -columns}
        self._actions = []

    def reset(self, info):
        """Forget the plan."""
        self._actions = []

    def act(self, observation, info):
        """Return the plan's next action."""
        if not self._actions:
            self._actions = self._plan(info["state"])[::-1]
        return self._actions.pop()

    def _plan(self, state):
        """Return the actions of the plan that covers most."""
        start = state.position[0] * state.city.shape[1] + state.position[1]
        targets = sum(1 << cell for cell in np.flatnonzero(state.target).tolist())
        seen = [view & targets for view in self._views]
        paths = [[start], [start, start]] if state.budget > 1 else [[start]]
        for along_columns in (False, True):
            for offset in range(self._size):
                zones = _decompose(self._lines(start, seen, along_columns, offset))
                tour = self._shorten(start, self._tour(start, zones), state.budget, seen)
                paths.append(self._path(start, tour, seen))
        covered = [_union(seen[cell] for cell in path[1:]).bit_count() for path in paths]  # nothing is at the start
        best = paths[max(range(len(paths)), key=lambda k: (covered[k], -len(paths[k])))]
        actions = {offset: action for action, offset in self._offsets.items()}
        return [actions[after - before] for before, after in pairwise(best)] + [LAND]

    def _lines(self, start, seen, along_columns, offset):
        """Return the lanes on each of the parallel lines, as triples: where on the line they begin and end, and the lane.

        A lane is as much as one can fly over in one go with targets in view, less what shows no more at its ends.
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
            line = grid[min(max(middle, 0), len(grid) - 1)].tolist()  # the outermost may be beyond the map's edge
            for end, cell in enumerate([*line, None]):
                if cell is not None and reachable[cell] and seen[cell]:
                    lane.append(cell)
                elif lane:
                    lanes.append((end - len(lane), end, _trimmed(lane, seen)))
                    lane = []
            lines.append(lanes)
        return lines

    def _ways(self, zone):
        """Return the four ways to sweep a zone: from its first lane or its last, from either end."""
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
        """Return the moves from the beginning of a way to its end."""
        return sum(len(lane) - 1 for lane in way) + sum(self._moves(a[-1])[b[0]] for a, b in pairwise(way))

    def _tour(self, start, zones):
        """Return the tour over all zones."""
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
        """Drop lanes until the tour fits the budget: each time the one that alone sees least per move that it costs."""
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
        """Return the moves from a cell to the beginning of the next lane; home where there is none."""
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
        """Extend a path to where ``moves`` is 0, of the shortest ways by the neighbours that see most."""
        allowed = self._city.action_mask.reshape(-1, LAND + 1)
        while moves[path[-1]] > 0:
            here = path[-1]
            near = [here + offset for action, offset in self._offsets.items() if allowed[here, action]]
            path.append(max((c for c in near if moves[c] < moves[here]), key=lambda cell: seen[cell].bit_count()))


def _decompose(lines):
    """Return the zones, each a list of lanes: a zone goes on as long as one lane of a line faces one of the next."""
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
    """Return the shortest part of a lane from which as much is seen, taking first from its beginning."""
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
    """Return what the camera sees from each cell as a set of cells; ``views`` as of `camera_views`."""
    columns, reach = views.shape[1], size // 2
    sets = []
    for cell, view in enumerate(views.reshape(-1).tolist()):
        r, c = divmod(cell, columns)
        shifted = 0  # by as much as the square of the first cell reaches beyond the map
        for i in range(size):
            shifted |= (view >> i * size & (1 << size) - 1) << (r + i) * columns + c
        sets.append(shifted >> reach * columns + reach)
    return sets


@kernel
def _best_order(first, between, last):
    """Solve the generalised travelling salesman problem by local search: moves of a zone, and 2-opt.

    Parameters
    ----------
    first : ndarray of int32, shape (K, W)
        Moves to get to zone k and sweep it in way w.
    between : ndarray of int32, shape (K, W, K, W)
        Moves to get from the end of a way of one zone to another and to sweep that in one of its ways.
    last : ndarray of int32, shape (K, W)
        Moves from the end of a way of a zone to home.

    Returns
    -------
    order, ways : ndarray of int64, shape (K,)
        The zones in their order, and the way to sweep each.
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
    """Return the order with its zone i moved to place j."""
    rest = np.append(order[:i], order[i + 1 :])
    return np.concatenate((rest[:j], order[i : i + 1], rest[j:]))


@kernel
def _turned(order, i, j):
    """Return the order with the zones from i to j turned around (2-opt)."""
    turned = order.copy()
    turned[i : j + 1] = order[i : j + 1][::-1]
    return turned


@kernel
def _best_ways(order, first, between, last):
    """Return the fewest moves that zones take in this order, and the way to sweep each, by dynamic programming."""
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
