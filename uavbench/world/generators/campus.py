"""Campus: single buildings in the open, turned by angles of which each city has two.

The buildings are rectangles around the middles of tiles. All arithmetic is in integers: the directions are Pythagorean
triples, for which a rotation needs no sine.
"""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import BUILDING, FREE
from uavbench.world.generators.canvas import Canvas, Window, between
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer, next_uniform

#: Right-angled triangles: (a, b, n) with a² + b² = n², from 0° to 45°.
_DIRECTIONS = np.array([(1, 0, 1), (12, 5, 13), (15, 8, 17), (4, 3, 5), (21, 20, 29)], dtype=np.int64)
_UNITS = 8  # lengths are counted in eighths of a cell


@kernel
def draw_campus(cursor: NDArray[np.uint64], canvas: Canvas, window: Window, wanted: int) -> None:
    """Draw rotated rectangles in a window of a free canvas; see `uavbench.world.generators.blocks.draw_blocks`."""
    top, left, bottom, right = window
    share = wanted / ((bottom - top) * (right - left))
    tile = between(cursor, 6, 10)
    high, wide = max(1, (bottom - top + tile // 2) // tile), max(1, (right - left + tile // 2) // tile)
    most = next_integer(cursor, len(_DIRECTIONS))
    few = next_integer(cursor, len(_DIRECTIONS))
    mirrored = next_integer(cursor, 2) == 0
    for i in range(high):
        y0, y1 = top + ((bottom - top) * i) // high, top + ((bottom - top) * (i + 1)) // high
        for j in range(wide):
            x0, x1 = left + ((right - left) * j) // wide, left + ((right - left) * (j + 1)) // wide
            left_tiles = (high - i) * wide - j
            turn = _DIRECTIONS[few if next_integer(cursor, 4) == 0 else most]
            aim = wanted / left_tiles * next_uniform(cursor, 0.6, 1.4)
            wanted -= _build(
                cursor, canvas.city, window, (y0, x0, y1, x1), (turn[0], -turn[1] if mirrored else turn[1], turn[2]), aim
            )


@kernel
def _build(
    cursor: NDArray[np.uint64],
    city: NDArray[np.uint8],
    window: Window,
    tile: Window,
    turn: tuple[int, int, int],
    aim: float,
) -> int:
    """Draw a rectangle of about ``aim`` cells in a tile; return how many cells became buildings."""
    long = np.sqrt(max(1.0, aim) * next_uniform(cursor, 1.0, 2.6))
    long = min(long, 1.1 * max(tile[2] - tile[0], tile[3] - tile[1]))
    half_long, half_short = int(long * (_UNITS / 2)), int(max(1.0, aim) / long * (_UNITS / 2))
    if next_integer(cursor, 2) == 0:
        half_long, half_short = half_short, half_long
    y = ((tile[0] + tile[2] - 1) * _UNITS) // 2 + between(cursor, -_UNITS, _UNITS)
    x = ((tile[1] + tile[3] - 1) * _UNITS) // 2 + between(cursor, -_UNITS, _UNITS)
    a, b, n = turn
    reach = (half_long + half_short) // _UNITS + 1
    built = 0
    for r in range(max(window[0], y // _UNITS - reach), min(window[2], y // _UNITS + reach + 2)):
        for c in range(max(window[1], x // _UNITS - reach), min(window[3], x // _UNITS + reach + 2)):
            down, across = r * _UNITS - y, c * _UNITS - x
            inside = (abs(across * a + down * b) <= half_long * n) & (abs(down * a - across * b) <= half_short * n)
            built += inside & (city[r, c] == FREE)
            city[r, c] = BUILDING if inside else city[r, c]
    return built
