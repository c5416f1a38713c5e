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
from uavbench.world.generators.canvas import Canvas, between
from uavbench.world.generators.courtyards import draw_courtyards
from uavbench.world.generators.organic import draw_organic
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer

BLOCKS, COURTYARDS, ORGANIC, CAMPUS, MIXED = range(5)
_DISTRICT = 28  # the shortest side of a district, about


@kernel
def draw_buildings(kind: int, cursor: NDArray[np.uint64], canvas: Canvas, wanted: int) -> None:
    """Draw buildings of a kind on a free canvas, or those of several kinds in districts with streets between them.

    Parameters
    ----------
    kind : int
        A constant of this module.
    cursor : ndarray of uint64, shape (1,)
        The stream of random numbers.
    canvas : Canvas
        Where to draw.
    wanted : int
        How many cells buildings shall cover, about.
    """
    bottom, right = canvas.city.shape[0] - 1, canvas.city.shape[1] - 1
    high = wide = street = 1
    if kind == MIXED:
        high, wide, street = max(1, bottom // _DISTRICT), max(1, right // _DISTRICT), between(cursor, 1, 2)
    first = min(1, bottom)  # the number 1, but not as a constant, for which Numba would compile all generators once more
    y0 = first
    for i in range(high):
        y1 = bottom if i == high - 1 else (bottom * (i + 1)) // high + between(cursor, -4, 4)
        row_wanted = (wanted * (y1 - y0)) // (bottom - y0)
        wanted -= row_wanted
        x0 = first
        for j in range(wide):
            x1 = right if j == wide - 1 else (right * (j + 1)) // wide + between(cursor, -4, 4)
            part = (row_wanted * (x1 - x0)) // (right - x0)
            row_wanted -= part
            district = (y0, x0, y1 if y1 == bottom else y1 - street, x1 if x1 == right else x1 - street)
            here = next_integer(cursor, MIXED) if kind == MIXED else kind
            if here == BLOCKS:
                draw_blocks(cursor, canvas, district, part)
            elif here == COURTYARDS:
                draw_courtyards(cursor, canvas, district, part)
            elif here == ORGANIC:
                draw_organic(cursor, canvas, district, part)
            else:
                draw_campus(cursor, canvas, district, part)
            x0 = x1
        y0 = y1
