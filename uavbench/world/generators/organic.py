"""Organic: an old town that has grown, with crooked streets around polygons of unequal size.

The polygons are those of a Voronoi diagram: each cell belongs to the nearest of many seeds. A grid of tiles has one seed in
each tile, somewhere in it, and every second row of tiles is shifted by half a tile, so that the polygons do not stand in
columns. Streets run where cells of different seeds meet.

Cities of 12 × 30 cells with the default parameters and a reach of 60 moves:

Key 0::

    ..bbb........##...............
    ...bb........#####.........NN.
    ...b.........######........NN.
    ............#######........NN.
    ............#######.....LL.NN.
    ............#######.....LL.NN.
    ............########........bb
    bb.........#########........bb
    ...#####.....#######.....bb..b
    .#.#####......####.....bbbbb..
    ##.####................bbbbbbb
    ##.####.........#......bbb....

Key 1::

    ............#######.######.###
    ...........#######..######.###
    ...........#######.#######.###
    ..........########.#######..#.
    ............######.########...
    ................#..########...
    .LLL..............#########...
    .LLL...............########NN.
    ..LLLLLL...........#######NNN.
    ..LLLLLL...........#####NNNN..
    .....LLL............##.NNNNN..
    ..............................

Key 2::

    .......bb..##............LLL..
    ......bbb................LLL..
    ......bbb....................#
    .....bbb...#................##
    #..........#####............##
    #..........####.............##
    .....bbb....##................
    .....bbbb.....................
    .....bbbbb......###.........##
    .....bbbbbb...######......####
    .....bbbbbb...#######....#####
    .....bbbbbb...########..######
"""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import BUILDING, FREE
from uavbench.world.generators.canvas import Canvas, Window, allotted, between
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer, next_uniform

_SMALLEST, _LARGEST = 6, 14  # sides of a tile
_SEED_BITS = 17  # of the number of a seed; there are at most 1024² / 6² of them, and a margin around the map
_MASK = 2**_SEED_BITS - 1
_WHOLE = 2**30  # instead of the number of cells to build on in a polygon
_OUTSKIRTS, _CORE = 3, 9  # what the weight of a polygon is, and what is added to it in the middle of a town


@kernel
def draw_organic(cursor: NDArray[np.uint64], canvas: Canvas, window: Window, wanted: int) -> None:
    """Draw polygons in a window of a free canvas; see `uavbench.world.generators.blocks.draw_blocks`."""
    top, left, bottom, right = window
    share = wanted / ((bottom - top) * (right - left))
    cover = min(0.85, share + next_uniform(cursor, 0.06, 0.2))
    street = 1 + (next_integer(cursor, 3) == 0 and share < 0.35)
    tile = min(_LARGEST, max(_SMALLEST, int(1.25 * street / (1.0 - np.sqrt(cover)) + 0.5)) + next_integer(cursor, 3))
    seeds = _divide(cursor, canvas, window, tile, canvas.spare)
    plots, weights = canvas.queue[:seeds], canvas.spare[:seeds]
    cells = _pave(canvas, window, street, plots)
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
    _write(canvas, window, plots)


@kernel
def _write(canvas: Canvas, window: Window, plots: NDArray[np.int32]) -> None:
    """Keep the wanted cells of each polygon as buildings, and clear the others."""
    for r in range(window[0], window[2]):
        row, seeds = canvas.city[r, window[1] : window[3]], canvas.distance[r, window[1] : window[3]]
        for c in range(len(row)):
            seed = np.uint64(seeds[c] & _MASK)
            wanted = plots[seed]
            row[c] = row[c] if wanted > 0 else FREE
            if 0 < wanted < _WHOLE and row[c] == BUILDING:
                plots[seed] = wanted - 1


@kernel
def _divide(cursor: NDArray[np.uint64], canvas: Canvas, window: Window, tile: int, weights: NDArray[np.int32]) -> int:
    """Draw the seeds, and write which one is nearest to each cell; return how many seeds there are.

    A seed is compared with the cells that are at most the side of a tile away in each direction. Distances are squared, in half
    cells, and stand above the number of the seed in one integer, so that one minimum finds both. The weight of a seed is how
    likely its polygon is built on: towns have a core that is denser than the outskirts, or none.
    """
    top, left, bottom, right = window
    for r in range(top, bottom):
        row = canvas.distance[r, left:right]
        for c in range(len(row)):
            row[c] = np.int32(2**31 - 1)
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
            weights[seed] = _OUTSKIRTS + max(0, contrast - (contrast * far) // radius)
            _claim(canvas, window, 2 * y + next_integer(cursor, 2 * tile), 2 * x + next_integer(cursor, 2 * tile), tile, seed)
            seed += 1
    return seed


@kernel
def _claim(canvas: Canvas, window: Window, y: int, x: int, tile: int, seed: int) -> None:
    """Give a seed at (``y``, ``x``), in half cells, the cells around it to which no earlier seed is nearer."""
    first, last = max(window[1], x // 2 - tile), min(window[3], x // 2 + tile + 1)
    along = canvas.queue[: max(0, last - first)]  # what a column adds to the distance is the same in all rows
    for k in range(len(along)):
        offset = 2 * (first + k) - x
        along[k] = (offset * offset) << _SEED_BITS
    for r in range(max(window[0], y // 2 - tile), min(window[2], y // 2 + tile + 1)):
        row = canvas.distance[r, first : first + len(along)]
        here = np.int32(((2 * r - y) * (2 * r - y) << _SEED_BITS) | seed)
        for k in range(len(along)):
            row[k] = min(row[k], np.int32(along[k] + here))


@kernel
def _pave(canvas: Canvas, window: Window, street: int, plots: NDArray[np.int32]) -> int:
    """Build on all cells but the streets; count the cells of each polygon without them, and return the sum.

    A cell is a street if a cell to its right, below it or diagonally below has another seed. Later cells only are compared,
    so that streets are not twice as wide, and with the diagonal one, so that streets do not break where they turn.
    """
    top, left, bottom, right = window
    plots[:] = 0
    cells = 0
    for r in range(top, bottom):
        under = min(bottom - 1, r + street)
        # Slices, because Numba then knows that no index is negative, and the loops become vector instructions.
        row, seeds, below = canvas.city[r, left:right], canvas.distance[r, left:right], canvas.distance[under, left:right]
        inside = max(0, len(row) - street)
        beside, across = canvas.distance[r, right - inside : right], canvas.distance[under, right - inside : right]
        for c in range(inside):
            same = _same(seeds[c], beside[c]) & _same(seeds[c], below[c]) & _same(seeds[c], across[c])
            row[c] = BUILDING if same else FREE
        for c in range(inside, len(row)):
            row[c] = BUILDING if _same(seeds[c], below[c]) & _same(seeds[c], below[len(row) - 1]) else FREE
        for c in range(len(row)):
            plots[np.uint64(seeds[c] & _MASK)] += row[c] == BUILDING
    for k in range(len(plots)):
        cells += plots[k]
    return cells


@kernel
def _same(one: int, other: int) -> bool:
    """Return whether two cells have the same seed."""
    return np.int32(one ^ other) & np.int32(_MASK) == 0
