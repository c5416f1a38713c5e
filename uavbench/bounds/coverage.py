"""Upper bound of CPP: a number of covered target cells that no policy can exceed on one episode. Proofs: docs/bounds.md.

The linear program is that of the orienteering problem (Fischetti, Salazar González and Toth, INFORMS J. Comput. 1998). In
place of each customer it has the set of cells that see a target.
"""

import importlib
import itertools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.bounds.flow import cut_rows, network, violated_cuts
from uavbench.simulation.missions.coverage import camera_views
from uavbench.world.city import City, city_of
from uavbench.world.parameters import Coverage
from uavbench.world.scenario import Scenario

Cell = tuple[int, int]

_ROUNDING = 1e-6  # far more than the rounding errors in a bound, far less than the difference of 1 between two values
_SAVING = 0.01  # what each unused move is worth to the solver, so that rounds make progress while everything can be covered
_VIOLATION = 0.1  # by how much a cut must be violated
_NESTED = 3  # pairs of cuts, one around the other, that are sought for a group in each round
_MEMORY, _SMOOTHING = 0.5, 0.9  # the weight of older solutions in their mean, and of this mean where cuts are sought
_TRUST = 0.8  # the weight of that point against the point of the plan: cuts found between the two are deeper


@dataclass(frozen=True)
class Bound:
    """An upper bound for all policies on one episode of CPP.

    Attributes
    ----------
    value : int
        Target cells: a policy that lands cannot cover more.
    cr : float
        The same as a fraction of all target cells. CRAL cannot exceed it, either.
    method : {"reach", "cuts"}
        What gave the bound: the cells within reach, or the linear program.
    proved_optimal : bool
        Whether the plan (without a plan: landing at once) covers as much as the bound and is therefore optimal.
    rounds : int
        The number of linear programs solved.
    """

    value: int
    cr: float
    method: str
    proved_optimal: bool
    rounds: int


def coverage_bound(
    scenario: Scenario,
    start: Cell,
    budget: int,
    targets: NDArray[Any],
    plan: Sequence[Cell] | None = None,
    seconds: float = 40.0,
    city: City | None = None,
) -> Bound:
    """Return an upper bound of the target cells that a policy which lands can cover.

    Parameters
    ----------
    scenario : Scenario
        A CPP scenario for one UAV.
    start : (int, int)
        The landing cell where the episode starts.
    budget : int
        Its movement budget, landing included.
    targets : ndarray, shape (M, N)
        Non-zero where a cell is a target.
    plan : sequence of (int, int), optional
        A possible flight: the start, and the cell after every action except the last one, which lands. The bound is valid for
        any plan. With a good plan it is better, and the computation stops as soon as the plan is proved optimal.
    seconds : float
        Processor time to spend, so that bounds are not worse on a busy machine. The bound is valid whenever it stops.
    city : City, optional
        The city; by default the scenario's only one. In a scenario with many cities, give it: agents read ``state.city``.

    Raises
    ------
    ValueError
        When the plan is not a flight of this episode, or the scenario has many cities and ``city`` is not given.
    ImportError
        When highspy is missing, which the extra ``planning`` installs.

    Notes
    -----
    The camera covers from a cell p at the earliest after max(d(start, p), 1) actions, where d is the number of moves. From p
    the UAV then needs the moves to the nearest landing cell and one action to land. Targets that are seen only from cells for
    which the budget is too small cannot be covered; this gives the bound by reach. The bound by cuts maximises the covered
    targets over relaxed flights. With y (whether a group of targets seen from the same cells V is covered), z (how often an
    edge between cells is flown, in either direction) and w (whether the flight ends in a landing cell)::

        maximise    Σ weight y
        subject to  Σ z ≤ budget − 1,  Σ w = 1,  0 ≤ y, w ≤ 1,  0 ≤ z ≤ 2
                    z(δS) + w(S) + [start in S] ≥ 2 y   for every group and every set of cells S that contains V
                    z(δS) + w(S) + [start in S] ≥ 2 w   for every landing cell and every set of cells S that contains it
                    z(δS) + w(S) + [start in S] ≥ 2     for every set of cells S that contains the start

    Here δS are the edges with one end in S, and [start in S] is 1 if S contains the start, else 0. With one more node, the
    root, that is joined to the start and to the cell where the flight ends, a flight is a closed walk. If it visits S, which
    does not contain the root, it enters and leaves S, so it crosses the border of S at least twice. Every flight therefore
    satisfies all constraints, and the optimum is an upper bound. The last three lines are the cuts. They are added when they
    are violated; a missing cut only makes the bound weaker. The function does not return the solver's optimum, but computes
    the value of its dual solution again: any multipliers of the right sign give a valid bound, whatever the tolerances of the
    solver are and wherever it was stopped.
    """
    deadline = time.process_time() + seconds
    mask = np.asarray(targets) != 0
    problem = _Problem(scenario, city or city_of(scenario), start, budget, mask)
    covered = 0 if plan is None else problem.covered(plan)
    value, method, rounds = int(problem.weights.sum()), "reach", 0
    if value > covered:
        relaxed, rounds = _relax(problem, plan, covered, deadline)
        if relaxed < value:
            value, method = relaxed, "cuts"
    return Bound(value, value / max(int(mask.sum()), 1), method, value == covered, rounds)


