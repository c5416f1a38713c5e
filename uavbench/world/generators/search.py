"""Breadth-first searches over a canvas: how far cells are from the landing cells, and how pockets are joined or closed."""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import BUILDING, FREE, LANDING, LOW_BUILDING, NO_FLY
from uavbench.world.generators.canvas import OUTSIDE, Canvas
from uavbench.world.kernel import kernel

#: Instead of a distance: not reached yet, and cells that cannot be entered.
FAR, BLOCKED = 2**30, -1
_CROSSED = -2  # blocked, and visited by the search through walls
_POCKET = -3  # in a pocket that is being joined
_SMALLEST_POCKET = 4  # cells; smaller ones are closed


@kernel
def prepare(canvas: Canvas) -> int:
    """Mark all cells as not reached or as blocked; return how many can be flown over."""
    city, distance = canvas.city.reshape(-1), canvas.distance.reshape(-1)
    flyable = 0
    for cell in range(len(city)):
        code = city[cell]
        blocked = (code == BUILDING) | (code == NO_FLY) | (code == OUTSIDE)
        distance[cell] = np.int32(BLOCKED) if blocked else np.int32(FAR)
        flyable += not blocked
    return flyable


@kernel
def search_all(distance: NDArray[np.int32], queue: NDArray[np.int32], sources: int, wide: int) -> int:
    """Measure the distances from the first cells of a queue to all cells; return how many cells can be reached.

    They are the first cells of the queue then, nearest first. The arguments are those of `spread`, which does more.
    """
    for k in range(sources):
        distance[queue[k]] = 0
    head, tail = 0, sources
    while head < tail:
        cell = queue[np.uint64(head)]
        head += 1
        moves = distance[np.uint64(cell)] + 1
        tail = _meet(distance, queue, tail, cell - wide, moves)
        tail = _meet(distance, queue, tail, cell + 1, moves)
        tail = _meet(distance, queue, tail, cell + wide, moves)
        tail = _meet(distance, queue, tail, cell - 1, moves)
    return tail


@kernel
def _meet(distance: NDArray[np.int32], queue: NDArray[np.int32], tail: int, cell: int, moves: int) -> int:
    """Add a cell to the queue if it was not reached; without a branch, which would be slower."""
    before = distance[np.uint64(cell)]
    new = before == FAR
    queue[np.uint64(tail)] = cell
    distance[np.uint64(cell)] = moves if new else before
    return tail + new


@kernel
def within_reach(distance: NDArray[np.int32], queue: NDArray[np.int32], visited: int, reach: int) -> int:
    """Return how many of the cells in a queue, nearest first, are at most ``reach`` moves away."""
    low, high = 0, visited
    while low < high:
        middle = (low + high) // 2
        if distance[queue[middle]] <= reach:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def spread(distance: NDArray[np.int32], queue: NDArray[np.int32], sources: int, wide: int, reach: int) -> tuple[int, int]:
    """Lower the distances of all cells around the first cells of a queue, up to ``reach`` moves away.

    Parameters
    ----------
    distance : ndarray of int32, shape (C,)
        The distances, flattened; changed in place.
    queue : ndarray of int32, shape (C,)
        The cells where the search begins, which get distance 0, followed by those it comes to.
    sources : int
        How many cells it begins at.
    wide : int
        The columns of the canvas.
    reach : int
        How far it goes.

    Returns
    -------
    visited : int
        Cells in the queue, nearest first.
    gained : int
        Cells that are now at most ``reach`` moves away and were not before.
    """
    gained = 0
    for k in range(sources):
        gained += int(distance[queue[k]] > reach)
        distance[queue[k]] = 0
    head, tail = 0, sources
    while head < tail:
        cell = queue[np.uint64(head)]
        head += 1
        moves = distance[np.uint64(cell)] + 1
        if moves > reach:
            break
        tail, gained = _visit(distance, queue, tail, gained, cell - wide, moves, reach)
        tail, gained = _visit(distance, queue, tail, gained, cell + 1, moves, reach)
        tail, gained = _visit(distance, queue, tail, gained, cell + wide, moves, reach)
        tail, gained = _visit(distance, queue, tail, gained, cell - 1, moves, reach)
    return tail, gained


