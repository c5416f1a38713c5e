"""Organic: an old town that has grown, with crooked streets around polygons of unequal size.

The polygons are those of a Voronoi diagram: each cell belongs to the nearest of many seeds. A grid of tiles has one seed in
each tile, somewhere in it, and every second row of tiles is shifted by half a tile, so that the polygons do not stand in
columns. Streets run where cells of different seeds meet.
"""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import BUILDING
from uavbench.world.generators.canvas import Canvas, Window, allotted, between
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer, next_uniform

_SMALLEST, _LARGEST = 6, 14  # sides of a tile
_SEED_BITS = 17  # of the number of a seed; there are at most 1024² / 6² of them, and a margin around the map
_MASK = 2**_SEED_BITS - 1
_STREET = -1  # instead of the number of a seed
_WHOLE = 2**30  # instead of the number of cells to build on in a polygon
_CORE = 16  # how much denser the middle of a town is than its outskirts


@kernel
def draw_organic(cursor: NDArray[np.uint64], canvas: Canvas, window: Window, wanted: int) -> None:
    """Draw polygons in a window of a free canvas; see `uavbench.world.generators.blocks.draw_blocks`."""
    top, left, bottom, right = window
    share = wanted / ((bottom - top) * (right - left))
    cover = min(0.85, share + next_uniform(cursor, 0.06, 0.2))
    street = 1 + (next_integer(cursor, 3) == 0 and share < 0.4)
    tile = min(_LARGEST, max(_SMALLEST, int(1.25 * street / (1.0 - np.sqrt(cover)) + 0.5)) + next_integer(cursor, 4))
    nearest = canvas.distance
    seeds = _divide(cursor, nearest, window, tile, canvas.spare)
    plots, weights = canvas.queue[:seeds], canvas.spare[:seeds]
    cells = _pave(nearest, window, street, plots)
    weight = 0
    for k in range(seeds):
        weight += weights[k] * plots[k]
    for k in range(seeds):
        area = plots[k]
        if area > 0:
            built = allotted(cursor, area, wanted, cells, wanted * weights[k] / weight)
            plots[k] = _WHOLE if built == area else built
            wanted -= built
            cells -= area
            weight -= weights[k] * area
    for r in range(top, bottom):
        for c in range(left, right):
            seed = nearest[r, c]
            if seed != _STREET and plots[seed] > 0:
                canvas.city[r, c] = BUILDING
                if plots[seed] < _WHOLE:
                    plots[seed] -= 1


@kernel
def _divide(
    cursor: NDArray[np.uint64], nearest: NDArray[np.int32], window: Window, tile: int, weights: NDArray[np.int32]
) -> int:
    """Draw the seeds, and write which one is nearest to each cell; return how many seeds there are.

    A seed is compared with the cells that are at most the side of a tile away in each direction. Distances are squared, in half
    cells, and stand above the number of the seed in one integer, so that one minimum finds both. The weight of a seed is how
    likely its polygon is built on: towns have a core that is denser than the outskirts, or none.
    """
    top, left, bottom, right = window
    for r in range(top, bottom):
        for c in range(left, right):
            nearest[r, c] = np.int32(2**31 - 1)
    core_y = top + ((bottom - top) * between(cursor, 1, 5)) // 6
    core_x = left + ((right - left) * between(cursor, 1, 5)) // 6
    contrast = next_integer(cursor, 2) * _CORE
    radius = ((bottom - top) * (bottom - top) + (right - left) * (right - left)) // 4
    shift = next_integer(cursor, tile)
    seed = 0
    for i in range(-1, (bottom - top) // tile + 2):
        y = top + i * tile - shift
        for j in range(-1, (right - left) // tile + 2):
            x = left + j * tile - shift + (tile // 2 if i % 2 else 0)
            far = (y - core_y) * (y - core_y) + (x - core_x) * (x - core_x)
            weights[seed] = 1 + max(0, contrast - (contrast * far) // radius)
            _claim(nearest, window, 2 * y + next_integer(cursor, 2 * tile), 2 * x + next_integer(cursor, 2 * tile), tile, seed)
            seed += 1
    return seed


@kernel
def _claim(nearest: NDArray[np.int32], window: Window, y: int, x: int, tile: int, seed: int) -> None:
    """Give a seed at (``y``, ``x``), in half cells, the cells around it to which no earlier seed is nearer."""
    first, last = max(window[1], x // 2 - tile), min(window[3], x // 2 + tile + 1)
    wide, flat = nearest.shape[1], nearest.reshape(-1)
    for r in range(max(window[0], y // 2 - tile), min(window[2], y // 2 + tile + 1)):
        start = np.uint64(r * wide + first)
        square = (2 * r - y) * (2 * r - y)
        for k in range(last - first):
            along = np.int32(2 * (first + k) - x)
            value = np.int32(((square + along * along) << _SEED_BITS) | seed)
            place = start + np.uint64(k)
            flat[place] = min(flat[place], value)


@kernel
def _pave(nearest: NDArray[np.int32], window: Window, street: int, plots: NDArray[np.int32]) -> int:
    """Turn distances into numbers of seeds, or `_STREET` where seeds meet; count the cells of each, and return the sum.

    A cell is a street if a cell to its right, below it or diagonally below has another seed. Later cells only are compared,
    so that streets are not twice as wide, and with the diagonal one, so that streets do not break where they turn.
    """
    top, left, bottom, right = window
    plots[:] = 0
    cells = 0
    for r in range(top, bottom):
        below = min(bottom - 1, r + street)
        for c in range(left, right):
            seed, beside = nearest[r, c] & _MASK, min(right - 1, c + street)
            same = (
                (seed == nearest[r, beside] & _MASK)
                & (seed == nearest[below, c] & _MASK)
                & (seed == nearest[below, beside] & _MASK)
            )
            if same:
                plots[seed] += 1
            nearest[r, c] = seed if same else _STREET
    for k in range(len(plots)):
        cells += plots[k]
    return cells