class _Problem:
    """An episode as a graph. Its nodes are the cells that a UAV can visit and still land in time, numbered row by row.

    Attributes
    ----------
    number : ndarray of int32, shape (M, N)
        The node of a cell; −1 where there is none.
    edges : ndarray of int32, shape (E, 2)
        Pairs of nodes whose cells are neighbours.
    landing : list of int
        Nodes in landing zones.
    groups : list of tuple of int
        For each group of targets the nodes that see them; all targets of a group are seen from the same nodes.
    weights : ndarray of float64, shape (G,)
        The number of targets in each group.
    """

    def __init__(self, scenario: Scenario, city: City, start: Cell, budget: int, targets: NDArray[np.bool_]) -> None:
        assert isinstance(scenario.mission, Coverage)
        self._city = city
        self.start, self.budget = start, budget
        away = city.distances(start)
        usable = (away >= 0) & (city.distance_to_landing >= 0) & (away + city.distance_to_landing <= budget - 1)
        self.nodes = int(usable.sum())
        self.number = np.full(city.shape, -1, dtype=np.int32)
        self.number[usable] = np.arange(self.nodes)
        pairs = [(self.number[:, :-1], self.number[:, 1:]), (self.number[:-1], self.number[1:])]
        edges = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in pairs])
        self.edges: NDArray[np.int32] = edges[(edges >= 0).all(axis=1)]
        self.landing: list[int] = self.number[city.landing & usable].tolist()
        # Nothing is covered at the reset: to see from its start, the UAV hovers there or comes back.
        viewing = usable & (np.maximum(away, 1) + city.distance_to_landing <= budget - 1)
        sizes: dict[tuple[int, ...], int] = {}
        for viewers in self._viewers(camera_views(scenario, city), scenario.mission.camera_size, viewing, targets):
            sizes[viewers] = sizes.get(viewers, 0) + 1
        self.groups = list(sizes)
        self.weights = np.array(list(sizes.values()), dtype=np.float64)

    def _viewers(
        self, views: NDArray[np.uint64], size: int, viewing: NDArray[np.bool_], targets: NDArray[np.bool_]
    ) -> list[tuple[int, ...]]:
        """Return for every target that is seen from any of the cells ``viewing`` the nodes of those cells."""
        viewers: dict[tuple[int, int], list[int]] = {}
        for bit in range(size * size):
            down, right = bit // size - size // 2, bit % size - size // 2
            seeing = viewing & ((views >> np.uint64(bit)) & np.uint64(1) > 0)
            for r, c in np.argwhere(seeing).tolist():
                if targets[r + down, c + right]:
                    viewers.setdefault((r + down, c + right), []).append(int(self.number[r, c]))
        return [tuple(sorted(viewers[cell])) for cell in sorted(viewers)]

    def path(self, plan: Sequence[Cell]) -> list[int]:
        """Return the nodes of a plan; raise a ValueError if it is not a flight of this episode."""
        city = self._city
        if not plan or tuple(plan[0]) != tuple(self.start):
            raise ValueError(f"plan: it does not begin at the start, {self.start}")
        if len(plan) > self.budget:
            raise ValueError(f"plan: {len(plan) - 1} actions and a landing exceed the budget, {self.budget}")
        for r, c in plan:
            if not (0 <= r < city.shape[0] and 0 <= c < city.shape[1]) or city.no_fly[r, c]:
                raise ValueError(f"plan: the cell {(r, c)} is off the map or a no-fly cell")
        for (r, c), (y, x) in itertools.pairwise(plan):
            if abs(r - y) + abs(c - x) > 1:
                raise ValueError(f"plan: {(y, x)} is not one move from {(r, c)}")
        if not city.landing[plan[-1][0], plan[-1][1]]:
            raise ValueError(f"plan: it ends at {tuple(plan[-1])}, which is not a landing cell")
        return [int(self.number[r, c]) for r, c in plan]

    def covered(self, plan: Sequence[Cell]) -> int:
        """Return how many targets a plan covers."""
        return int(self.weights @ self.seen(self.path(plan)))

    def seen(self, path: list[int]) -> NDArray[np.bool_]:
        """Return which groups of targets a path covers."""
        visited = set(path[1:])
        return np.array([not visited.isdisjoint(viewers) for viewers in self.groups], dtype=np.bool_)


