"""The random changes of a flight that a search tries."""

import numpy as np
from numpy.typing import NDArray

from uavbench.planning.distances import Distances, moves
from uavbench.planning.paths import pick, skip_walk, walk
from uavbench.world.kernel import kernel

_REACH = 7  # rows or columns to the farthest cell to fly over


@kernel
def propose(
    path: NDArray[np.int32],
    length: int,
    longest: int,
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

    The flight consists of the cells 0 to ``length`` of ``path``, and its last cell is a landing cell. After the change it has
    at most ``longest`` moves. ``aims`` are cells that the flight should come near to, as long as their ``served`` is 0.
    ``shape`` is that of the map, (M, N). Changes begin in the first ``horizon`` cells.

    Returns ``first``, ``after`` (``length`` + 1 to replace the end too) and ``size`` (−1 for no proposal). The cells ``first``
    and ``after`` themselves are kept. Cells at both ends of the part that would be replaced by the same ones are left out.
    """
    if hovers and pick(cursor, 3) == 0:
        first, after, size = _hover(path, length, longest, horizon, cursor, new)
        return _without_same(path, first, after, size, new)
    kind = pick(cursor, 100)
    span = pick(cursor, 9)
    if kind >= 54:
        span = pick(cursor, 25 if kind < 85 else 61)
    first = pick(cursor, min(horizon, length + 1))
    after = first + 1 + span
    if kind >= 94 and after <= length:  # fly a part of the flight in the reverse direction
        size = _reverse(path, length, longest, distance, shape[1], first, after, cursor, new)
    else:
        first, after, size = _replace(path, length, longest, distance, shape, landing, aims, served, first, after, cursor, new)
    return _without_same(path, first, after, size, new)


@kernel
def _replace(
    path: NDArray[np.int32],
    length: int,
    longest: int,
    distance: Distances,
    shape: tuple[int, int],
    landing: NDArray[np.int32],
    aims: NDArray[np.int64],
    served: NDArray[np.int32],
    first: int,
    after: int,
    cursor: NDArray[np.uint64],
    new: NDArray[np.int32],
) -> tuple[int, int, int]:
    """Propose to fly from cell ``first`` to cell ``after``, or to a landing cell at the end, over up to two other cells.

    It takes the same random numbers whether or not the change would be too long.
    """
    cols, start = shape[1], int(path[first])
    reaches_end = after > length
    there = int(path[min(after, length)])
    if reaches_end and pick(cursor, 2):
        there = int(landing[pick(cursor, len(landing))])
    ways = pick(cursor, 100)
    stops = 0 if ways < 20 else (1 if ways < 75 else 2)
    middle, after = int(path[min(length, first + (after - first) // 2)]), min(after, length + 1)
    straight = pick(cursor, 2) == 0
    rest = first if reaches_end else first + length - after
    # First it finds out how long the change is, and only then, if it is not too long, its cells.
    once = twice = start
    begin = then = cursor[0]
    away = 0
    if stops > 0:
        around, reach = middle, _REACH
        if pick(cursor, 5) == 0 and len(aims) > 0:
            around, reach = _aim(aims, served, around, reach, cursor)
        once = twice = _cell_around(around, reach, shape, cursor)
        away = moves(distance, cols, start, once) if once >= 0 else -1
        if away < 0:
            return 0, 0, -1
        begin = cursor[0]
        skip_walk(away, straight, cursor)
        rest += away
    if stops > 1:
        twice = _cell_around(once, _REACH, shape, cursor)
        away = moves(distance, cols, once, twice) if twice >= 0 else -1
        if away < 0:
            return 0, 0, -1
        then = cursor[0]
        skip_walk(away, straight, cursor)
        rest += away
    away = moves(distance, cols, twice, there)
    if away < 0:
        return 0, 0, -1
    last = cursor[0]
    skip_walk(away, straight, cursor)
    if rest + away > longest:
        return 0, 0, -1
    end, size = cursor[0], 0
    if stops > 0:
        cursor[0] = begin
        size = walk(distance, cols, start, once, straight, cursor, new, size)
    if stops > 1:
        cursor[0] = then
        size = walk(distance, cols, once, twice, straight, cursor, new, size)
    cursor[0] = last
    size = walk(distance, cols, twice, there, straight, cursor, new, size)
    cursor[0] = end
    if reaches_end:
        return first, after, size
    return (first, after, size - 1) if size > 0 else (first, after + 1, 0)  # a loop is cut out, with its last cell


@kernel
def _cell_around(middle: int, reach: int, shape: tuple[int, int], cursor: NDArray[np.uint64]) -> int:
    """Draw a cell at most ``reach`` rows and columns away from another one; −1 if it is outside the map."""
    rows, cols = shape
    r = middle // cols + pick(cursor, 2 * reach + 1) - reach
    c = middle % cols + pick(cursor, 2 * reach + 1) - reach
    return r * cols + c if 0 <= r < rows and 0 <= c < cols else -1


@kernel
def _aim(
    aims: NDArray[np.int64], served: NDArray[np.int32], around: int, reach: int, cursor: NDArray[np.uint64]
) -> tuple[int, int]:
    """Return an aim that is not served, and how far from it to fly; or what is given, if several draws find none."""
    for _ in range(8):
        k = pick(cursor, len(aims))
        if served[k] == 0:
            return aims[k], 2
    return around, reach


@kernel
def _reverse(
    path: NDArray[np.int32],
    length: int,
    longest: int,
    distance: Distances,
    cols: int,
    first: int,
    after: int,
    cursor: NDArray[np.uint64],
    new: NDArray[np.int32],
) -> int:
    """Propose to fly the cells between ``first`` and ``after`` in the reverse direction; return the size."""
    if after - first < 3:
        return -1
    begin = moves(distance, cols, path[first], path[after - 1])
    end = moves(distance, cols, path[first + 1], path[after])
    if begin < 0 or end < 0 or length - 2 + begin + end > longest:
        skip_walk(begin, True, cursor)
        skip_walk(end, True, cursor)
        return -1
    size = walk(distance, cols, path[first], path[after - 1], True, cursor, new, 0)
    for k in range(after - 2, first, -1):
        new[size] = path[k]
        size += 1
    return walk(distance, cols, path[first + 1], path[after], True, cursor, new, size) - 1


@kernel
def _without_same(path: NDArray[np.int32], first: int, after: int, size: int, new: NDArray[np.int32]) -> tuple[int, int, int]:
    """Return a proposal without the cells at its beginning and end that remain as they were."""
    same = 0
    while same < size and first + 1 < after and new[same] == path[first + 1]:
        same += 1
        first += 1
    while size > same and first + 1 < after and new[size - 1] == path[after - 1]:
        size -= 1
        after -= 1
    for k in range(same, size):
        new[k - same] = new[k]
    return first, after, size - same


@kernel
def _hover(
    path: NDArray[np.int32], length: int, longest: int, horizon: int, cursor: NDArray[np.uint64], new: NDArray[np.int32]
) -> tuple[int, int, int]:
    """Propose to hover longer, or less long, in a cell of the flight; as `propose`."""
    first = pick(cursor, min(horizon, length + 1))
    if pick(cursor, 2):
        size = 1 + pick(cursor, 4)
        if length + size > longest:
            return 0, 0, -1
        for k in range(size):
            new[k] = path[first]
        return first, first + 1, size
    after = first + 1
    most = 1 + pick(cursor, 4)
    while after <= length and after - first <= most and path[after] == path[first]:
        after += 1
    return first, after, 0 if after > first + 1 else -1
