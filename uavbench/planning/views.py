"""What the camera newly sees on each way into a cell, so that a search counts only little for each cell of a flight.

Neighbouring cells have most of their view in common. How often each target *comes into* view on a flight tells as well whether
the flight covers it as how often it is in view, and there is less to count.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.planning.rates import action_of
from uavbench.simulation.missions.coverage import camera_views
from uavbench.world.city import City
from uavbench.world.kernel import kernel
from uavbench.world.parameters import Coverage
from uavbench.world.scenario import Scenario

_WHOLE = 5  # the list of all targets in view; those before it belong to the four moves and to hovering
_LISTS = 6


class Views(NamedTuple):
    """Six lists of targets for each cell: what comes into view with a move into it, by its direction, and what is in view.

    Attributes
    ----------
    begin : ndarray of int64, shape (6 MN + 1,)
        Where each list begins in ``targets``; the next list follows it. List 6 c + a is that of cell c (row-major) after action
        a: moves are 0 to 3, hovering, which shows nothing new, is 4, and 5 stands for all that the camera sees.
    targets : ndarray of int32
        Numbers of targets, which are numbered in row-major order of their cells.
    cells, cols : int
        MN, and the number of columns of the map.
    """

    begin: NDArray[np.int64]
    targets: NDArray[np.int32]
    cells: int
    cols: int


def views_of(scenario: Scenario, target: NDArray[np.float32], city: City) -> Views:
    """Return what the camera sees of the targets, the cells above 0 of ``target``, shape (M, N), in a CPP scenario."""
    views = camera_views(scenario, city)
    rows, cols = views.shape
    numbers = np.full((rows, cols), -1, dtype=np.int32)
    numbers[target > 0] = np.arange((target > 0).sum())
    assert isinstance(scenario.mission, Coverage)
    begin = np.zeros(_LISTS * rows * cols + 1, dtype=np.int64)
    targets = _list_views(views, numbers, scenario.mission.camera_size // 2, city.no_fly, begin)
    return Views(begin, targets, rows * cols, cols)


@kernel
def _list_views(
    views: NDArray[np.uint64], numbers: NDArray[np.int32], reach: int, no_fly: NDArray[np.bool_], begin: NDArray[np.int64]
) -> NDArray[np.int32]:
    """Write where the lists begin, and return their targets."""
    rows, cols = views.shape
    most = (2 * reach + 1) ** 2
    targets = np.empty(4 * most * rows * cols // 2 + most, dtype=np.int32)
    seen, size = np.empty(most, dtype=np.int32), 0
    last_seen = np.full(rows * cols, -1, dtype=np.int64)  # the list that was made when a target was last in the view before
    for cell in range(rows * cols):
        r, c = cell // cols, cell % cols
        count = _in_view(np.uint64(views[r, c]), r, c, numbers, reach, seen) if not no_fly[r, c] else 0
        for action in range(_LISTS):
            number = _LISTS * cell + action
            begin[number] = size
            if size + most > len(targets):
                larger = np.empty(2 * len(targets), dtype=np.int32)
                larger[:size] = targets[:size]
                targets = larger
            if action == _WHOLE:
                targets[size : size + count] = seen[:count]
                size += count
            elif action < 4 and count > 0:
                y, x = r - (-1, 0, 1, 0)[action], c - (0, 1, 0, -1)[action]
                if not (0 <= y < rows and 0 <= x < cols) or no_fly[y, x]:
                    continue
                view = views[y, x]
                for k in range(y - reach, y + reach + 1):
                    for n in range(x - reach, x + reach + 1):
                        if view & np.uint64(1) and numbers[k, n] >= 0:
                            last_seen[numbers[k, n]] = number
                        view >>= np.uint64(1)
                for k in range(count):
                    if last_seen[seen[k]] != number:
                        targets[size] = seen[k]
                        size += 1
    begin[_LISTS * rows * cols] = size
    return targets[:size].copy()


@kernel
def _in_view(view: np.uint64, r: int, c: int, numbers: NDArray[np.int32], reach: int, seen: NDArray[np.int32]) -> int:
    """Write the numbers of the targets in a cell's view; return how many there are."""
    count = 0
    for y in range(r - reach, r + reach + 1):
        for x in range(c - reach, c + reach + 1):
            if view & np.uint64(1) and numbers[y, x] >= 0:
                seen[count] = numbers[y, x]
                count += 1
            view >>= np.uint64(1)
    return count


@kernel
def in_view(views: Views, cell: int) -> NDArray[np.int32]:
    """Return the targets that the camera sees from a cell."""
    number = _LISTS * cell + _WHOLE
    return views.targets[views.begin[number] : views.begin[number + 1]]


@kernel
def enter(cells: NDArray[np.int32], begin: int, end: int, before: int, views: Views, counts: NDArray[np.int32]) -> int:
    """Count the targets that come into view in the cells from ``begin`` to ``end``; return how many had not been in view.

    ``before`` is the cell of the flight before them; −1 if they are the first that count, so that all in view is new.
    """
    fresh = 0
    for k in range(begin, end):
        number = _LISTS * cells[k] + (_WHOLE if before < 0 else action_of(before, cells[k], views.cols))
        for n in range(views.begin[number], views.begin[number + 1]):
            fresh += int(counts[views.targets[n]] == 0)
            counts[views.targets[n]] += 1
        before = int(cells[k])
    return fresh


@kernel
def leave(cells: NDArray[np.int32], begin: int, end: int, before: int, views: Views, counts: NDArray[np.int32]) -> int:
    """Take back what `enter` has counted; return how many targets are not in view any more."""
    lost = 0
    for k in range(begin, end):
        number = _LISTS * cells[k] + (_WHOLE if before < 0 else action_of(before, cells[k], views.cols))
        for n in range(views.begin[number], views.begin[number + 1]):
            counts[views.targets[n]] -= 1
            lost += int(counts[views.targets[n]] == 0)
        before = int(cells[k])
    return lost
