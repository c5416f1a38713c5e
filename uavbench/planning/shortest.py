"""The number of moves between two cells, for searches that ask for few of all pairs: no table of all pairs is needed."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.world.city import City
from uavbench.world.kernel import kernel


class Grid(NamedTuple):
    """The cells of a city, and memory that each search for a path uses again.

    Cell (r, c) of a map with N columns has the number r · N + c.

    Attributes
    ----------
    closed : ndarray of bool, shape (M, N)
        The cells that a UAV cannot fly over.
    expanded : ndarray of int64, shape (MN,)
        The number of the last search that went on from a cell to its neighbours.
    searches : ndarray of int64, shape (1,)
        The number of searches so far.
    stacks : ndarray of int32, shape (2, 4MN + 1)
        The cells from which a search has still to go on.
    """

    closed: NDArray[np.bool_]
    expanded: NDArray[np.int64]
    searches: NDArray[np.int64]
    stacks: NDArray[np.int32]


def grid_of(city: City) -> Grid:
    """Return a city's cells, for `moves_between`."""
    size = city.no_fly.size
    return Grid(
        city.no_fly,
        np.zeros(size, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        np.empty((2, 4 * size + 1), dtype=np.int32),
    )


@kernel
def straight(here: int, there: int, columns: int) -> int:
    """Return the number of moves between two cells if nothing is in the way: it is never more than that of `moves_between`."""
    return abs(here // columns - there // columns) + abs(here % columns - there % columns)


@kernel
def moves_between(grid: Grid, here: int, there: int) -> int:
    """Return the number of moves on a shortest path between two cells that are not closed; −1 if there is no path.

    This is A* (Hart, Nilsson, Raphael, IEEE Transactions on Systems Science and Cybernetics 4(2), 1968). The length of a path
    through a cell is at least the moves so far plus `straight` from the cell to the goal. A move towards the goal leaves this
    sum as it is, and any other move adds 2. So two stacks take the place of a priority queue: one for the present sum, and one
    for the next. The moves so far need not be kept: they are the sum minus `straight`.
    """
    rows, columns = grid.closed.shape
    grid.searches[0] += 1
    search, length = grid.searches[0], straight(here, there, columns)
    now, later = grid.stacks[0], grid.stacks[1]
    now[0] = here
    height, height_later = 1, 0
    while height > 0:
        height -= 1
        cell = now[height]
        if cell == there:
            return length
        if grid.expanded[cell] != search:
            grid.expanded[cell] = search
            r, c = cell // columns, cell % columns
            far = straight(cell, there, columns)
            for down, right in ((-1, 0), (0, 1), (1, 0), (0, -1)):
                y, x = r + down, c + right
                if not (0 <= y < rows and 0 <= x < columns) or grid.closed[y, x]:
                    continue
                near = cell + down * columns + right
                if grid.expanded[near] == search:
                    continue
                if straight(near, there, columns) < far:
                    now[height] = near
                    height += 1
                else:
                    later[height_later] = near
                    height_later += 1
        if height == 0:
            now, later = later, now
            height, height_later = height_later, 0
            length += 2
    return -1
