"""Which buildings are low: whole buildings, until their share is about the wanted one."""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import BUILDING, LOW_BUILDING
from uavbench.world.generators.canvas import Canvas
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_uniform

_DONE = 5  # a high building, while the others are still to be looked at


@kernel
def lower_buildings(cursor: NDArray[np.uint64], canvas: Canvas, share: float) -> None:
    """Make a share of the cells of buildings low.

    All cells of buildings that touch at a side are one building. A building is low by chance; the chance grows with what is
    missing at the share of all buildings so far, and falls with what exceeds it.
    """
    if share <= 0.0:
        return
    wide = canvas.city.shape[1]
    city, queue = canvas.city.reshape(-1), canvas.queue
    seen = low = 0
    for cell in range(wide + 1, len(city) - wide - 1):
        if city[cell] != BUILDING:
            continue
        size = _flood(city, queue, cell, wide)
        seen += size
        if low + next_uniform(cursor, 0.0, 1.0) * size < share * seen:
            low += size
            for k in range(size):
                city[queue[k]] = LOW_BUILDING
    for cell in range(len(city)):
        city[cell] = BUILDING if city[cell] == _DONE else city[cell]


@kernel
def _flood(city: NDArray[np.uint8], queue: NDArray[np.int32], start: int, wide: int) -> int:
    """List the cells of the building around ``start``, and mark them as done; return how many they are."""
    city[start], queue[0] = _DONE, start
    head, tail = 0, 1
    while head < tail:
        cell = queue[head]
        head += 1
        tail = _take(city, queue, tail, cell - wide)
        tail = _take(city, queue, tail, cell + 1)
        tail = _take(city, queue, tail, cell + wide)
        tail = _take(city, queue, tail, cell - 1)
    return tail


@kernel
def _take(city: NDArray[np.uint8], queue: NDArray[np.int32], tail: int, cell: int) -> int:
    """Add a cell to the list if it belongs to a building that is not done; without a branch, which would be slower."""
    place, code = np.uint64(cell), city[np.uint64(cell)]
    new = code == BUILDING
    queue[np.uint64(tail)] = cell
    city[place] = _DONE if new else code
    return tail + new
