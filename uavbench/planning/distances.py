"""Distances between cells, for searches that look them up millions of times.

On small maps a table holds the distances between all pairs of cells. On large maps there is no memory for such a table, and a
search changes a flight only a little at a time: it needs the distances between cells that are near each other.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from uavbench.world.city import City
from uavbench.world.kernel import kernel

#: The value in a table of distances for pairs of cells without a path.
FAR = np.int16(np.iinfo(np.int16).max)

_LARGEST_WHOLE = 64 * 64  # cells: the table of a larger map would take more than 32 MB
REACH = 20  # rows or columns from the middle of a window to its border
_SIDE = 2 * REACH + 1
_NONE = np.uint8(255)  # in a window: no path
_WINDOWS = 2**17  # the most windows that are kept: 210 MB


class Windows(NamedTuple):
    """Distances between cells that are near each other on a large map. They are computed when they are first asked for.

    The window of a cell is the square of 41×41 cells around it. A distance to the cell counts only paths inside its window, so
    it may be larger than the true one where a shortest path leaves the window. It is the true one if that is at most `REACH`.

    Attributes
    ----------
    no_fly : ndarray of bool, shape (M, N)
        The cells that cannot be entered.
    number : ndarray of int32, shape (MN,)
        The row of ``moves`` that holds the window of a cell (row-major); −1 if it has not been computed.
    moves : ndarray of uint8, shape (windows, 41²)
        The number of moves to the middle of a window from its cells; 255 where there is no path, or only a longer one.
    used : ndarray of int64, shape (1,)
        How many rows of ``moves`` are in use.
    """

    no_fly: NDArray[np.bool_]
    number: NDArray[np.int32]
    moves: NDArray[np.uint8]
    used: NDArray[np.int64]


Distances = NDArray[np.int16] | Windows


def is_large(shape: tuple[int, int]) -> bool:
    """Return whether maps of ``shape`` (M, N) are too large for a table of all distances."""
    return shape[0] * shape[1] > _LARGEST_WHOLE


def distances_of(city: City) -> Distances:
    """Return the distances of a city: a table of all, or on a large map windows."""
    return _windows(city) if is_large(city.shape) else distance_table(city)


@lru_cache(maxsize=8)
def distance_table(city: City) -> NDArray[np.int16]:
    """Return the number of moves between all pairs of cells, in row-major order; shape (MN, MN), `FAR` where there is no path.

    The size of the table is quadratic in the number of cells: 2 MB at 32×32, 12.5 MB at 50×50.
    """
    rows, cols = city.shape
    table = np.full((rows * cols, rows * cols), FAR, dtype=np.int16)
    for r, c in np.argwhere(~city.no_fly).tolist():
        away = city.distances((r, c)).reshape(-1)
        table[r * cols + c] = np.where(away >= 0, away, FAR)
    table.flags.writeable = False
    return table


@lru_cache(maxsize=1)
def _windows(city: City) -> Windows:
    """Return windows of a city, none of which has been computed."""
    cells = city.no_fly.size
    moves = np.empty((min(cells, _WINDOWS), _SIDE * _SIDE), dtype=np.uint8)  # takes memory only where it is written
    return Windows(city.no_fly, np.full(cells, -1, dtype=np.int32), moves, np.zeros(1, dtype=np.int64))


def distances_to(distance: Distances, cols: int, here: int, there: int) -> tuple[NDArray[Any], int, int]:
    """Return the distances to ``there`` from the cells around it, for kernels.

    Returns
    -------
    to : ndarray of int, shape (rows · wide,)
        Moves to ``there`` from each cell of a part of the map, in row-major order.
    wide : int
        The number of columns of this part.
    at : int
        The index of ``here`` in ``to``; −1 if no path from ``here`` to ``there`` is known.
    """
    raise NotImplementedError("only kernels call it")


@overload(distances_to)
def _distances_to(distance: Any, cols: Any, here: Any, there: Any) -> Any:  # noqa: ARG001  # Numba passes the types
    """Choose by the type of ``distance`` when a kernel is compiled, so that small maps pay nothing for large ones."""
    if isinstance(distance, types.Array):
        return _in_table
    return _in_window


def _in_table(distance: Any, cols: Any, here: Any, there: Any) -> Any:
    to = distance[there]
    return to, cols, here if to[here] != FAR else -1


def _in_window(distance: Any, cols: Any, here: Any, there: Any) -> Any:
    number = distance.number[there]
    down = here // cols - there // cols + REACH
    right = here % cols - there % cols + REACH
    if not (0 <= down < _SIDE and 0 <= right < _SIDE) or distance.no_fly[there // cols, there % cols]:
        return distance.moves[0], _SIDE, -1
    if number < 0:
        number = _compute_window(distance, there)
    to = distance.moves[number]
    at = down * _SIDE + right
    return to, _SIDE, at if to[at] != _NONE else -1


def moves(distance: Distances, cols: int, here: int, there: int) -> int:
    """Return the number of moves from ``here`` to ``there``, for kernels; −1 where no path is known."""
    raise NotImplementedError("only kernels call it")


@overload(moves)
def _moves(distance: Any, cols: Any, here: Any, there: Any) -> Any:  # noqa: ARG001  # Numba passes the types
    """Choose by the type of ``distance`` when a kernel is compiled."""
    return _moves_in_table if isinstance(distance, types.Array) else _moves_in_window


def _moves_in_table(distance: Any, cols: Any, here: Any, there: Any) -> Any:  # noqa: ARG001  # the signature is that of `moves`
    away = np.int64(distance[there, here])
    return away if away != FAR else -1


def _moves_in_window(distance: Any, cols: Any, here: Any, there: Any) -> Any:
    to, _wide, at = distances_to(distance, cols, here, there)
    return np.int64(to[at]) if at >= 0 else -1


@kernel
def _compute_window(windows: Windows, middle: int) -> int:
    """Compute the window of a cell by a breadth-first search; return its row. When all rows are in use, all are given up."""
    rows, cols = windows.no_fly.shape
    if windows.used[0] == len(windows.moves):
        windows.number[:] = -1
        windows.used[0] = 0
    number = windows.used[0]
    windows.used[0] += 1
    windows.number[middle] = number
    moves = windows.moves[number]
    moves[:] = _NONE
    top, left = middle // cols - REACH, middle % cols - REACH
    queue = np.empty(_SIDE * _SIDE, dtype=np.int32)
    queue[0] = REACH * _SIDE + REACH
    moves[queue[0]] = 0
    tail = 1
    for head in range(len(queue)):
        if head == tail:
            break
        down, right = queue[head] // _SIDE, queue[head] % _SIDE
        beyond = moves[queue[head]] + 1
        if beyond == _NONE:
            break
        for k in range(4):
            y, x = down + (-1, 0, 1, 0)[k], right + (0, 1, 0, -1)[k]
            r, c = top + y, left + x
            if not (0 <= y < _SIDE and 0 <= x < _SIDE and 0 <= r < rows and 0 <= c < cols) or windows.no_fly[r, c]:
                continue
            if moves[y * _SIDE + x] == _NONE:
                moves[y * _SIDE + x] = beyond
                queue[tail] = y * _SIDE + x
                tail += 1
    return int(number)
