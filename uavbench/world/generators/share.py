"""The last correction of the share of buildings, for the few cities in which a generator has missed it."""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import BUILDING, FREE
from uavbench.world.generators.canvas import Canvas, between, fill
from uavbench.world.generators.zones import free_cells
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_integer

_TOLERATED = 40  # one cell in so many may be missing, or too much
_TRIALS = 100


@kernel
def correct_share(cursor: NDArray[np.uint64], canvas: Canvas, wanted: int) -> None:
    """Build more, or clear some cells of buildings, if their number is far from the wanted one."""
    city = canvas.city
    missing = wanted
    cells = city.reshape(-1)
    for k in range(len(cells)):
        missing -= cells[k] == BUILDING
    tolerated = (city.shape[0] - 2) * (city.shape[1] - 2) // _TOLERATED
    if missing > tolerated:
        _add_houses(cursor, city, missing)
    elif missing < -tolerated:
        _cut_streets(cursor, city, -missing)


@kernel
def _add_houses(cursor: NDArray[np.uint64], city: NDArray[np.uint8], missing: int) -> None:
    """Build small houses where they and the cells around them are free, until nothing is missing or no room is found."""
    for _ in range(_TRIALS + missing // 4):
        down, across = between(cursor, 2, 4), between(cursor, 2, 4)
        top = 1 + next_integer(cursor, city.shape[0] - 1 - down)
        left = 1 + next_integer(cursor, city.shape[1] - 1 - across)
        bottom, right = top + down, left + across
        around = (max(1, top - 1), max(1, left - 1), min(city.shape[0] - 1, bottom + 1), min(city.shape[1] - 1, right + 1))
        if missing > 1 and free_cells(city, around) == (around[2] - around[0]) * (around[3] - around[1]):
            fill(city, (top, left, bottom, right), BUILDING)
            missing -= down * across


@kernel
def _cut_streets(cursor: NDArray[np.uint64], city: NDArray[np.uint8], excess: int) -> None:
    """Clear the cells of buildings in rows and columns, one after the other, until there is no excess."""
    rows, cols = city.shape[0] - 2, city.shape[1] - 2
    row, col = next_integer(cursor, rows), next_integer(cursor, cols)
    for k in range(max(rows, cols)):
        for c in range(1, cols + 1):
            if excess > 0 and city[1 + (row + 5 * k) % rows, c] == BUILDING:
                city[1 + (row + 5 * k) % rows, c] = FREE
                excess -= 1
        for r in range(1, rows + 1):
            if excess > 0 and city[r, 1 + (col + 5 * k) % cols] == BUILDING:
                city[r, 1 + (col + 5 * k) % cols] = FREE
                excess -= 1
        if excess <= 0:
            break