@kernel
def _visit(
    distance: NDArray[np.int32], queue: NDArray[np.int32], tail: int, gained: int, cell: int, moves: int, reach: int
) -> tuple[int, int]:
    """Add a cell to the queue if it is nearer than it was known to be; without a branch, which would be slower."""
    before = distance[np.uint64(cell)]
    nearer = before > moves
    queue[np.uint64(tail)] = cell
    distance[np.uint64(cell)] = moves if nearer else before
    return tail + nearer, gained + (before > reach)


@kernel
def join_pockets(canvas: Canvas, visited: int) -> bool:
    """Make one region of all cells that can be flown over, after a search from a landing cell has reached some of them.

    A pocket that was not reached is closed with buildings if it is tiny. From a larger one, a search through buildings and
    no-fly zones finds the shortest way to cells that were reached, and opens it.

    Parameters
    ----------
    canvas : Canvas
        The city, the distances after the search, and its queue.
    visited : int
        Cells in the queue.

    Returns
    -------
    opened : bool
        Whether any way was opened, so that distances have changed.
    """
    city, distance, queue = canvas.city.reshape(-1), canvas.distance.reshape(-1), canvas.queue
    wide = canvas.city.shape[1]
    opened = False
    for start in range(len(distance)):
        if distance[start] != FAR:
            continue
        tail = _flood(distance, queue, visited, start, wide)
        if tail - visited < _SMALLEST_POCKET:
            for k in range(visited, tail):
                city[queue[k]], distance[queue[k]] = BUILDING, BLOCKED
        else:
            tail = _leave(canvas, visited, tail)
            for k in range(visited, tail):
                distance[queue[k]] = BLOCKED if distance[queue[k]] == _CROSSED else 0
            opened = True
    return opened


@kernel
def _leave(canvas: Canvas, head: int, tail: int) -> int:
    """Search from a pocket, which is the end of the queue, through what is blocked, and open a way to cells that were reached.

    Other pockets on the way are joined, too. Returns the queue's new length.
    """
    city, distance, queue, came = canvas.city.reshape(-1), canvas.distance.reshape(-1), canvas.queue, canvas.spare
    wide = canvas.city.shape[1]
    while head < tail:
        cell = queue[head]
        head += 1
        for step in (-wide, 1, wide, -1):
            near = cell + step
            if distance[near] == BLOCKED and city[near] != OUTSIDE:
                distance[near], came[near], queue[tail] = _CROSSED, cell, near
                tail += 1
            elif distance[near] >= 0:
                other = distance[near] == FAR
                _open(city, distance, came, cell)
                if not other:
                    return tail
                tail = _flood(distance, queue, tail, near, wide)
    return tail


@kernel
def _flood(distance: NDArray[np.int32], queue: NDArray[np.int32], tail: int, start: int, wide: int) -> int:
    """Add the pocket around ``start`` to the queue; return the queue's new length."""
    head = tail
    distance[start], queue[tail] = _POCKET, start
    tail += 1
    while head < tail:
        cell = queue[head]
        head += 1
        for step in (-wide, 1, wide, -1):
            near = cell + step
            if distance[near] == FAR:
                distance[near], queue[tail] = _POCKET, near
                tail += 1
    return tail


@kernel
def _open(city: NDArray[np.uint8], distance: NDArray[np.int32], came: NDArray[np.int32], cell: int) -> None:
    """Clear the blocked cells on the way from ``cell`` back to the pocket from which the search came."""
    while distance[cell] == _CROSSED:
        city[cell], distance[cell] = FREE, _POCKET
        cell = came[cell]


@kernel
def open_buildings(canvas: Canvas, wanted: int, limit: int) -> int:
    """Clear the ``wanted`` cells of buildings that are nearest to landing cells; return how many could not be cleared.

    The search goes through buildings, up to ``limit`` moves away, but not through no-fly zones. It clears a cell after those
    that lead to it, so that all cleared cells can be reached in so many moves.
    """
    city, distance, queue = canvas.city.reshape(-1), canvas.distance.reshape(-1), canvas.queue
    sources = 0
    for cell in range(len(city)):
        distance[cell] = BLOCKED if city[cell] == NO_FLY or city[cell] == OUTSIDE else FAR
        if city[cell] == LANDING:
            queue[sources] = cell
            sources += 1
    tail, _ = spread(distance, queue, sources, canvas.city.shape[1], limit)
    for k in range(sources, tail):
        if wanted <= 0:
            break
        if city[queue[k]] == BUILDING or city[queue[k]] == LOW_BUILDING:
            city[queue[k]] = FREE
            wanted -= 1
    return wanted