class _Program:
    """The linear program, with the cuts found so far.

    Its columns are y of the G groups, z of the E edges, w of the landing cells, and a last column that is always 1, for the
    edge from the root to the start. The columns z, w and the last one are the edges of a graph: that of the problem, with the
    root as one more node. The rows are the budget, Σ w = 1, and the cuts.

    Attributes
    ----------
    terminal : ndarray of int64, shape (T,)
        The columns that have cuts: the groups, the landing cells, and the last column (the start).
    """

    def __init__(self, problem: _Problem) -> None:
        groups, edges, landing = len(problem.groups), len(problem.edges), len(problem.landing)
        self._problem, self._moves = problem, problem.budget - 1
        self._z, self._w = slice(groups, groups + edges), slice(groups + edges, groups + edges + landing)
        self._columns = groups + edges + landing + 1
        self._root, start = problem.nodes, int(problem.number[problem.start])
        rooted = [[self._root, node] for node in [*problem.landing, start]]
        self._graph = network(problem.nodes + 1, np.concatenate([problem.edges, np.array(rooted, dtype=np.int32)]))
        terminals: list[tuple[int, ...]] = [*problem.groups, *((node,) for node in problem.landing), (start,)]
        self._first = np.cumsum([0, *map(len, terminals)], dtype=np.int32)
        self._members = np.concatenate([np.array(nodes, dtype=np.int32) for nodes in terminals])
        self.terminal = np.array([*range(groups), *range(self._w.start, self._columns)])

        self._value = np.zeros(self._columns)
        self._value[:groups] = problem.weights
        self._lower, self._upper = np.zeros(self._columns), np.ones(self._columns)
        self._lower[-1], self._upper[self._z] = 1.0, 2.0
        self._cuts: list[tuple[NDArray[np.int32], NDArray[np.float64]]] = []  # columns and coefficients
        self._highs = self._solver()

    def _solver(self) -> Any:
        """Return a HiGHS model without cuts; it minimises."""
        try:
            highspy: Any = importlib.import_module("highspy")
        except ImportError as error:
            raise ImportError("the bound needs highspy: pip install 'uavbench[planning]'") from error
        highs = highspy.Highs()
        for option, value in {"output_flag": False, "threads": 1, "presolve": "off", "solver": "simplex"}.items():
            highs.setOptionValue(option, value)
        self._infinity, self._optimal = highspy.kHighsInf, highspy.HighsModelStatus.kOptimal
        cost = -self._value
        cost[self._z] = _SAVING
        none = np.zeros(0, dtype=np.int32)
        highs.addCols(self._columns, cost, self._lower, self._upper, 0, none, none, np.zeros(0))
        most, least = np.array([self._moves, 1.0]), np.array([-self._infinity, 1.0])
        columns = np.arange(self._z.start, self._w.stop, dtype=np.int32)
        begin = np.array([0, self._w.start - self._z.start], dtype=np.int32)
        highs.addRows(2, least, most, len(columns), begin, columns, np.ones(len(columns)))
        return highs

    def first_point(self) -> NDArray[np.float64]:
        """Return the point with which everything is covered without a move: it violates many cuts."""
        point = np.zeros(self._columns)
        point[: self._z.start] = point[-1] = 1.0
        return point

    def point_of(self, plan: Sequence[Cell]) -> NDArray[np.float64]:
        """Return the values of the columns for a plan: a point that satisfies all cuts."""
        problem, point = self._problem, np.zeros(self._columns)
        path = problem.path(plan)
        point[: self._z.start] = problem.seen(path)
        column = {(a, b): self._z.start + e for e, (a, b) in enumerate(problem.edges.tolist())}
        for a, b in itertools.pairwise(path):
            if a != b:
                point[column[min(a, b), max(a, b)]] += 1.0
        point[self._w.start + problem.landing.index(path[-1])] = point[-1] = 1.0
        return point

    def add_violated(self, point: NDArray[np.float64]) -> int:
        """Add cuts that ``point`` violates; return how many."""
        demand = 2 * point[self.terminal]
        capacity = point[self._z.start :].copy()
        which, inside = violated_cuts(
            self._graph, capacity, self._root, self._first, self._members, demand, _VIOLATION, _NESTED
        )
        if not len(which):
            return 0
        terminal = self.terminal[which]
        groups = terminal < self._z.start
        # Groups with the same set share one row, the mean of their rows by weight. Landing cells and the start have their own.
        apart = np.where(groups, 0, terminal).astype(np.int32)[:, None].view(np.uint8)
        sets = np.concatenate([np.packbits(inside, axis=1), apart], axis=1)
        _, kept, row = np.unique(sets, axis=0, return_index=True, return_inverse=True)
        row = row.reshape(-1)  # in NumPy 2.0 it has as many dimensions as ``sets``
        count, order = len(kept), np.argsort(row, kind="stable")
        weight = np.where(groups, self._value[terminal], 1.0)
        share = weight / np.bincount(row, weight)[row]
        first = np.searchsorted(row[order], np.arange(count + 1))
        begin, columns, values = cut_rows(self._graph.ends, inside[kept], self._z.start, first, terminal[order], share[order])
        self._highs.addRows(count, np.zeros(count), np.full(count, self._infinity), len(columns), begin[:-1], columns, values)
        self._cuts += zip(np.split(columns, begin[1:-1]), np.split(values, begin[1:-1]), strict=True)
        return count

    def solve(self, seconds: float) -> tuple[float, NDArray[np.float64] | None]:
        """Solve for at most ``seconds``; return a valid bound, and the optimal point, or None if the solver did not finish."""
        highs = self._highs
        highs.setOptionValue("time_limit", highs.getRunTime() + max(seconds, 0.01))
        highs.run()
        solution = highs.getSolution()
        duals = np.array(solution.row_dual, dtype=np.float64)
        bound = self._dual_bound(duals) if len(duals) == 2 + len(self._cuts) else math.inf
        if highs.getModelStatus() != self._optimal:
            return bound, None
        self._drop(np.array(solution.row_value)[2:] > _ROUNDING)
        return bound, np.array(solution.col_value)

    def _dual_bound(self, duals: NDArray[np.float64]) -> float:
        """Return the bound of weak duality: the rows are moved into the objective, and only the columns' bounds remain.

        For multipliers ν ≥ 0 of the budget, π of Σ w = 1 and μ ≥ 0 of the cuts a·x ≥ 0, every x that satisfies the rows has
        value(x) ≤ value(x) + ν (b − 1 − Σ z) + π (1 − Σ w) + Σ μ a·x. Here value(x) does not include what unused moves are
        worth to the solver (``_SAVING``); this is added to the multiplier of the budget instead.
        """
        budget, landing, cuts = max(0.0, -duals[0]) + _SAVING, -duals[1], np.maximum(duals[2:], 0.0)
        reduced = self._value.copy()
        reduced[self._z] -= budget
        reduced[self._w] -= landing
        if self._cuts:
            columns = np.concatenate([columns for columns, _ in self._cuts])
            values = np.concatenate([values for _, values in self._cuts])
            repeated = np.repeat(cuts, [len(columns) for columns, _ in self._cuts])
            reduced += np.bincount(columns, values * repeated, minlength=self._columns)
        return float(budget * self._moves + landing + np.maximum(reduced * self._lower, reduced * self._upper).sum())

    def _drop(self, loose: NDArray[np.bool_]) -> None:
        """Delete the cuts that are ``loose``: without them the optimum is the same, and is found faster."""
        rows = np.flatnonzero(loose)
        if len(rows):
            self._highs.deleteRows(len(rows), (rows + 2).astype(np.int32))
            self._cuts = [cut for cut, gone in zip(self._cuts, loose.tolist(), strict=True) if not gone]


def _relax(problem: _Problem, plan: Sequence[Cell] | None, covered: int, deadline: float) -> tuple[int, int]:
    """Return the bound by cuts and the number of linear programs solved; stop when the plan covers as much as the bound."""
    program = _Program(problem)
    centre = None if plan is None else program.point_of(plan)
    point: NDArray[np.float64] | None = program.first_point()
    mean = program.first_point()
    best, rounds = float(problem.weights.sum()), 0
    while point is not None and time.process_time() < deadline and math.floor(best + _ROUNDING) > covered:
        mean = _MEMORY * mean + (1 - _MEMORY) * point
        smooth = _SMOOTHING * mean + (1 - _SMOOTHING) * point
        points = [smooth, point] if centre is None else [_TRUST * each + (1 - _TRUST) * centre for each in (smooth, point)]
        points.append(point)
        if not any(program.add_violated(each) for each in points):
            break
        bound, point = program.solve(deadline - time.process_time())
        best, rounds = min(best, bound), rounds + 1
    return math.floor(best + _ROUNDING), rounds
