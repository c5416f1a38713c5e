"""Courtyards: buildings with the shapes of the letters O, U, L and T, whose yards are open to a street.

Each row of plots is cut by streets of its own, so that streets in one direction end at those in the other one.

Cities of 12 × 30 cells with the default parameters and a reach of 60 moves:

Key 0::

    ###.#####.bbbbb...............
    ..............................
    ..#..#.........######.#.....##
    ..#..#.........#....#.#.....##
    ..#..#............NN#N#N....##
    ..####.........######N#####.##
    ..................NNNNNN......
    ###.######.bbbbb.##NNNNNNNN...
    #.....#....bbbbb.##NNNNNNNN...
    #.#...#....bb....##...........
    #.#...#LLL.bbbbb.######.......
    ###...#LLL.bbbbb.######.......

Key 1::

    .....####.bbbbbb.#####....LLNN
    .....####.bbbbbb.#####LLL.LLNN
    ...NNNNNN.............LLL...NN
    ...NNNNNN...................NN
    #.##NbbbbbbNNNN#.####.#.##.###
    #..#NbNNN.bNNNN#.#....#..#...#
    #..#NNNNN.bNNNN#.#..#.#..#...#
    #..#NbbbbbbN####.####.####...#
    ...........NNNNN..............
    ...........LL.................
    bbbbb......LL#####.######.....
    bbbbb........#####.######.....

Key 2::

    ...#####..........bbbbb..####.
    ...#...#.LLL......bbbbb.....#.
    ...#...#.LLL......bbbbb.....#.
    ...##.##.LLL......bbbbb..####.
    ..............................
    ..............................
    .NNN....####..####...#####....
    .NNN....####..#......#####....
    .NNN....####..#..#...#####....
    .NNN....####..#..#...#####.LL.
    .NNN....####..####...#####.LL.
    ..............................
"""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import BUILDING, FREE
from uavbench.world.generators.canvas import Canvas, Window, between, chance, cut, fill
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer, next_uniform

_TOP, _BOTTOM, _LEFT, _RIGHT = 1, 2, 4, 8
_ALL = _TOP + _BOTTOM + _LEFT + _RIGHT
#: The sides of a plot along which a building stands, for each shape: O, which is the most common one, U and L.
_SHAPES = (15, 15, 15, 15, 15, 15, 15, 15, 7, 11, 13, 14, 5, 6, 9, 10)
_TEE = len(_SHAPES)  # one side and a wing in the middle


