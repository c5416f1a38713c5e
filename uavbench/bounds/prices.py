"""The kernels of the bound by prices: yields of actions, the longest flight, and the gradient. See docs/bounds.md."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.simulation.missions.channel import Channel, log_snr_of
from uavbench.world.city import EAST, HOVER, SOUTH
from uavbench.world.kernel import kernel

_LEAST = 1e-14  # smaller probabilities, and smaller weights of flights, are ignored
_NEGLIGIBLE = -20.0  # actions are ignored if the logarithm of their weight is this much below that of the best action


class Graph(NamedTuple):
    """The n cells that a UAV can visit and still land in time, numbered row by row.

    Attributes
    ----------
    beside : ndarray of int32, shape (n, 5)
        The cell to which each action from north to hover leads; −1 if it leads to none of the n cells.
    away, home : ndarray of int32, shape (n,)
        Moves from the start, and to the nearest landing cell.
    start : int
        The number of the start cell.
    actions : int
        The number of actions before the landing.
    """

    beside: NDArray[np.int32]
    away: NDArray[np.int32]
    home: NDArray[np.int32]
    start: int
    actions: int


@kernel
def fill_rates(
    positions: NDArray[np.float64],
    devices: NDArray[np.int32],
    sight: NDArray[np.bool_],
    channel: Channel,
    nodes: NDArray[np.float64],
    rates: NDArray[np.float64],
) -> None:
    """Write the rate of every device at every position, if the fading is each of ``nodes`` times its standard deviation."""
    for i in range(len(positions)):
        r, c = positions[i]
        y, x = round(r), round(c)
        for d in range(len(devices)):
            clear = int(sight[d, y, x])
            level = log_snr_of(channel, devices[d, 0], devices[d, 1], r, c, clear)
            for j in range(len(nodes)):
                rates[i, d, j] = math.log2(1.0 + math.exp(level + channel.fading[clear] * nodes[j]))


@kernel
def add_most(
    rates: NDArray[np.float64],
    price: NDArray[np.float64],
    chances: NDArray[np.float64],
    slope: NDArray[np.float64],
    chance: NDArray[np.float64],
    number: NDArray[np.int64],
) -> float:
    """Return E max_d price_d R_d, and add its derivatives with respect to the prices, shape (K,), to ``slope``.

    The R_d are independent. Their values ``rates`` (K, J) are in ascending order and have the probabilities ``chances`` (J,).
    The kernel goes through the products price_d R_d from the highest down. ``chance`` (K,) and ``number`` (2, K) are scratch
    space.
    """
    count, last = rates.shape[0], rates.shape[1] - 1
    least = 0.0
    for d in range(count):
        least = max(least, price[d] * rates[d, 0])
    able, at = number
    some = 0
    for d in range(count):  # most devices can never be the best, and are left out
        if price[d] * rates[d, last] > least or (least > 0.0 and price[d] * rates[d, 0] == least):
            able[some] = d
            at[d] = last
            chance[d] = 1.0
            some += 1
    mean, below = 0.0, 1.0  # ``below`` is the product of ``chance``: the probability that no device has a value passed so far
    while some > 0:
        d, highest = 0, -1.0
        for i in range(some):
            value = price[able[i]] * rates[able[i], at[able[i]]]
            if value > highest:
                d, highest = able[i], value
        others = below / chance[d]
        likely = others * chances[at[d]]
        mean += likely * highest
        slope[d] += likely * rates[d, at[d]]
        chance[d] -= chances[at[d]]
        if at[d] == 0 or chance[d] < _LEAST:
            break
        below = others * chance[d]
        at[d] -= 1
    return mean


@kernel
def fill_yields(
    graph: Graph,
    rates: NDArray[np.float64],
    steps: int,
    price: NDArray[np.float64],
    chances: NDArray[np.float64],
    yields: NDArray[np.float64],
    slope: NDArray[np.float64],
) -> None:
    """Write what each action yields from each cell: Σ over the communication steps of E max_d min(u_d(p), u_d(q)) R_d.

    Also write to ``slope`` its derivatives with respect to these minima, one for each device.
    """
    n, count = price.shape
    chance, number, low, inner = np.empty(count), np.empty((2, count), np.int64), np.empty(count), np.empty(count)
    between = n
    for c in range(n):
        slope[c, HOVER] = 0.0
        yields[c, HOVER] = steps * add_most(rates[c], price[c], chances, slope[c, HOVER], chance, number)
        slope[c, HOVER] *= steps
        for action in range(EAST, SOUTH + 1):
            q = graph.beside[c, action]
            if q < 0:
                continue
            for d in range(count):
                low[d] = min(price[c, d], price[q, d])
            inner[:] = 0.0
            most = 0.0
            for _ in range(steps - 1):
                most += add_most(rates[between], low, chances, inner, chance, number)
                between += 1
            back = (action + 2) % 4
            slope[c, action] = inner
            slope[q, back] = inner
            yields[c, action] = most + add_most(rates[q], low, chances, slope[c, action], chance, number)
            yields[q, back] = most + add_most(rates[c], low, chances, slope[q, back], chance, number)


@kernel
def fill_gains(
    graph: Graph,
    price: NDArray[np.float64],
    data: NDArray[np.float64],
    yields: NDArray[np.float64],
    bend: float,
    gain: NDArray[np.float64],
) -> None:
    """Write the gain of each action: its yield, and the charge for each price that falls; −∞ where there is no next cell."""
    for c in range(len(price)):
        for action in range(5):
            q = graph.beside[c, action]
            gain[c, action] = -math.inf if q < 0 else yields[c, action]
            if q < 0 or q == c:
                continue
            for d in range(len(data)):
                fall = price[c, d] - price[q, d]
                if fall >= bend:
                    gain[c, action] += data[d] * (fall - bend / 2)
                elif fall > 0.0:
                    gain[c, action] += data[d] * fall * fall / (2 * bend)


@kernel
def longest(graph: Graph, gain: NDArray[np.float64]) -> float:
    """Return the largest sum of gains of a flight that is at a landing cell after all its actions."""
    n = len(gain)
    value, new = np.where(graph.home == 0, 0.0, -math.inf), np.empty(n)
    for left in range(1, graph.actions + 1):
        for c in range(n):
            best = -math.inf
            if graph.home[c] <= left and graph.away[c] <= graph.actions - left:
                for action in range(5):
                    q = graph.beside[c, action]
                    if q >= 0:
                        best = max(best, gain[c, action] + value[q])
            new[c] = best
        value, new = new, value
    return value[graph.start]


@kernel
def fly(
    graph: Graph,
    gain: NDArray[np.float64],
    temperature: float,
    policy: NDArray[np.float32],
    often: NDArray[np.float64],
) -> None:
    """Write how often each action is flown from each cell, as a mean over flights with the weights e^(gain / temperature).

    These are the derivatives of temperature · ln Σ e^(gain / temperature), which replaces the maximum over flights. ``policy``
    is scratch space.
    """
    n = len(gain)
    value, new, weight = np.where(graph.home == 0, 0.0, -math.inf), np.empty(n), np.empty(5)
    for left in range(1, graph.actions + 1):
        for c in range(n):
            new[c] = -math.inf
            if graph.home[c] > left or graph.away[c] > graph.actions - left:
                continue
            for action in range(5):
                q = graph.beside[c, action]
                weight[action] = gain[c, action] + value[q] if q >= 0 else -math.inf
            best, total = weight.max(), 0.0
            for action in range(5):
                lag = (weight[action] - best) / temperature
                weight[action] = math.exp(lag) if lag > _NEGLIGIBLE else 0.0
                total += weight[action]
            for action in range(5):
                policy[left, c, action] = weight[action] / total
            new[c] = best + temperature * math.log(total)
        value, new = new, value
    often[:] = 0.0
    here, there = np.zeros(n), np.zeros(n)
    here[graph.start] = 1.0
    for left in range(graph.actions, 0, -1):
        there[:] = 0.0
        for c in range(n):
            if here[c] > _LEAST:
                for action in range(5):
                    share = here[c] * policy[left, c, action]
                    if share > 0.0:
                        often[c, action] += share
                        there[graph.beside[c, action]] += share
        here, there = there, here


@kernel
def fill_gradient(
    graph: Graph,
    price: NDArray[np.float64],
    data: NDArray[np.float64],
    slope: NDArray[np.float64],
    bend: float,
    often: NDArray[np.float64],
    gradient: NDArray[np.float64],
) -> None:
    """Write the derivatives of the smooth bound with respect to the prices."""
    gradient[:] = 0.0
    gradient[graph.start] = -data
    for c in range(len(price)):
        for action in range(5):
            share = often[c, action]
            if share == 0.0:
                continue
            q = graph.beside[c, action]
            for d in range(len(data)):
                fall = price[c, d] - price[q, d]
                if fall > 0.0:
                    charge = share * data[d] * min(1.0, fall / bend)
                    gradient[c, d] += charge
                    gradient[q, d] -= charge
                    gradient[q, d] += share * slope[c, action, d]
                elif fall < 0.0:
                    gradient[c, d] += share * slope[c, action, d]
                else:
                    gradient[c, d] += share * slope[c, action, d] / 2
                    gradient[q, d] += share * slope[c, action, d] / 2
