"""Upper bound of DH: an amount of data that no policy can exceed in expectation on one episode. Proofs: docs/bounds.md.

The data of each device have a price in every cell: low near the device, high far from it. Any prices give a valid bound, which
is computed as a longest path in the graph of time and cells; good prices are found by gradient descent.
"""

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavbench.bounds.prices import Graph, fill_gains, fill_gradient, fill_rates, fill_yields, fly, longest
from uavbench.simulation.missions.channel import channel_of
from uavbench.world.city import EAST, HOVER, OFFSETS, SOUTH, City, city_of
from uavbench.world.parameters import Harvesting
from uavbench.world.scenario import Scenario

Cell = tuple[int, int]

_ROUNDING = 1e-9  # relative: far more than the rounding error in sums of some thousand positive numbers
_NORMALS = np.array([-3.0, -2.0, -1.25, -0.5, 0.25, 1.0, 1.75, 2.5, 3.5, 6.0])  # values that stand for a normal variable

# Parameters of the descent. The pairs are values in the first and the last round; in between they fall geometrically.
_TEMPERATURE = (1.0, 0.02)  # data units: flights that are worse than the best by about this much still count
_BEND = (0.02, 0.0005)  # the charge for a smaller fall of the price is a parabola, which makes the charge smooth
_STEP = (0.01, 0.0005)
_CELLS = 0.3  # the step of a cell's own part of the price, relative to the step of the part that depends on the distance
_MEAN, _SQUARE = 0.9, 0.98  # β₁ and β₂ of Adam
_EVERY = 10  # rounds between two evaluations of the bound
_HOPELESS = 1.2  # a bound of more than 1.2 times all data after a third of the rounds hardly ever falls below all data
_RINGS = np.array([0, 1, 2, 3, 4, 5, 6, 8, 10, 13, 17, 22, 30, 45, 200])  # moves from a device
_RISE = 0.03  # how much the price rises at the beginning from each of the first _STEEP rings to the next
_STEEP = 8


@dataclass(frozen=True)
class Bound:
    """An upper bound for all policies on one episode of DH, on average over the fading.

    Attributes
    ----------
    value : float
        Data units: a policy that lands cannot collect more on average.
    cr : float
        The same as a fraction of all data. The mean of CRAL cannot exceed it, either.
    method : {"data", "rates", "prices"}
        What gave the bound: all data there are, the rates on a flight without regard to the data left, or prices.
    rounds : int
        The number of rounds of the descent.
    """

    value: float
    cr: float
    method: str
    rounds: int


def harvesting_bound(
    scenario: Scenario,
    start: Cell,
    budget: int,
    devices: NDArray[np.int32],
    data: NDArray[np.float64],
    planned: float = 0.0,
    rounds: int = 600,
    seconds: float = math.inf,
    city: City | None = None,
) -> Bound:
    """Return an upper bound of the data that a policy which lands can collect, on average over the fading.

    Parameters
    ----------
    scenario : Scenario
        A DH scenario for one UAV.
    start : (int, int)
        The landing cell where the episode starts.
    budget : int
        Its movement budget, landing included.
    devices : ndarray of int, shape (K, 2)
        The devices' cells.
    data : ndarray of float, shape (K,)
        The data units of each device.
    planned : float, optional
        Data units that are known to be possible. The bound is valid for any value; the descent stops when the bound is as low.
    rounds : int
        The number of rounds of the descent. More rounds give a better bound.
    seconds : float
        Processor time to spend. The bound is valid whenever it stops.
    city : City, optional
        The city; by default the scenario's only one. In a scenario with many cities, give it: agents read ``state.city``.

    Raises
    ------
    ValueError
        When the scenario has many cities and ``city`` is not given.

    Notes
    -----
    Let s be the start, D_d the data of device d, and R_d its rate in a communication step at a position, which is random.
    Let u_d(c) ∈ [0, 1] be the price of a data unit of device d in cell c. For any prices, no policy can collect more on average
    than ::

        Σ D_d (1 − u_d(s)) + max over flights of Σ over their actions, from cell p to cell q, of
            Σ D_d max(0, u_d(p) − u_d(q)) + Σ over the communication steps of E max_d min(u_d(p), u_d(q)) R_d

    because a data unit that is served in an action from p to q counts with the price min(u_d(p), u_d(q)), and the difference
    between this price and 1 is charged for all D_d units: 1 − u_d(s) at the start, and the rest where u_d falls on the flight.
    The maximum is a longest path in the graph of time and cells, found by dynamic programming. A smooth version of the bound is
    minimised over the prices by Adam (Kingma and Ba, ICLR 2015).
    """
    deadline = time.process_time() + seconds
    data = np.asarray(data, dtype=np.float64)
    total = float(data.sum())
    value, method, used = total, "data", 0
    if planned >= total:
        return Bound(value, 1.0, method, used)
    there = city or city_of(scenario)
    problem = _Problem(scenario, there, start, budget, np.asarray(devices, dtype=np.int32), data)
    problem.look_at(np.ones(problem.rings.shape[:2]))
    unlimited = problem.bound()
    if unlimited < value:
        value, method = unlimited, "rates"
    if planned < value:
        best, used = _descend(problem, planned, rounds, deadline)
        if best < value:
            value, method = best, "prices"
    return Bound(value, min(value / total, 1.0), method, used)


