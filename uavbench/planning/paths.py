"""Paths on a map."""

import numpy as np
from numpy.typing import NDArray

from uavbench.planning.distances import Distances, distances_to
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer


@kernel
def pick(cursor: NDArray[np.uint64], count: int) -> int:
    """Return a signed integer uniform in 0, …, ``count`` − 1: Numba turns a signed and an unsigned integer into a float."""
    return np.int64(next_integer(cursor, count))  # pyright: ignore[reportReturnType]


@kernel
def walk(
    distance: Distances,
    cols: int,
    here: int,
    there: int,
    straight: bool,
    cursor: NDArray[np.uint64],
    out: NDArray[np.int32],
    length: int,
) -> int:
    """Append a shortest path from ``here`` (not written) to ``there`` (written) to ``out``, which holds ``length`` cells.

    Of the shortest paths, it takes one with few bends if ``straight``, else a random one. A path must be known: see `moves`.
    Returns the new length.
    """
    to, wide, at = distances_to(distance, cols, here, there)
    return follow(to, wide, at, cols, here, straight, cursor, out, length)


@kernel
def follow(
    to: NDArray[np.integer],
    wide: int,
    at: int,
    cols: int,
    here: int,
    straight: bool,
    cursor: NDArray[np.uint64],
    out: NDArray[np.int32],
    length: int,
) -> int:
    """Append a shortest path from ``here`` to the cell where ``to`` is 0, as `walk`.

    ``to`` holds the moves to that cell from each cell of a part of the map with ``wide`` columns, in which ``here`` has the
    index ``at``.
    """
    heading, column = pick(cursor, 4), at % wide
    while to[at] > 0:
        turn = 0 if straight else pick(cursor, 4)
        for k in range(4):
            way = (heading + turn + k) & 3
            right = (0, 1, 0, -1)[way]
            near = at + (-wide, 1, wide, -1)[way]
            # A step across the left or right edge of the part would lead to another row.
            if 0 <= near < len(to) and 0 <= column + right < wide and to[near] == to[at] - 1:
                heading, at = way, near
                column += right
                here += (-cols, 1, cols, -1)[way]
                break
        out[length] = here
        length += 1
    return length


@kernel
def worthiest_way(start: int, onward: NDArray[np.int32], cols: int, worth: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the cells after ``start`` on the shortest path to a goal whose cells have the largest sum of ``worth``.

    ``onward`` (MN,) holds the number of moves from each cell to the nearest goal (0 at a goal, −1 where there is no path);
    ``worth`` (MN,) holds what it is worth to pass each cell.
    """
    value = np.full(len(onward), -1.0)
    before = np.full(len(onward), -1)
    queue = np.empty(len(onward), dtype=np.int64)
    queue[0], value[start] = start, 0.0
    tail, best = 1, start
    for head in range(len(onward)):
        if head == tail:
            break
        cell = queue[head]
        if onward[cell] == 0 and (onward[best] > 0 or value[cell] > value[best]):
            best = cell
        for step in (-cols, 1, cols, -1):
            near = cell + step
            if not 0 <= near < len(onward) or onward[near] != onward[cell] - 1 or onward[near] < 0:
                continue
            if not _beside(cell, near, cols):
                continue
            if before[near] < 0:
                queue[tail] = near
                tail += 1
            if value[cell] + worth[near] > value[near]:
                value[near], before[near] = value[cell] + worth[near], cell
    way = np.empty(onward[start], dtype=np.int64)
    for n in range(len(way) - 1, -1, -1):
        way[n], best = best, before[best]
    return way


@kernel
def _beside(here: int, near: int, cols: int) -> bool:
    """Return whether a step between two row-major numbers, which differ by 1 or ``cols``, connects neighbours on the map."""
    return abs(here - near) == cols or here // cols == near // cols
