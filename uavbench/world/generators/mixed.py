"""Mixed: a city of one of the other four kinds, or a large city whose districts are of different kinds.

A map of fewer than 56 rows and columns is one district. Larger ones have districts of about 28 cells or more on each side.

Cities of 12 × 30 cells with the default parameters and a reach of 60 moves:

Key 0::

    .###.LLL......................
    .###.LLL.bbb............###...
    .###.LLL.bbb....bbbbb...###...
    .###.....bbbLL..bbbbb...###...
    .###.....bbbLL..bbbbb...###...
    ............LL................
    ...........##....###..........
    ...b......####...###..........
    ..bbb....####....###NN######..
    bbbbb.....##.....###NN######..
    bbbb..NNNNN......###NN######..
    .b....NNNNN......###..........

Key 1::

    ................LL............
    ................LL....NNNN....
    ................LL....NNNN....
    ....#.............############
    .####...........##############
    ######.......#################
    ######......##################
    .######LL....#################
    .####..LL....#######..........
    .#.....LL.....###..........LLL
    ..............#............LLL
    ...........................LLL

Key 2::

    ..............................
    #..###......##########..bbb..b
    #..###......##########..bbb..b
    #..###......##########..bbb..b
    #..###......##########..bbb..b
    ..............................
    .............LLL..............
    #..bbb..LL...LLL..####..###..#
    #..bbb..LL........####..###..#
    ........LL................LLL.
    ..........................LLL.
    ............####.............#
"""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.generators.blocks import draw_blocks
from uavbench.world.generators.campus import draw_campus
from uavbench.world.generators.canvas import Canvas, Window, between
from uavbench.world.generators.courtyards import draw_courtyards
from uavbench.world.generators.organic import draw_organic
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer

BLOCKS, COURTYARDS, ORGANIC, CAMPUS, MIXED = range(5)
_DISTRICT = 28  # the shortest side of a district, about


@kernel
def draw_kind(kind: int, cursor: NDArray[np.uint64], canvas: Canvas, window: Window, wanted: int) -> None:
    """Draw buildings of a kind in a window of a free canvas; see `uavbench.world.generators.blocks.draw_blocks`."""
    if kind == BLOCKS:
        draw_blocks(cursor, canvas, window, wanted)
    elif kind == COURTYARDS:
        draw_courtyards(cursor, canvas, window, wanted)
    elif kind == ORGANIC:
        draw_organic(cursor, canvas, window, wanted)
    else:
        draw_campus(cursor, canvas, window, wanted)


@kernel
def draw_mixed(cursor: NDArray[np.uint64], canvas: Canvas, window: Window, wanted: int) -> None:
    """Draw districts of the other kinds in a window of a free canvas, with streets between them."""
    top, left, bottom, right = window
    high, wide = max(1, (bottom - top) // _DISTRICT), max(1, (right - left) // _DISTRICT)
    street = between(cursor, 1, 2)
    y0 = top
    for i in range(high):
        y1 = bottom if i == high - 1 else top + ((bottom - top) * (i + 1)) // high + between(cursor, -4, 4)
        row_wanted = (wanted * (y1 - y0)) // (bottom - y0)
        wanted -= row_wanted
        x0 = left
        for j in range(wide):
            x1 = right if j == wide - 1 else left + ((right - left) * (j + 1)) // wide + between(cursor, -4, 4)
            part = (row_wanted * (x1 - x0)) // (right - x0)
            row_wanted -= part
            district = (y0, x0, y1 if y1 == bottom else y1 - street, x1 if x1 == right else x1 - street)
            draw_kind(next_integer(cursor, MIXED), cursor, canvas, district, part)
            x0 = x1
        y0 = y1