class _Problem:
    """An episode: a graph, the rates at each position, and arrays that every round fills again.

    Attributes
    ----------
    graph : Graph
        The cells that a flight can visit.
    data : ndarray of float64, shape (K,)
        Data units of each device.
    rings : ndarray of float64, shape (n, K, G)
        For each of n cells and K devices a 1, and then for each of the ``_RINGS`` around the device how far the cell is on the
        way to the next ring, from 0 (not beyond the ring) to 1 (at the next ring or beyond).
    """

    def __init__(
        self, scenario: Scenario, city: City, start: Cell, budget: int, devices: NDArray[np.int32], data: NDArray[np.float64]
    ) -> None:
        assert isinstance(scenario.mission, Harvesting)
        channel = channel_of(scenario.mission, city.shape)
        away = city.distances(start)
        usable = (away >= 0) & (city.distance_to_landing >= 0) & (away + city.distance_to_landing <= budget - 1)
        self.graph = graph = _graph_of(city, usable, away, start, budget)
        self.data, self._steps = data, channel.steps
        sight = np.array([city.visible(cell) for cell in devices.tolist()])
        positions = _positions(np.argwhere(usable).astype(np.float64), graph, channel.steps)
        self._rates = np.empty((len(positions), len(devices), len(_NORMALS)))
        fill_rates(positions, devices, sight, channel, _NORMALS, self._rates)
        self._chances, beyond = _spread(_NORMALS)
        self._missed = graph.actions * channel.steps * len(devices) * max(channel.fading) / math.log(2.0) * beyond
        moves = np.array([city.distances(cell)[usable] for cell in devices.tolist()]).T
        beyond_ring = (np.where(moves < 0, _RINGS[-1], moves)[..., None] - _RINGS[:-1]) / np.diff(_RINGS)
        self.rings = np.concatenate([np.ones((*moves.shape, 1)), np.clip(beyond_ring, 0.0, 1.0)], axis=2)

        n, count = moves.shape
        self._yields, self._slope = np.zeros((n, 5)), np.zeros((n, 5, count))
        self._gain, self._often, self._gradient = np.zeros((n, 5)), np.zeros((n, 5)), np.zeros((n, count))
        self._policy = np.zeros((budget, n, 5), dtype=np.float32)

    def look_at(self, price: NDArray[np.float64]) -> None:
        """Set the prices, shape (n, K), for the next calls of `bound` and `gradient`."""
        self._price = price
        fill_yields(self.graph, self._rates, self._steps, price, self._chances, self._yields, self._slope)

    def bound(self) -> float:
        """Return the bound that the prices give."""
        fill_gains(self.graph, self._price, self.data, self._yields, 0.0, self._gain)
        lacking = float(self.data @ (1.0 - self._price[self.graph.start]))
        return (lacking + longest(self.graph, self._gain) + self._missed) * (1.0 + _ROUNDING)

    def gradient(self, temperature: float, bend: float) -> NDArray[np.float64]:
        """Return the gradient, shape (n, K), of a smooth version of the bound."""
        fill_gains(self.graph, self._price, self.data, self._yields, bend, self._gain)
        fly(self.graph, self._gain, temperature, self._policy, self._often)
        fill_gradient(self.graph, self._price, self.data, self._slope, bend, self._often, self._gradient)
        return self._gradient


