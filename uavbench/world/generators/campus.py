"""Campus: single buildings in the open, turned by angles of which each city has two.

The buildings are rectangles around the middles of tiles. All arithmetic is in integers: the directions are Pythagorean
triples, for which a rotation needs no sine.

Cities of 12 × 30 cells with the default parameters and a reach of 60 moves:

Key 0::

    ..............................
    .........................###..
    ..##.......NNbb.........#####.
    .####......Nbbbb......########
    ######.....bbbbbb....#########
    .######...bbbbbbbb....#######.
    ..######...bbbbbb......#####..
    ...######...bbbb........###...
    ..LL#####....bb..........#....
    ..LL.###......................
    ......#.......................
    ..............................

Key 1::

    ...NNN#.......................
    ...NN###........#...........#.
    ....#####......###.........###
    ...#######...######.......####
    ...#######...#######.....#####
    ...N#####NNNNN######....######
    ...NN###NNNNNN.####....#######
    ...NNN#NNNNNNN..##....########
    ...NNNNNNNNNNN.......#########
    ...NNNNNN............########.
    ...............LLL....######..
    ...............LLL............

Key 2::

    ..............................
    ..###.........###.......bbbbbb
    ..###.#####...#########.bbbbbb
    ..###.#####...#########.LLL...
    ..###.........###.......LLL...
    ..###...................LLL...
    ......................NNNNNN..
    .........bb...........NNNNNN..
    .........bb........#####N###.#
    .........bb........#####N###.#
    .........bb........#####......
    .........bb........#####......
"""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import BUILDING, FREE
from uavbench.world.generators.canvas import Canvas, Window, between, chance
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer, next_uniform

#: Right-angled triangles: (a, b, n) with a² + b² = n², from 0° to 45°. Most campuses follow the compass.
_DIRECTIONS = np.array([(1, 0, 1), (1, 0, 1), (12, 5, 13), (15, 8, 17), (4, 3, 5), (21, 20, 29)], dtype=np.int64)
_UNITS = 8  # lengths are counted in eighths of a cell
_SMALLEST = 12  # cells of a building


@kernel
def draw_campus(cursor: NDArray[np.uint64], canvas: Canvas, window: Window, wanted: int) -> None:
    """Draw rotated rectangles in a window of a free canvas; see `uavbench.world.generators.blocks.draw_blocks`."""
    top, left, bottom, right = window
    tile = between(cursor, 6, 10)
    high, wide = max(1, (bottom - top + tile // 2) // tile), max(1, (right - left + tile // 2) // tile)
    most, few = next_integer(cursor, len(_DIRECTIONS)), next_integer(cursor, len(_DIRECTIONS))
    hand = -1 if next_integer(cursor, 2) == 0 else 1
    for i in range(high):
        y0, y1 = top + ((bottom - top) * i) // high, top + ((bottom - top) * (i + 1)) // high
        for j in range(wide):
            x0, x1 = left + ((right - left) * j) // wide, left + ((right - left) * (j + 1)) // wide
            aim = wanted / ((high - i) * wide - j)  # of the wanted cells, as much as one tile's part
            turn = few if next_integer(cursor, 5) == 0 else most
            a, b, n = _DIRECTIONS[turn, 0], hand * _DIRECTIONS[turn, 1], _DIRECTIONS[turn, 2]
            wanted -= _build(cursor, canvas.city, window, (y0, x0, y1, x1), (a, b, n), aim)


@kernel
def _build(
    cursor: NDArray[np.uint64],
    city: NDArray[np.uint8],
    window: Window,
    tile: Window,
    turn: tuple[int, int, int],
    aim: float,
) -> int:
    """Draw a rectangle of about ``aim`` cells in a tile, or with a chance a larger one; return how many cells are new."""
    aim *= next_uniform(cursor, 0.6, 1.4)
    if aim < _SMALLEST:
        if not chance(cursor, aim / _SMALLEST):
            return 0
        aim = _SMALLEST
    long = np.sqrt(aim * next_uniform(cursor, 1.0, 2.6))
    along, across = int(long * (_UNITS / 2)), int(aim / long * (_UNITS / 2))  # half of the sides
    if next_integer(cursor, 2) == 0:
        along, across = across, along
    wiggle = (tile[2] - tile[0]) * _UNITS // 6
    y = ((tile[0] + tile[2] - 1) * _UNITS) // 2 + between(cursor, -wiggle, wiggle)
    x = ((tile[1] + tile[3] - 1) * _UNITS) // 2 + between(cursor, -wiggle, wiggle)
    a, b, n = turn
    high, wide = (along * abs(b) + across * a) // n + 1, (along * a + across * abs(b)) // n + 1  # of the box around it
    top, bottom = max(window[0], (y - high) // _UNITS), min(window[2], (y + high) // _UNITS + 1)
    left, right = max(window[1], (x - wide) // _UNITS), min(window[3], (x + wide) // _UNITS + 1)
    built = 0
    for r in range(top, bottom):
        for c in range(left, right):
            down, over = r * _UNITS - y, c * _UNITS - x
            inside = (abs(over * a + down * b) <= along * n) & (abs(down * a - over * b) <= across * n)
            built += inside & (city[r, c] == FREE)
            city[r, c] = BUILDING if inside else city[r, c]
    return built
