"""Breadth-first searches over a canvas: how far cells are from the landing cells, and how pockets are joined or closed."""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import BUILDING, FREE, LANDING, LOW_BUILDING, NO_FLY
from uavbench.world.generators.canvas import OUTSIDE, Canvas
from uavbench.world.kernel import kernel

#: Instead of a distance: not reached yet, and cells that cannot be entered.
FAR, BLOCKED = 2**30, -1
_CROSSED = -2  # blocked, and visited by the search through walls
_EDGE = -3  # behind the end of the map
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
def spread(
    distance: NDArray[np.int32], queue: NDArray[np.int32], sources: int, wide: int, limit: int, reach: int
) -> tuple[int, int]:
    """Lower the distances of all cells around the first cells of a queue, up to ``limit`` moves away.

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
    limit, reach : int
        See above, and below.

    Returns
    -------
    visited : int
        Cells in the queue, nearest first.
    gained : int
        Cells that are now at most ``reach`` moves away and were not before.
    """
    gained = 0
    for k in range(sources):
        gained += distance[queue[k]] > reach
        distance[queue[k]] = 0
    head, tail = 0, sources
    while head < tail:
        cell = queue[np.uint64(head)]
        head += 1
        moves = distance[np.uint64(cell)] + 1
        if moves > limit:
            break
        before = tail
        close = moves <= reach
        tail, gained = _visit(distance, queue, tail, gained, cell - wide, moves, close, reach)
        tail, gained = _visit(distance, queue, tail, gained, cell + 1, moves, close, reach)
        tail, gained = _visit(distance, queue, tail, gained, cell + wide, moves, close, reach)
        tail, gained = _visit(distance, queue, tail, gained, cell - 1, moves, close, reach)
    return tail, gained


@kernel
def _visit(
    distance: NDArray[np.int32],
    queue: NDArray[np.int32],
    tail: int,
    gained: int,
    cell: int,
    moves: int,
    close: bool,
    reach: int,
) -> tuple[int, int]:
    """Add a cell to the queue if it is nearer than it was known to be; without a branch, which would be slower."""
    before = distance[np.uint64(cell)]
    nearer = before > moves
    queue[np.uint64(tail)] = cell
    distance[np.uint64(cell)] = moves if nearer else before
    return tail + nearer, gained + (close & (before > reach))


@kernel
def join_pockets(canvas: Canvas, visited: int, flyable: int) -> None:
    """Make one region of all cells that can be flown over, after a search from a landing cell has reached some of them.

    The search goes on through buildings and no-fly zones. Where it comes to a pocket that was not reached, it opens the way
    on which it came, or closes the pocket with buildings if it is tiny. Each cell is visited once.

    Parameters
    ----------
    canvas : Canvas
        The city, the distances after `spread`, and its queue.
    visited : int
        Cells in the queue.
    flyable : int
        Cells that can be flown over, whether or not they were reached.
    """
    city, distance, queue, came = canvas.city.reshape(-1), canvas.distance.reshape(-1), canvas.queue, canvas.spare
    wide, left = canvas.city.shape[1], flyable - visited
    for cell in range(len(city)):
        if city[cell] == OUTSIDE:
            distance[cell] = _EDGE
    head, tail = 0, visited
    while head < tail and left > 0:
        cell = queue[head]
        head += 1
        for step in (-wide, 1, wide, -1):
            near = cell + step
            if distance[near] == BLOCKED:
                distance[near], came[near], queue[tail] = _CROSSED, cell, near
                tail += 1
            elif distance[near] == FAR:
                pocket = tail
                came[near] = cell
                tail = _flood(distance, queue, came, tail, near, wide)
                left -= tail - pocket
                if tail - pocket < _SMALLEST_POCKET:
                    for k in range(pocket, tail):
                        city[queue[k]], distance[queue[k]] = BUILDING, _CROSSED
                else:
                    _open(city, distance, came, cell)


@kernel
def _flood(
    distance: NDArray[np.int32], queue: NDArray[np.int32], came: NDArray[np.int32], tail: int, start: int, wide: int
) -> int:
    """Add the pocket around ``start`` to the queue; return the queue's new length."""
    head = tail
    distance[start], queue[tail] = 0, start
    tail += 1
    while head < tail:
        cell = queue[head]
        head += 1
        for step in (-wide, 1, wide, -1):
            near = cell + step
            if distance[near] == FAR:
                distance[near], came[near], queue[tail] = 0, cell, near
                tail += 1
    return tail


@kernel
def _open(city: NDArray[np.uint8], distance: NDArray[np.int32], came: NDArray[np.int32], cell: int) -> None:
    """Clear the blocked cells on the way from ``cell`` back to a cell that was reached before."""
    while distance[cell] == _CROSSED:
        city[cell], distance[cell] = FREE, 0
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
    tail, _ = spread(distance, queue, sources, canvas.city.shape[1], limit, 0)
    for k in range(sources, tail):
        if wanted <= 0:
            break
        if city[queue[k]] == BUILDING or city[queue[k]] == LOW_BUILDING:
            city[queue[k]] = FREE
            wanted -= 1
    return wanted