def _graph_of(city: City, usable: NDArray[np.bool_], away: NDArray[np.int32], start: Cell, budget: int) -> Graph:
    """Return the graph of the ``usable`` cells."""
    cells = np.argwhere(usable)
    number = np.full((city.shape[0] + 2, city.shape[1] + 2), -1, dtype=np.int32)  # a margin around the map
    number[1:-1, 1:-1][usable] = np.arange(len(cells))
    beside = np.stack([number[cells[:, 0] + down + 1, cells[:, 1] + right + 1] for down, right in OFFSETS[: HOVER + 1]], axis=1)
    return Graph(beside, away[usable], city.distance_to_landing[usable], int(number[start[0] + 1, start[1] + 1]), budget - 1)


def _positions(cells: NDArray[np.float64], graph: Graph, steps: int) -> NDArray[np.float64]:
    """Return the positions of communication: all cells, and ``steps`` − 1 positions within each move to the east or south."""
    here, action = np.nonzero(graph.beside[:, EAST : SOUTH + 1] >= 0)
    first, second = cells[here, None], cells[graph.beside[here, EAST + action], None]
    shares = np.arange(1, steps)[:, None] / steps
    return np.concatenate([cells, (first + shares * (second - first)).reshape(-1, 2)])


def _spread(nodes: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return probabilities of ``nodes`` that replace a standard normal variable N in an upper bound of a function's mean.

    For an increasing convex function the mean does not become smaller: values of N below the first node are moved to it, and
    values between two nodes are moved to both of them, so that their mean is kept. The part beyond the last node is bounded
    separately; for this, E max(0, N − last node) is returned, too.
    """
    exceeded = np.array([math.exp(-x * x / 2) / math.sqrt(2 * math.pi) - x * math.erfc(x / math.sqrt(2)) / 2 for x in nodes])
    above = -np.diff(exceeded) / np.diff(nodes)  # the mean of P(N > x) between two nodes
    return -np.diff(np.concatenate([[1.0], above, [0.0]])), float(exceeded[-1])


class _Adam:
    """Adam for one array."""

    def __init__(self, values: NDArray[np.float64]) -> None:
        self.values = values
        self._mean, self._square = np.zeros_like(values), np.zeros_like(values)
        self._mean_weight = self._square_weight = 0.0

    def descend(self, slope: NDArray[np.float64], pace: float) -> None:
        """Change each value by about ``pace``, against its ``slope``."""
        self._mean += (1.0 - _MEAN) * (slope - self._mean)
        self._square += (1.0 - _SQUARE) * (slope * slope - self._square)
        self._mean_weight += (1.0 - _MEAN) * (1.0 - self._mean_weight)
        self._square_weight += (1.0 - _SQUARE) * (1.0 - self._square_weight)
        self.values -= pace * self._mean / self._mean_weight / (np.sqrt(self._square / self._square_weight) + 1e-3)


def _descend(problem: _Problem, planned: float, rounds: int, deadline: float) -> tuple[float, int]:
    """Return the best bound found and the number of rounds; stop when the bound is not above ``planned``.

    A price is the sum of a part that depends only on the number of moves from the device, and of a part of the cell's own.
    """
    by_ring, by_cell = _Adam(np.zeros(problem.rings.shape[1:])), _Adam(np.zeros(problem.rings.shape[:2]))
    by_ring.values[:, 1 : _STEEP + 1] = _RISE
    best = math.inf
    for used in range(rounds):
        if time.process_time() >= deadline or best <= planned:
            return best, used
        if used == rounds // 3 and best > _HOPELESS * problem.data.sum():
            return best, used
        temperature, bend, step = (a * (b / a) ** (used / rounds) for a, b in (_TEMPERATURE, _BEND, _STEP))
        price = np.einsum("nkg,kg->nk", problem.rings, by_ring.values) + by_cell.values
        problem.look_at(np.clip(price, 0.0, 1.0))
        if used % _EVERY == 0 or used == rounds - 1:
            best = min(best, problem.bound())
        slope = problem.gradient(temperature, bend)
        slope *= (slope > 0.0) & (price > 0.0) | (slope < 0.0) & (price < 1.0)  # prices must not move away from [0, 1]
        by_ring.descend(np.einsum("nkg,nk->kg", problem.rings, slope), step)
        np.maximum(by_ring.values, 0.0, out=by_ring.values)
        by_cell.descend(slope, step * _CELLS)
    return best, rounds
