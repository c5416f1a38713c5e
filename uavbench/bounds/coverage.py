"""Upper bound of CPP."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from uavbench.bounds.flow import Network, network, violated_cuts
from uavbench.city import City, city_of
from uavbench.missions.coverage import camera_views
from uavbench.parameters import Coverage
from uavbench.scenario import Scenario

Cell = tuple[int, int]

_ROUNDING = 1e-6  # far more than the sums of the dual bound can lose, far less than the 1 between two values
_VIOLATION = 0.1
_NESTED = 8
_TRUST = 0.6
_PATIENCE = 1
_SLACK = 1e-6
_EDGE = -1
_SOLVER = "simplex"


@dataclass(frozen=True)
class Bound:
    value: int
    cr: float
    method: str
    proved_optimal: bool
    seconds: float = 0.0
    rounds: int = 0
    trivial: int = 0
    raw: float = 0.0


def coverage_bound(
    scenario: Scenario,
    start: Cell,
    budget: int,
    targets: NDArray[Any],
    plan: Sequence[Cell] | None = None,
    seconds: float = 40.0,
    log=None,
) -> Bound:
    began = time.perf_counter()
    problem = _Problem(scenario, start, budget, np.asarray(targets) > 0)
    covered = 0 if plan is None else problem.covered(plan)
    total = int((np.asarray(targets) > 0).sum())
    value, method, rounds, raw = problem.trivial, "trivial", 0, problem.trivial
    if value > covered:
        raw, rounds = _relax(problem, plan, covered, began + seconds, log)
        tight = math.floor(raw + _ROUNDING)
        if tight < value:
            value, method = tight, "lp"
    return Bound(value, value / total if total else 0.0, method, plan is not None and value <= covered,
                 time.perf_counter() - began, rounds, problem.trivial, raw)


class _Problem:
    """Cells, edges and groups of targets.

    Nodes 0 to n − 1 are the cells that one can fly to and be home in time, node n is the root.
    """

    def __init__(self, scenario: Scenario, start: Cell, budget: int, targets: NDArray[np.bool_]) -> None:
        assert isinstance(scenario.mission, Coverage)
        city = city_of(scenario)
        self.budget = budget
        self.start = start
        self.city = city
        away = city.distances(start)
        usable = (away >= 0) & (city.home >= 0) & (away + city.home <= budget - 1)
        if city.no_fly[start]:
            usable[:] = False
        # The start's view counts from the first hover or return on, at the earliest after one action.
        seen = _viewers(camera_views(scenario), scenario.mission.camera_size, targets, usable & (np.maximum(away, 1) + city.home <= budget - 1))
        self.cells = np.argwhere(usable).astype(np.int32)
        self.number = np.full(city.shape, -1, dtype=np.int32)
        self.number[usable] = np.arange(len(self.cells))
        self.views = seen
        groups: dict[tuple[int, ...], int] = {}
        for viewers in seen.values():
            key = tuple(sorted(int(self.number[cell]) for cell in viewers))
            groups[key] = groups.get(key, 0) + 1
        self.groups = list(groups)
        self.weights = np.array([groups[g] for g in self.groups], dtype=np.float64)
        self.trivial = int(self.weights.sum())
        self.landing = [int(self.number[tuple(cell)]) for cell in city.landing_cells.tolist() if usable[tuple(cell)]]
        right = np.stack([self.number[:, :-1].reshape(-1), self.number[:, 1:].reshape(-1)], axis=1)
        down = np.stack([self.number[:-1].reshape(-1), self.number[1:].reshape(-1)], axis=1)
        edges = np.concatenate([right, down])
        self.edges = edges[(edges >= 0).all(axis=1)]

    def covered(self, plan: Sequence[Cell]) -> int:
        visited = set(map(tuple, plan[1:]))
        return sum(not visited.isdisjoint(viewers) for viewers in self.views.values())


def _viewers(views, size, targets, usable) -> dict[Cell, list[Cell]]:
    out: dict[Cell, list[Cell]] = {}
    reach = size // 2
    rows, cols = targets.shape
    for i in range(size):
        for j in range(size):
            bit = np.uint64(i * size + j)
            for r, c in np.argwhere(usable & ((views >> bit) & np.uint64(1) > 0)).tolist():
                cell = (r + i - reach, c + j - reach)
                if targets[cell]:
                    out.setdefault(cell, []).append((r, c))
    return out


class _Program:
    """The linear program.

    Columns: y of the groups, z of the edges, w of the landing cells, and a 1 for the root's edge to the start.
    """

    def __init__(self, problem: _Problem) -> None:
        import highspy

        p = problem
        n, root = len(p.cells), len(p.cells)
        G, E, L = len(p.groups), len(p.edges), len(p.landing)
        self.G, self.E, self.L = G, E, L
        self.ncol = G + E + L + 1
        self.one = self.ncol - 1
        ends = np.concatenate(
            [p.edges, [[root, l] for l in p.landing], [[root, p.number[p.start]]]]
        ).astype(np.int32)
        self.graph = network(n + 1, np.ascontiguousarray(ends))
        self.upper = np.concatenate([np.ones(G), np.full(E, 2.0), np.ones(L), [1.0]])
        self.lower = np.zeros(self.ncol)
        self.lower[self.one] = 1.0
        self.cost = np.zeros(self.ncol)
        self.cost[:G] = p.weights
        self.eps = 0.01
        self.work = self.cost.copy()
        self.work[G:G + E] = -self.eps
        terminals = [*p.groups, *[(l,) for l in p.landing], (int(p.number[p.start]),)]
        self.column = np.array([*range(G), *range(G + E, G + E + L), self.one])
        self.first = np.concatenate([[0], np.cumsum([len(t) for t in terminals])]).astype(np.int32)
        self.members = np.concatenate([np.array(t, dtype=np.int32) for t in terminals])
        self.rows_idx: list[NDArray[np.int32]] = []
        self.rows_val: list[NDArray[np.float64]] = []
        self.age: list[int] = []
        self.keys: list[bytes] = []
        self.known: set[bytes] = set()
        self.budget = p.budget - 1
        h = self.h = highspy.Highs()
        h.setOptionValue("output_flag", False)
        h.setOptionValue("threads", 1)
        h.setOptionValue("presolve", "off")
        h.setOptionValue("solver", _SOLVER); h.setOptionValue("simplex_dual_edge_weight_strategy", _EDGE)
        none = np.zeros(0, dtype=np.int32)
        h.addCols(self.ncol, -self.work, self.lower, self.upper, 0, none, none, np.zeros(0))
        inf = highspy.kHighsInf
        self.inf = inf
        idx = np.concatenate([np.arange(G, G + E), np.arange(G + E, G + E + L)]).astype(np.int32)
        h.addRows(2, np.array([-inf, 1.0]), np.array([self.budget, 1.0], dtype=float), E + L,
                  np.array([0, E], dtype=np.int32), idx, np.ones(E + L))

    def add(self, terminal, inside) -> int:
        G = self.G
        cross = inside[:, self.graph.ends[:, 0]] != inside[:, self.graph.ends[:, 1]]
        new_idx, new_val = [], []
        for t, c in zip(terminal.tolist(), cross, strict=True):
            col = self.column[t]
            edges = np.flatnonzero(c) + G
            key = edges.astype(np.int32).tobytes() + bytes(str(t), "ascii")
            if key in self.known:
                continue
            self.known.add(key)
            val = np.ones(len(edges))
            where = np.flatnonzero(edges == col)
            if len(where):
                val[where] -= 2.0
                idx = edges
            else:
                idx = np.append(edges, col)
                val = np.append(val, -2.0)
            new_idx.append(idx.astype(np.int32))
            new_val.append(val)
            self.keys.append(key)
        if not new_idx:
            return 0
        starts = np.concatenate([[0], np.cumsum([len(i) for i in new_idx])]).astype(np.int32)
        k = len(new_idx)
        self.h.addRows(k, np.zeros(k), np.full(k, self.inf), int(starts[-1]), starts[:-1], np.concatenate(new_idx), np.concatenate(new_val))
        self.rows_idx += new_idx
        self.rows_val += new_val
        self.age += [0] * k
        return k

    def solve(self, limit: float) -> tuple[float, NDArray, bool]:
        import highspy
        h = self.h
        h.setOptionValue("time_limit", max(0.01, limit) + h.getRunTime())
        h.run()
        done = h.getModelStatus() == highspy.HighsModelStatus.kOptimal
        s = h.getSolution()
        x = np.array(s.col_value)
        dual = -np.array(s.row_dual)  # of the minimisation of −cost
        if len(dual) != 2 + len(self.rows_idx):
            return math.inf, x, False
        # maximise: cost x <= cost x + mu (a x) + nu (budget - sum z) + pi (1 - sum w)
        nu = max(0.0, dual[0]) + self.eps; pi = dual[1]
        mu = np.maximum(0.0, -dual[2:])
        d = self.cost.copy()
        d[self.G:self.G + self.E] -= nu
        d[self.G + self.E: self.G + self.E + self.L] -= pi
        if self.rows_idx:
            lens = np.array([len(i) for i in self.rows_idx])
            d += np.bincount(np.concatenate(self.rows_idx), np.concatenate(self.rows_val) * np.repeat(mu, lens), minlength=self.ncol)
        value = nu * self.budget + pi + np.maximum(d * self.lower, d * self.upper).sum()
        self.mu = mu
        slack = np.array(s.row_value)[2:]
        for k, m in enumerate(slack):
            self.age[k] = 0 if m < _SLACK else self.age[k] + 1
        self.obj = -h.getObjectiveValue()
        return value, x, done

    def purge(self, age: int) -> int:
        old = [k for k, a in enumerate(self.age) if a >= age]
        if not old:
            return 0
        self.h.deleteRows(len(old), np.array(old, dtype=np.int32) + 2)
        keep = [k for k, a in enumerate(self.age) if a < age]
        for k in old:
            self.known.discard(self.keys[k])
        self.rows_idx = [self.rows_idx[k] for k in keep]
        self.rows_val = [self.rows_val[k] for k in keep]
        self.age = [self.age[k] for k in keep]
        self.keys = [self.keys[k] for k in keep]
        return len(old)


def _plan_point(problem, program, plan):
    x = np.zeros(program.ncol)
    visited = {int(problem.number[tuple(c)]) for c in plan[1:]}
    x[:program.G] = [not visited.isdisjoint(g) for g in problem.groups]
    which = {tuple(sorted(e)): k for k, e in enumerate(problem.edges.tolist())}
    for a, b in zip(plan[:-1], plan[1:]):
        if a != b:
            x[program.G + which[tuple(sorted((int(problem.number[tuple(a)]), int(problem.number[tuple(b)]))))]] += 1
    x[program.G + program.E + problem.landing.index(int(problem.number[tuple(plan[-1])]))] = 1
    x[-1] = 1
    return x


def _relax(problem, plan, covered, deadline, log):
    program = _Program(problem)
    centre = None if plan is None else _plan_point(problem, program, plan)
    best, rounds = float(problem.trivial), 0
    x = program.upper.copy()
    x[program.G:-1] = 0
    if centre is not None:
        x = _TRUST * x + (1 - _TRUST) * centre
    root = len(problem.cells)
    ts, tl = 0.0, 0.0
    while time.perf_counter() < deadline:
        added = 0
        t0 = time.perf_counter()
        points = [x] if centre is None or rounds == 0 else [_TRUST * x + (1 - _TRUST) * centre, x]
        for point in points:
            t, inside = violated_cuts(program.graph, np.ascontiguousarray(point[program.G:]), root, program.first, program.members,
                                      2 * point[program.column], _VIOLATION, _NESTED)
            added = program.add(t, inside)
            if added:
                break
        ts += time.perf_counter() - t0
        if not added:
            break
        t0 = time.perf_counter()
        value, x, done = program.solve(deadline - time.perf_counter())
        tl += time.perf_counter() - t0
        rounds += 1
        best = min(best, value)
        purged = program.purge(_PATIENCE) if done else 0
        if log:
            log(f"{rounds:3d} added {added:5d} purged {purged:5d} rows {len(program.rows_idx):5d} lp {program.obj:.3f} safe {value:.3f} best {best:.3f} plan {covered} sep {ts:.2f} lp {tl:.2f} {done}")
        if not done or math.floor(best + _ROUNDING) <= covered:
            break
    return best, rounds
