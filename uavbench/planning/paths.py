"""Shortest paths between all cells of a city, for searches that look them up millions of times."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from uavbench.world.city import City
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer

#: The value in a table of distances for pairs of cells without a path.
FAR = np.int16(np.iinfo(np.int16).max)


@lru_cache(maxsize=8)
def distance_table(city: City) -> NDArray[np.int16]:
    """Return the number of moves between all pairs of cells, in row-major order; shape (MN, MN), `FAR` where there is no path.

    The size of the table is quadratic in the number of cells: 2 MB at 32×32, 12.5 MB at 50×50.
    """
    rows, cols = city.shape
    table = np.full((rows * cols, rows * cols), FAR, dtype=np.int16)
    for r, c in np.argwhere(~city.no_fly).tolist():
        away = city.distances((r, c)).reshape(-1)
        table[r * cols + c] = np.where(away >= 0, away, FAR)
    table.flags.writeable = False
    return table


@kernel
def pick(cursor: NDArray[np.uint64], count: int) -> int:
    """Return a signed integer uniform in 0, …, ``count`` − 1: Numba turns a signed and an unsigned integer into a float."""
    return np.int64(next_integer(cursor, count))  # pyright: ignore[reportReturnType]


@kernel
def walk(
    distance: NDArray[np.int16],
    cols: int,
    here: int,
    there: int,
    straight: bool,
    cursor: NDArray[np.uint64],
    out: NDArray[np.int32],
    length: int,
) -> int:
    """Append a shortest path from ``here`` (not written) to ``there`` (written) to ``out``, which holds ``length`` cells.

    Of the shortest paths, it takes one with few bends if ``straight``, else a random one. A path must exist. Returns the new
    length.
    """
    to = distance[there]
    heading = pick(cursor, 4)
    while here != there:
        turn = 0 if straight else pick(cursor, 4)
        for k in range(4):
            way = (heading + turn + k) & 3
            step = (-cols, 1, cols, -1)[way]
            # `_beside` refuses steps across the left or right edge of the map, which lead to another row.
            near = here + step
            if 0 <= near < len(to) and to[near] == to[here] - 1 and _beside(here, near, cols):
                heading, here = way, near
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
