"""The random changes of a flight that a search tries."""

import numpy as np
from numpy.typing import NDArray

from uavbench.planning.distances import Distances
from uavbench.planning.paths import pick, reaches, walk
from uavbench.world.kernel import kernel


@kernel
def propose(
    path: NDArray[np.int32],
    length: int,
    distance: Distances,
    shape: tuple[int, int],
    landing: NDArray[np.int32],
    aims: NDArray[np.int64],
    served: NDArray[np.int32],
    hovers: bool,
    horizon: int,
    cursor: NDArray[np.uint64],
    new: NDArray[np.int32],
) -> tuple[int, int, int]:
    """Propose to replace the cells of a flight between the indices ``first`` and ``after`` by ``size`` cells in ``new``.

    The flight consists of the cells 0 to ``length`` of ``path``, and its last cell is a landing cell. ``aims`` are cells that
    the flight should come near to, as long as their ``served`` is 0. ``shape`` is that of the map, (M, N).
    Changes begin in the first ``horizon`` cells.

    Returns ``first``, ``after`` (``length`` + 1 to replace the end too) and ``size`` (−1 for no proposal). The cells ``first``
    and ``after`` themselves are kept.
    """
    rows, cols = shape
    if hovers and pick(cursor, 3) == 0:
        return _propose_hover(path, length, horizon, cursor, new)
    kind = pick(cursor, 100)
    span = pick(cursor, 9)
    if kind >= 54:
        span = pick(cursor, 25 if kind < 85 else 61)
    first = pick(cursor, min(horizon, length + 1))
    after = first + 1 + span
    reaches_end = after > length
    here = path[first]
    if kind >= 94 and not reaches_end:  # fly a part of the flight in the reverse direction
        if span < 2 or not reaches(distance, cols, here, path[after - 1]):
            return 0, 0, -1
        size = walk(distance, cols, here, path[after - 1], True, cursor, new, 0)
        for k in range(after - 2, first, -1):
            new[size] = path[k]
            size += 1
        if not reaches(distance, cols, path[first + 1], path[after]):
            return 0, 0, -1
        return first, after, walk(distance, cols, path[first + 1], path[after], True, cursor, new, size) - 1
    after = min(after, length + 1)
    there = path[length] if reaches_end else path[after]
    if reaches_end and pick(cursor, 2):
        there = landing[pick(cursor, len(landing))]
    ways = pick(cursor, 100)
    stops = 0 if ways < 20 else (1 if ways < 75 else 2)
    middle = path[min(length, first + (span + 1) // 2)]
    straight = pick(cursor, 2) == 0
    size = 0
    for stop in range(stops):
        around, reach = middle, 7
        if stop > 0:
            around = here
        elif pick(cursor, 5) == 0 and len(aims) > 0:
            for _ in range(8):
                k = pick(cursor, len(aims))
                if served[k] == 0:
                    around, reach = aims[k], 2
                    break
        r = around // cols + pick(cursor, 2 * reach + 1) - reach
        c = around % cols + pick(cursor, 2 * reach + 1) - reach
        if not (0 <= r < rows and 0 <= c < cols) or not reaches(distance, cols, here, r * cols + c):
            return 0, 0, -1
        size = walk(distance, cols, here, r * cols + c, straight, cursor, new, size)
        here = r * cols + c
    if not reaches(distance, cols, here, there):
        return 0, 0, -1
    size = walk(distance, cols, here, there, straight, cursor, new, size)
    if reaches_end:
        return first, after, size
    return (first, after, size - 1) if size > 0 else (first, after + 1, 0)  # a loop is cut out, with its last cell


@kernel
def _propose_hover(
    path: NDArray[np.int32], length: int, horizon: int, cursor: NDArray[np.uint64], new: NDArray[np.int32]
) -> tuple[int, int, int]:
    """Propose to hover longer, or less long, in a cell of the flight; as `propose`."""
    first = pick(cursor, min(horizon, length + 1))
    if pick(cursor, 2):
        size = 1 + pick(cursor, 4)
        for k in range(size):
            new[k] = path[first]
        return first, first + 1, size
    after = first + 1
    most = 1 + pick(cursor, 4)
    while after <= length and after - first <= most and path[after] == path[first]:
        after += 1
    return first, after, 0 if after > first + 1 else -1