@kernel
def draw_courtyards(cursor: NDArray[np.uint64], canvas: Canvas, window: Window, wanted: int) -> None:
    """Draw buildings with yards in a window of a free canvas; see `uavbench.world.generators.blocks.draw_blocks`."""
    top, left, bottom, right = window
    share = wanted / ((bottom - top) * (right - left))
    street = 1 + (next_integer(cursor, 3) == 0 and share < 0.4)
    room = max(3, (min(bottom - top, right - left) - 1) // 2)
    down, across = min(room, between(cursor, 5, 8)), min(room, between(cursor, 6, 10))
    if next_integer(cursor, 2) == 0:
        down, across = across, down
    rows, cols = canvas.cuts[0], canvas.cuts[1]
    high = cut(cursor, top, bottom, down, street, rows)
    for i in range(high):
        wide = cut(cursor, left, right, across, street, cols)
        depth = rows[2 * i + 1] - rows[2 * i]
        # This row's part of what is left to build, by depth; what it builds too much or too little is left to later rows.
        below = 0
        for k in range(i, high):
            below += rows[2 * k + 1] - rows[2 * k]
        row_wanted, width = (wanted * depth) // below, 0
        wanted -= row_wanted
        for j in range(wide):
            width += cols[2 * j + 1] - cols[2 * j]
        for j in range(wide):
            side = cols[2 * j + 1] - cols[2 * j]
            plot = (rows[2 * i], cols[2 * j], rows[2 * i + 1], cols[2 * j + 1])
            row_wanted -= _build(cursor, canvas.city, window, plot, row_wanted / (width * depth))
            width -= side
        wanted += row_wanted


@kernel
def _build(cursor: NDArray[np.uint64], city: NDArray[np.uint8], window: Window, plot: Window, fraction: float) -> int:
    """Build on about the fraction of a plot that is wanted in the mean; return the number of cells."""
    top, left, bottom, right = plot
    high, wide = bottom - top, right - left
    aim = fraction * next_uniform(cursor, 0.7, 1.3) * (high * wide)
    shape = next_integer(cursor, _TEE + 2)
    thick = 2 if min(high, wide) >= 5 and next_integer(cursor, 3) > 0 else 1
    area = _area(shape, high, wide, thick)
    for thicker in range(thick + 1, (min(high, wide) + 1) // 2):
        if _area(shape, high, wide, thicker) + area < 2.0 * aim:  # nearer to the aim
            thick, area = thicker, _area(shape, high, wide, thicker)
    if area > aim and not chance(cursor, aim / area):
        return 0
    if aim > 0.92 * (high * wide) or min(high, wide) < 3 or 2 * aim > area + high * wide:
        fill(city, plot, BUILDING)
        return high * wide
    if shape >= _TEE:
        _draw_tee(city, plot, thick, shape, next_integer(cursor, 2) == 0)
        return area
    sides = _inwards(window, plot, _SHAPES[shape])
    yard = _yard(plot, sides, thick)
    fill(city, plot, BUILDING)
    fill(city, yard, FREE)
    return area - (_open(cursor, city, window, plot, yard) if sides == _ALL else 0)


@kernel
def _area(shape: int, high: int, wide: int, thick: int) -> int:
    """Return how many cells a building has, without the opening of an O."""
    if shape == _TEE:
        return thick * wide + thick * (high - thick)
    if shape > _TEE:
        return thick * high + thick * (wide - thick)
    top, left, bottom, right = _yard((0, 0, high, wide), _SHAPES[shape], thick)
    return high * wide - max(0, bottom - top) * max(0, right - left)


@kernel
def _yard(plot: Window, sides: int, thick: int) -> Window:
    """Return the part of a plot that stays free if buildings stand along some of its sides."""
    return (
        plot[0] + (thick if sides & _TOP else 0),
        plot[1] + (thick if sides & _LEFT else 0),
        plot[2] - (thick if sides & _BOTTOM else 0),
        plot[3] - (thick if sides & _RIGHT else 0),
    )


@kernel
def _inwards(window: Window, plot: Window, sides: int) -> int:
    """Turn a shape around if its open side is at the edge of the window, where no street would lead to its yard."""
    if sides & (_TOP + _BOTTOM) in (_TOP, _BOTTOM) and plot[0 if sides & _BOTTOM else 2] == window[0 if sides & _BOTTOM else 2]:
        sides ^= _TOP + _BOTTOM
    if sides & (_LEFT + _RIGHT) in (_LEFT, _RIGHT) and plot[1 if sides & _RIGHT else 3] == window[1 if sides & _RIGHT else 3]:
        sides ^= _LEFT + _RIGHT
    return sides


@kernel
def _draw_tee(city: NDArray[np.uint8], plot: Window, thick: int, shape: int, first: bool) -> None:
    """Draw one side of a plot, the first or the last one, and a wing from its middle to the other side."""
    top, left, bottom, right = plot
    if shape == _TEE:
        middle, bar = (left + right - thick) // 2, top if first else bottom - thick
        fill(city, (bar, left, bar + thick, right), BUILDING)
        fill(city, (top, middle, bottom, middle + thick), BUILDING)
    else:
        middle, bar = (top + bottom - thick) // 2, left if first else right - thick
        fill(city, (top, bar, bottom, bar + thick), BUILDING)
        fill(city, (middle, left, middle + thick, right), BUILDING)


@kernel
def _open(cursor: NDArray[np.uint64], city: NDArray[np.uint8], window: Window, plot: Window, yard: Window) -> int:
    """Cut a passage from a yard to one side of its plot, one or two cells wide; return how many cells it takes."""
    side = next_integer(cursor, 4)  # top, left, bottom, right
    if plot[side] == window[side]:
        side = (side + 2) % 4
    upright = side % 2 == 0
    begin, end = (yard[1], yard[3]) if upright else (yard[0], yard[2])
    if end <= begin:
        return 0
    gap = 2 if end - begin >= 4 and next_integer(cursor, 2) == 0 else 1
    at = between(cursor, begin, end - gap)
    if side == 0:
        passage = (plot[0], at, yard[0], at + gap)
    elif side == 1:
        passage = (at, plot[1], at + gap, yard[1])
    elif side == 2:
        passage = (yard[2], at, plot[2], at + gap)
    else:
        passage = (at, yard[3], at + gap, plot[3])
    fill(city, passage, FREE)
    return (passage[2] - passage[0]) * (passage[3] - passage[1])
