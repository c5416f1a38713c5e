"""The turns of a flight, for searches in which they cost something, as they do in the air."""

import math

import numpy as np
from numpy.typing import NDArray

from uavbench.planning.rates import action_of
from uavbench.world.city import HOVER
from uavbench.world.kernel import kernel


@kernel
def turns_at(before: int, here: int, there: int, cols: int) -> int:
    """Return by how many quarters a UAV turns in cell ``here``, 0 to 2; one that hovers has stopped, and does not turn."""
    first, then = action_of(before, here, cols), action_of(here, there, cols)
    if HOVER in (first, then):
        return 0
    return (0, 1, 2, 1)[(then - first) % 4]


@kernel
def turns_of(path: NDArray[np.int32], length: int, cols: int) -> int:
    """Return the quarter turns of a flight, which consists of the cells 0 to ``length``."""
    total = 0
    for k in range(1, length):
        total += turns_at(path[k - 1], path[k], path[k + 1], cols)
    return total


@kernel
def turned(
    path: NDArray[np.int32],
    length: int,
    longest: int,
    first: int,
    after: int,
    size: int,
    new: NDArray[np.int32],
    cols: int,
    turn_cost: float,
) -> float:
    """Return the price of the further turns of a change that `uavbench.planning.changes.propose` returns, in moves.

    A quarter turn counts as ``turn_cost`` moves. ∞ if the flight would be longer than ``longest`` and than before, its turns
    included.
    """
    if turn_cost <= 0.0:
        return 0.0
    price = turn_cost * _further_turns(path, length, first, after, size, new, cols)
    before = length + turn_cost * turns_of(path, length, cols)
    grown = before + size - (after - first - 1) + price
    return math.inf if grown > max(longest, before) else price


@kernel
def _further_turns(
    path: NDArray[np.int32], length: int, first: int, after: int, size: int, new: NDArray[np.int32], cols: int
) -> int:
    """Return how many quarter turns a flight has more with a change that `uavbench.planning.changes.propose` returns."""
    further = 0
    for k in range(max(1, first), min(after, length - 1) + 1):
        further -= turns_at(path[k - 1], path[k], path[k + 1], cols)
    before, here = int(path[first - 1]) if first > 0 else -1, int(path[first])
    for k in range(min(size + 2, size + length + 1 - after)):
        there = int(new[k]) if k < size else int(path[after + k - size])
        if before >= 0:
            further += turns_at(before, here, there, cols)
        before, here = here, there
    return further
