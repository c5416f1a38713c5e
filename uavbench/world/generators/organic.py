"""Organic: an old town that has grown, with crooked streets around polygons of unequal size.

The polygons are those of a Voronoi diagram: each cell belongs to the nearest of many seeds. A grid of tiles has one seed in
each tile, somewhere in it, and every second row of tiles is shifted by half a tile, so that the polygons do not stand in
columns. Streets run where cells of different seeds meet.
"""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import BUILDING
from uavbench.world.generators.canvas import Canvas, Window, allotted
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer, next_uniform

_SMALLEST, _LARGEST = 4, 11  # sides of a tile
_SEED_BITS = 17  # of the number of a seed; there are at most 1024² / 4² of them, and a margin around the map
_STREET = -1  # instead of the number of a seed


@kernel
def draw_organic(cursor: NDArray[np.uint64], canvas: Canvas, window: Window, wanted: int) -> None:
    """Draw polygons in a window of a free canvas; see `uavbench.world.generators.blocks.draw_blocks`."""
    top, left, bottom, right = window
    share = wanted / ((bottom - top) * (right - left))
    cover = min(0.85, share + next_uniform(cursor, 0.06, 0.2))
    street = 1 + (next_integer(cursor, 3) == 0 and share < 0.4)
    tile = min(_LARGEST, max(_SMALLEST, int(1.25 * street / (1.0 - np.sqrt(cover)) + 0.5)))
    nearest = canvas.distance
    seeds = _divide(cursor, nearest, window, tile)
    plots = canvas.queue[:seeds]
    left_cells = _pave(nearest, window, street, plots)
    for k in range(seeds):
        area = plots[k]
        plots[k] = allotted(cursor, area, wanted, left_cells) if area > 0 else 0
        wanted -= plots[k]
        left_cells -= area
    for r in range(top, bottom):
        for c in range(left, right):
            seed = nearest[r, c]
            if seed != _STREET and plots[seed] > 0:
                plots[seed] -= 1
                canvas.city[r, c] = BUILDING


@kernel
def _divide(cursor: NDArray[np.uint64], nearest: NDArray[np.int32], window: Window, tile: int) -> int:
    """Draw the seeds, and write which one is nearest to each cell; return how many seeds there are.

    A seed is compared only with the cells of its tile and of the eight tiles around it. Distances are squared, in half cells,
    and stand above the number of the seed in one integer, so that one minimum finds both.
    """
    top, left, bottom, right = window
    for r in range(top, bottom):
        row = nearest[r, left:right]
        for c in range(len(row)):
            row[c] = np.int32(2**31 - 1)
    seed = 0
    shift = next_integer(cursor, tile)
    for i in range(-1, (bottom - top) // tile + 2):
        y = top + i * tile - shift
        for j in range(-1, (right - left) // tile + 2):
            x = left + j * tile - shift + (tile // 2 if i % 2 else 0)
            down, across = 2 * y + next_integer(cursor, 2 * tile), 2 * x + next_integer(cursor, 2 * tile)
            first, last = max(left, x - tile), min(right, x + 2 * tile)
            for r in range(max(top, y - tile), min(bottom, y + 2 * tile)):
                row = nearest[r, first:last]
                high = (2 * r - down) * (2 * r - down)
                offset = 2 * first - across
                for c in range(len(row)):
                    along = offset + 2 * c
                    row[c] = min(row[c], np.int32(((high + along * along) << _SEED_BITS) | seed))
            seed += 1
    return seed


@kernel
def _pave(nearest: NDArray[np.int32], window: Window, street: int, plots: NDArray[np.int32]) -> int:
    """Turn distances into numbers of seeds, or `_STREET` where seeds meet; count the cells of each, and return the sum.

    A cell is a street if a cell to its right, below it or diagonally below has another seed. Later cells only are compared,
    so that streets are not twice as wide, and with the diagonal one, so that streets do not break where they turn.
    """
    top, left, bottom, right = window
    plots[:] = 0
    mask = np.int32(2**_SEED_BITS - 1)
    for r in range(top, bottom):
        for c in range(left, right):
            nearest[r, c] &= mask
    cells = 0
    for r in range(top, bottom):
        below = min(bottom - 1, r + street)
        for c in range(left, right):
            seed, beside = nearest[r, c], min(right - 1, c + street)
            same = (seed == nearest[r, beside]) & (seed == nearest[below, c]) & (seed == nearest[below, beside])
            plots[seed] += same
            cells += same
            nearest[r, c] = seed if same else _STREET
    return cells
