"""No-fly zones and landing zones: rectangles on free cells, placed by chance."""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import FREE, LANDING, NO_FLY
from uavbench.world.generators.canvas import Canvas, Window, between
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer

_TRIALS = 12  # how often a place is drawn before a zone is made smaller or left out
_MOST_NO_FLY = 6  # no-fly zones cover at most one sixth of the map


@kernel
def free_cells(city: NDArray[np.uint8], window: Window) -> int:
    """Return how many cells of a window are free."""
    count = 0
    for r in range(window[0], window[2]):
        row = city[r, window[1] : window[3]]
        for c in range(len(row)):
            count += row[c] == FREE
    return count


@kernel
def draw_no_fly(cursor: NDArray[np.uint64], city: NDArray[np.uint8], zones: int, low: int, high: int) -> None:
    """Draw no-fly zones with sides from ``low`` to ``high``: the free cells of rectangles of which at least half are free."""
    rows, cols = city.shape[0] - 2, city.shape[1] - 2
    left = rows * cols // _MOST_NO_FLY
    for _ in range(zones):
        down, across = min(rows, between(cursor, low, high)), min(cols, between(cursor, low, high))
        for _ in range(_TRIALS):
            zone = _somewhere(cursor, rows, cols, down, across)
            free = free_cells(city, zone)
            if 2 * free >= down * across and free <= left:
                left -= free
                for r in range(zone[0], zone[2]):
                    for c in range(zone[1], zone[3]):
                        city[r, c] = NO_FLY if city[r, c] == FREE else city[r, c]
                break


@kernel
def find_landing(cursor: NDArray[np.uint64], city: NDArray[np.uint8], down: int, across: int) -> Window:
    """Return a rectangle of free cells: of the wanted sides, or of two cells each, or of one; empty if no cell is free."""
    rows, cols = city.shape[0] - 2, city.shape[1] - 2
    for smaller in range(2):
        if smaller:
            down, across = min(2, down), min(2, across)
        for _ in range(_TRIALS):
            zone = _somewhere(cursor, rows, cols, down, across)
            if free_cells(city, zone) == down * across:
                return zone
    start = next_integer(cursor, rows * cols)
    for k in range(rows * cols):
        r, c = divmod((start + k) % (rows * cols), cols)
        if city[r + 1, c + 1] == FREE:
            return r + 1, c + 1, r + 2, c + 2
    return 1, 1, 1, 1


@kernel
def landing_around(cursor: NDArray[np.uint64], city: NDArray[np.uint8], cell: int, down: int, across: int) -> Window:
    """Return a rectangle of free cells around ``cell``, an index into the flattened city; only that cell if there is none."""
    r, c = divmod(cell, city.shape[1])
    for smaller in range(2):
        if smaller:
            down, across = min(2, down), min(2, across)
        for _ in range(_TRIALS // 3):
            top, left = r - next_integer(cursor, down), c - next_integer(cursor, across)
            inside = top >= 1 and left >= 1 and top + down < city.shape[0] and left + across < city.shape[1]
            zone = (top, left, top + down, left + across)
            if inside and free_cells(city, zone) == down * across:
                return zone
    return r, c, r + 1, c + 1


@kernel
def mark_landing(canvas: Canvas, zone: Window, cells: NDArray[np.int32]) -> int:
    """Make all cells of a rectangle landing cells, and list them in ``cells``; return how many they are."""
    wide, count = canvas.city.shape[1], 0
    for r in range(zone[0], zone[2]):
        for c in range(zone[1], zone[3]):
            canvas.city[r, c] = LANDING
            cells[count] = r * wide + c
            count += 1
    return count


@kernel
def _somewhere(cursor: NDArray[np.uint64], rows: int, cols: int, down: int, across: int) -> Window:
    """Return a rectangle with the given sides somewhere on the map."""
    top, left = 1 + next_integer(cursor, rows - down + 1), 1 + next_integer(cursor, cols - across + 1)
    return top, left, top + down, left + across
