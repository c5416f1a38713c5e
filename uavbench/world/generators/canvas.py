"""What all generators of cities draw with: a canvas with a border, random sizes, and an account of the cells left to build.

A canvas is a map with a border of one cell of another code around it. So a search over neighbours need not check where the
map ends, and a generator need not know whether it draws the whole map or one district of it: it draws in a window.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer, next_uniform

#: The code of the border.
OUTSIDE = 9
#: The first row and column of a window and, behind it, the first row and column that do not belong to it.
Window = tuple[int, int, int, int]


class Canvas(NamedTuple):
    """The arrays that drawing a city of M rows and N columns needs. They are allocated once and used for many cities.

    Attributes
    ----------
    city : ndarray of uint8, shape (M + 2, N + 2)
        The codes of the cells, and the border.
    distance : ndarray of int32, shape (M + 2, N + 2)
        Moves to the nearest landing cell. A generator may use it for anything before.
    queue, spare : ndarray of int32, shape ((M + 2) (N + 2),)
        Lists of cells, each as its index in the flattened city. A generator may use them for anything.
    cuts : ndarray of int64, shape (2, max(M, N) + 8)
        Where blocks begin and end: down in the first row, across in the second one.
    """

    city: NDArray[np.uint8]
    distance: NDArray[np.int32]
    queue: NDArray[np.int32]
    spare: NDArray[np.int32]
    cuts: NDArray[np.int64]


@kernel
def new_canvas(rows: int, cols: int) -> Canvas:
    """Return a canvas for a map of ``rows`` × ``cols`` cells."""
    shape = (rows + 2, cols + 2)
    cells = shape[0] * shape[1]
    return Canvas(
        np.full(shape, OUTSIDE, dtype=np.uint8),
        np.empty(shape, dtype=np.int32),
        np.empty(cells, dtype=np.int32),
        np.empty(cells, dtype=np.int32),
        np.empty((2, max(rows, cols) + 8), dtype=np.int64),
    )


@kernel
def fill(city: NDArray[np.uint8], window: Window, code: int) -> None:
    """Give all cells of a window the same code."""
    for r in range(window[0], window[2]):
        row = city[r, window[1] : window[3]]
        for c in range(len(row)):
            row[c] = code


@kernel
def between(cursor: NDArray[np.uint64], low: int, high: int) -> int:
    """Return an integer uniform in ``low``, …, ``high``."""
    return low + next_integer(cursor, high - low + 1)


@kernel
def chance(cursor: NDArray[np.uint64], probability: float) -> bool:
    """Return True with a probability."""
    return next_uniform(cursor, 0.0, 1.0) < probability


@kernel
def allotted(cursor: NDArray[np.uint64], area: int, wanted: int, left: int, probability: float) -> int:
    """Return how many cells of a plot shall be built on: all of it, a part or nothing.

    A generator visits its plots one after the other, and the last ones make up for what chance has left too much or too little.

    Parameters
    ----------
    cursor : ndarray of uint64, shape (1,)
        The stream of random numbers.
    area : int
        Cells of the plot.
    wanted : int
        Cells that are still to be built on, in this and all later plots.
    left : int
        Cells of this and all later plots.
    probability : float
        The chance that the plot is built on. With ``wanted / left``, built and open plots are mixed over the whole city.
    """
    if chance(cursor, probability):
        return min(area, wanted)
    return max(0, wanted - (left - area))  # as much as the later plots cannot take


@kernel
def cut(cursor: NDArray[np.uint64], begin: int, end: int, size: int, street: int, cuts: NDArray[np.int64]) -> int:
    """Cut a side of a window into blocks of about ``size`` cells with streets between them; return the number of blocks.

    Block k goes from ``cuts[2 k]`` to before ``cuts[2 k + 1]``. The window may begin and end inside a block or a street.
    """
    jitter = 1 if size < 6 else 2
    at = begin - next_integer(cursor, size + street)
    blocks = 0
    while at < end:
        after = at + max(2, size + between(cursor, -jitter, jitter))
        if after > begin:
            cuts[2 * blocks], cuts[2 * blocks + 1] = max(at, begin), min(after, end)
            blocks += 1
        roll = next_integer(cursor, 8)
        at = after + street + (1 if roll == 0 else (-1 if roll == 1 and street > 1 else 0))  # some are wider, some narrower
    return blocks
