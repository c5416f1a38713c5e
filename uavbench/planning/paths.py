"""Shortest ways between all cells of a city, for searches that look them up millions of times."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from uavbench.city import City
from uavbench.kernel import kernel
from uavbench.keyed import next_integer

#: In place of a distance where there is no way.
FAR = np.int16(np.iinfo(np.int16).max)


@lru_cache(maxsize=8)
def distance_table(city: City) -> NDArray[np.int16]:
    """Return the moves between all pairs of cells, in row-major order; shape (MN, MN), `FAR` where there is no way.

    Of size quadratic in the cells: 2 MB at 32×32, 12.5 MB at 50×50.
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
    """Return an integer uniform in 0, …, ``count`` − 1, signed: Numba makes a float of signed and unsigned together."""
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
    """Append a shortest way from ``here`` (not written) to ``there`` (written) to ``out``, which holds ``length`` cells.

    One of many: in few bends if ``straight``, else at random. The way must exist. Returns the new length.
    """
    to = distance[there]
    heading = pick(cursor, 4)
    while here != there:
        turn = 0 if straight else pick(cursor, 4)
        for k in range(4):
            way = (heading + turn + k) & 3
            step = (-cols, 1, cols, -1)[way]
            # Distances to a neighbour across the map's edge, or off the map, never go down by one.
            near = here + step
            if 0 <= near < len(to) and to[near] == to[here] - 1 and _beside(here, near, cols):
                heading, here = way, near
                break
        out[length] = here
        length += 1
    return length


@kernel
def _beside(here: int, near: int, cols: int) -> bool:
    """Say whether a step of one cell in row-major order stays in its row, if it is one along a row."""
    return abs(here - near) == cols or here // cols == near // cols
