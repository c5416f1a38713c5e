"""Blocks: a grid of streets like Manhattan's.

The streets are straight, but not at equal distances and not of one width. Some blocks are joined with the next one, some are
split by an alley, and some stay open as squares.

Cities of 12 × 30 cells with the default parameters and a reach of 60 moves:

Key 0::

    #.................#####NNN####
    ...........LLL......LLLNNNNN..
    ...........LLL......LLLNNNNN..
    ...........LLL......LLLNNNNN..
    b..####...#####NNNNN.........#
    b..####...#####NNNNN......####
    b..####...#####NNNNN......####
    ..........#####NNNNN......####
    #..bbbb...#####NNNNNLLL...####
    #..bbbb...#####.....LLL...####
    #..bbbb...#####.....LLL...####
    #..bbbb...#####...........####

Key 1::

    ..###NNN....bbbbb..####..bbbbb
    ..###NNN....bbbbb..####..bbbbb
    ..###NNN....bbbbb..####..bbbbb
    ..###NNN....bbbbb..####..bbbbb
    ..NNNNNN......................
    ..NNNNNN......................
    .....LLLNN....NNNNNN..........
    ..###LLLNN....NNNNN######.####
    ..###.........NNNNN######.####
    LL###.........NNNNN######..LLL
    LL###.........NNNNN######..LLL
    LL###.........NNNNN######..LLL

Key 2::

    .....NNN.###....##.....###.bbb
    .....NNN.###....##.....###.bbb
    .........###....##.....###.bbb
    ..............................
    ....####.bbb.##........###.##.
    ....####.bbb.##........###.##.
    ....####.bbb.##........###.##.
    ..............................
    ###....NNNNNN...##.........bb.
    ###LLL.NNNNNN...##.LL......bb.
    ###LLL.NNNLL....##.LL......bb.
    ###LLL....LL....##.........bb.
"""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import BUILDING
from uavbench.world.generators.canvas import Canvas, Window, allotted, between, cut, fill
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer, next_uniform

_SMALLEST, _LARGEST = 3, 12  # cells along the shorter side of a block
_ELONGATIONS = 3  # the longer side of a block is 1, 1.5 or 2 times the shorter one


@kernel
def draw_blocks(cursor: NDArray[np.uint64], canvas: Canvas, window: Window, wanted: int) -> None:
    """Draw blocks in a window of a free canvas.

    Parameters
    ----------
    cursor : ndarray of uint64, shape (1,)
        The stream of random numbers.
    canvas : Canvas
        Where to draw.
    window : (int, int, int, int)
        The first row and column, and those behind the last ones.
    wanted : int
        How many cells of the window buildings shall cover, about.
    """
    top, left, bottom, right = window
    share = wanted / ((bottom - top) * (right - left))
    street = 1 + next_integer(cursor, 3)
    halves = 2 + next_integer(cursor, _ELONGATIONS)
    room = max(_SMALLEST, min(_LARGEST, (min(bottom - top, right - left) - 1) // 2))
    size, street = _sizes(min(0.88, share + next_uniform(cursor, 0.06, 0.2)), street, halves, room)
    down, across = size, (size * halves) // 2
    if next_integer(cursor, 2) == 0:
        down, across = across, down
    rows, cols = canvas.cuts[0], canvas.cuts[1]
    high, wide = cut(cursor, top, bottom, down, street, rows), cut(cursor, left, right, across, street, cols)
    remaining = _covered(rows, high) * _covered(cols, wide)
    for i in range(high):
        for j in range(wide):
            block = (rows[2 * i], cols[2 * j], rows[2 * i + 1], cols[2 * j + 1])
            area = (block[2] - block[0]) * (block[3] - block[1])
            cells = allotted(cursor, area, wanted, remaining, wanted / remaining)
            remaining -= area
            if cells > 0:
                joined = cols[2 * j + 2] if j + 1 < wide else right
                wanted -= _build(cursor, canvas.city, block, joined, cells, wanted - remaining)


@kernel
def _sizes(cover: float, street: int, halves: int, room: int) -> tuple[int, int]:
    """Return the side of blocks and the width of streets with which all blocks together cover about ``cover``.

    Streets are wider than ``street`` if even the smallest blocks would cover far more, and narrower if blocks would have to be
    larger than ``room``.
    """
    long = (_SMALLEST * halves) // 2
    if _SMALLEST * long > (cover + 0.15) * ((_SMALLEST + street) * (long + street)):
        street += 1
    for width in range(street, 0, -1):
        for size in range(_SMALLEST, room + 1):
            long = (size * halves) // 2
            if size * long >= cover * ((size + width) * (long + width)):
                return size, width
    return room, 1


@kernel
def _covered(cuts: NDArray[np.int64], blocks: int) -> int:
    """Return the sum of the sides of blocks."""
    cells = 0
    for k in range(blocks):
        cells += cuts[2 * k + 1] - cuts[2 * k]
    return cells


@kernel
def _build(cursor: NDArray[np.uint64], city: NDArray[np.uint8], block: Window, joined: int, cells: int, lacking: int) -> int:
    """Build ``cells`` cells of a block, about; return how many were built.

    ``joined`` is the column where the next block begins. If ``lacking`` is positive, even all later blocks as a whole do not
    suffice: then nothing is split, and streets are built over.
    """
    top, left, bottom, right = block
    high, wide = bottom - top, right - left
    if cells < high * wide:  # the rest of the wanted cells
        bottom = top + (cells + wide // 2) // wide
        if bottom == top + 1 and high > 1:
            return 0  # it would be a wall
        fill(city, (top, left, bottom, right), BUILDING)
        return (bottom - top) * wide
    roll = next_integer(cursor, 16)
    if lacking > 0 or roll == 0:
        if joined - right <= 2 and (lacking > 0 or roll < 2):
            right = joined
    elif roll < 5 and max(high, wide) >= 5:
        fill(city, block, BUILDING)
        return high * wide - _split(cursor, city, block)
    fill(city, (top, left, bottom, right), BUILDING)
    return high * (right - left)


@kernel
def _split(cursor: NDArray[np.uint64], city: NDArray[np.uint8], block: Window) -> int:
    """Cut an alley of one cell through a block, across its longer side; return its length."""
    top, left, bottom, right = block
    if bottom - top > right - left:
        alley = between(cursor, top + 2, bottom - 3)
        fill(city, (alley, left, alley + 1, right), 0)
        return right - left
    alley = between(cursor, left + 2, right - 3)
    fill(city, (top, alley, bottom, alley + 1), 0)
    return bottom - top
