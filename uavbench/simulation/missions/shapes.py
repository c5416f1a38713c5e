"""Random shapes, painted on a grid: the distribution of scikit-image's ``random_shapes`` with overlap allowed.

Compiled and keyed, so that an episode's targets depend on its key alone. Every choice below (which sizes fit, that a
rectangle's side is at least 2 cells, that polygons include their edges and ellipses do not) follows scikit-image 0.26;
`tests/simulation/missions/test_shapes.py` compares the two.
"""

import math

import numpy as np
from numpy.typing import NDArray

from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer, next_uniform

_SMALLEST = 2  # scikit-image's min_size
_TRIALS = 100  # how often a shape is drawn before it is skipped
RECTANGLE, CIRCLE, TRIANGLE, ELLIPSE = range(4)


@kernel
def paint_rectangle(grid: NDArray[np.uint8], r: int, c: int, height: int, width: int) -> None:
    """Paint the rectangle from (r, c) to (r + height, c + width), edges included."""
    for y in range(r, r + height + 1):
        _fill(grid[y, c : c + width + 1])


@kernel
def paint_triangle(grid: NDArray[np.uint8], r: int, c: int, side: int) -> None:
    """Paint the triangle with the base from (r, c) to (r, c + side) that points up, edges included, clipped at the top."""
    height, apex = math.ceil(math.sqrt(0.75) * side), side // 2
    for up in range(min(r, height) + 1):
        # The slanted edges are apex · up / height from the left end of the base, and (side − apex) · up / height from the
        # right end; both are rounded inwards, in integers.
        left = (up * apex + height - 1) // height
        right = side - (up * (side - apex) + height - 1) // height
        _fill(grid[r - up, c + left : c + right + 1])


@kernel
def paint_ellipse(grid: NDArray[np.uint8], r: int, c: int, row_radius: float, col_radius: float, rotation: float) -> None:
    """Paint the cells strictly inside a rotated ellipse around (r, c), clipped to the grid."""
    rows, cols = grid.shape
    rotation %= math.pi
    sine, cosine = math.sin(rotation), math.cos(rotation)
    reach_r = abs(row_radius * cosine) + col_radius * sine
    reach_c = row_radius * sine + abs(col_radius * cosine)
    top, bottom = max(0, math.ceil(r - reach_r)), min(rows - 1, math.floor(r + reach_r))
    left, right = max(0, math.ceil(c - reach_c)), min(cols - 1, math.floor(c + reach_c))
    for y in range(top, bottom + 1):
        row = grid[y, left : right + 1]
        for x in range(len(row)):
            along = ((y - r) * cosine + (x + left - c) * sine) / row_radius
            across = ((y - r) * sine - (x + left - c) * cosine) / col_radius
            row[x] |= along * along + across * across < 1.0


@kernel
def _fill(row: NDArray[np.uint8]) -> None:
    """Paint a row."""
    for x in range(len(row)):
        row[x] = 1


@kernel
def _draw_shape(cursor: NDArray[np.uint64], shape: int, grid: NDArray[np.uint8]) -> bool:
    """Draw a random shape of the kind ``shape``, and paint it if it fits; return whether it does."""
    rows, cols = grid.shape
    largest = max(rows, cols)
    c = next_integer(cursor, max(1, cols - _SMALLEST))
    r = next_integer(cursor, max(1, rows - _SMALLEST))
    if shape == RECTANGLE:
        height = _SMALLEST - 1 + next_integer(cursor, max(1, min(rows - r, largest) - _SMALLEST))
        width = _SMALLEST - 1 + next_integer(cursor, max(1, min(cols - c, largest) - _SMALLEST))
        paint_rectangle(grid, r, c, height, width)
        return True
    if shape == TRIANGLE:
        side = _SMALLEST - 1 + next_integer(cursor, max(1, min(cols - c, r, largest) - _SMALLEST))
        paint_triangle(grid, r, c, side)
        return True
    nearest_edge = min(c, cols - c, r, rows - r)
    if shape == CIRCLE:
        room = min(nearest_edge, largest // 2) - _SMALLEST // 2
        if room < 0:
            return False
        radius = _SMALLEST // 2 + next_integer(cursor, max(1, room))
        paint_ellipse(grid, r, c, radius, radius, 0.0)
        return True
    reach = min(nearest_edge, largest / 2.0)
    if reach < _SMALLEST / 2.0:
        return False
    row_radius = next_uniform(cursor, _SMALLEST / 2.0, reach + 1.0)
    col_radius = next_uniform(cursor, _SMALLEST / 2.0, reach + 1.0)
    paint_ellipse(grid, r, c, row_radius, col_radius, next_uniform(cursor, -math.pi, math.pi))
    return True


@kernel
def draw_shapes(cursor: NDArray[np.uint64], min_shapes: int, max_shapes: int, grid: NDArray[np.uint8]) -> tuple[int, int]:
    """Clear ``grid`` and paint ``min_shapes`` to ``max_shapes`` random shapes on it as 1.

    Returns
    -------
    painted : int
        Cells covered by the shapes.
    placed : int
        Shapes painted; a shape that does not fit in 100 trials is skipped.
    """
    grid[:] = 0
    placed = 0
    for _ in range(min_shapes + next_integer(cursor, max_shapes - min_shapes + 1)):
        shape = next_integer(cursor, 4)
        for _ in range(_TRIALS):
            if _draw_shape(cursor, shape, grid):
                placed += 1
                break
    painted = 0
    cells = grid.reshape(-1)
    for k in range(len(cells)):
        painted += int(cells[k])
    return painted, placed
