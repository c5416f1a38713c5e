"""The random changes of a flight that a search tries."""

import numpy as np
from numpy.typing import NDArray

from uavbench.planning.distances import Distances, moves
from uavbench.planning.paths import pick, walk
from uavbench.world.kernel import kernel

_DRAWS = 12  # of changes, until one is possible
_CELLS = 4  # draws of a cell to fly over, until it is near enough
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

    Most changes of a flight that uses its budget make it too long, so changes are drawn until one is possible, up to 12 times.
    """
    for _ in range(_DRAWS):
        if hovers and pick(cursor, 3) == 0:
            first, after, size = _hover(path, length, longest, horizon, cursor, new)
        else:
            kind = pick(cursor, 100)
            first = pick(cursor, min(horizon, length + 1))
            after = first + 1 + pick(cursor, 9 if kind < 54 else (25 if kind < 85 else 61))
            if kind >= 94 and after <= length:
                size = _reverse(path, length, longest, distance, shape[1], first, after, cursor, new)
            else:
                first, after, size = _replace(
                    path, length, longest, distance, shape, landing, aims, served, first, after, cursor, new
                )
        if size >= 0:
            first, after, size = _without_same(path, first, after, size, new)
            if size > 0 or after > first + 1:
                return first, after, size
    return 0, 0, -1


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
    """Propose to fly from cell ``first`` to cell ``after``, or to a landing cell at the end, over up to two other cells."""
    cols, start = shape[1], int(path[first])
    reaches_end = after > length
    after = min(after, length + 1)
    there = int(path[min(after, length)])
    if reaches_end and pick(cursor, 2):
        there = int(landing[pick(cursor, len(landing))])
    ways = pick(cursor, 100)
    stops = 0 if ways < 20 else (1 if ways < 75 else 2)
    room = longest - (first if reaches_end else first + length - after)  # moves that the new part may have
    around = int(path[min(length, first + (after - first) // 2)])
    reach = min(_REACH, 1 + (after - first + longest - length) // 2)
    if stops > 0 and len(aims) > 0 and pick(cursor, 5) == 0:
        around, reach = _aim(aims, served, around, reach, cursor)
    once = twice = start
    if stops > 0:
        once = twice = _stop(start, there, around, reach, room, distance, shape, cursor)
    if stops > 1 and once >= 0:
        flown = moves(distance, cols, start, once)
        twice = _stop(once, there, once, reach, room - flown, distance, shape, cursor)
    if once < 0 or twice < 0:
        return 0, 0, -1
    if stops == 0:
        away = moves(distance, cols, start, there)
        if away < 0 or away > room:
            return 0, 0, -1
    straight = pick(cursor, 2) == 0
    size = 0
    if stops > 0:
        size = walk(distance, cols, start, once, straight, cursor, new, size)
    if stops > 1:
        size = walk(distance, cols, once, twice, straight, cursor, new, size)
    size = walk(distance, cols, twice, there, straight, cursor, new, size)
    if reaches_end:
        return first, after, size
    return (first, after, size - 1) if size > 0 else (first, after + 1, 0)  # a loop is cut out, with its last cell


@kernel
def _stop(
    here: int,
    there: int,
    around: int,
    reach: int,
    room: int,
    distance: Distances,
    shape: tuple[int, int],
    cursor: NDArray[np.uint64],
) -> int:
    """Draw a cell near ``around`` over which at most ``room`` moves lead from ``here`` to ``there``; −1 if none is found."""
    rows, cols = shape
    r0, r1, y, x = here // cols, there // cols, around // cols - reach, around % cols - reach
    c0, c1 = here - r0 * cols, there - r1 * cols
    for _ in range(_CELLS):
        r = y + pick(cursor, 2 * reach + 1)
        c = x + pick(cursor, 2 * reach + 1)
        if not (0 <= r < rows and 0 <= c < cols) or abs(r - r0) + abs(c - c0) + abs(r - r1) + abs(c - c1) > room:
            continue  # too far even without obstacles, which is found out faster than a distance is looked up
        cell = r * cols + c
        to, onward = moves(distance, cols, here, cell), moves(distance, cols, cell, there)
        if to >= 0 and onward >= 0 and to + onward <= room:
            return cell
    return -1


@kernel
def _aim(
    aims: NDArray[np.int64], served: NDArray[np.int32], around: int, reach: int, cursor: NDArray[np.uint64]
) -> tuple[int, int]:
    """Return an aim that is not served, and how far from it to fly; or what is given, if several draws find none."""
    for _ in range(8):
        k = pick(cursor, len(aims))
        if served[k] == 0:
            return int(aims[k]), 2
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
    """Propose to fly the cells between ``first`` and ``after`` in the reverse direction; return the size, or −1."""
    if after - first < 3:
        return -1
    begin = moves(distance, cols, path[first], path[after - 1])
    end = moves(distance, cols, path[first + 1], path[after])
    if begin < 0 or end < 0 or length - 2 + begin + end > longest:
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
