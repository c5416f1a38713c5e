"""Landing zones for a map: chosen in the open and far apart, or given; and what cannot be reached from them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uavbench.geodata.libraries import GeodataError
from uavbench.world.cells import BUILDING, CELL_NAMES, FREE, LANDING, LOW_BUILDING, NO_FLY
from uavbench.world.city import City

#: First row and column, height and width of a landing zone, in cells.
Zone = tuple[int, int, int, int]

_ZONES = 2
_SIDES = (3, 2, 1)  # of a zone that is chosen, in cells: the largest for which there is room
_OPEN = 3  # cells of free space around a zone, beyond which more make no difference


def choose_zones(cells: NDArray[np.uint8]) -> list[Zone]:
    """Return two landing zones of 3×3 free cells, or of fewer where there is no room; none if no UAV could leave any free cell.

    They lie in the largest region that a UAV can fly in, with as much free space around them as there is at two places that
    are at least half a side of the map apart, and as far apart as the UAV can fly.

    Parameters
    ----------
    cells : ndarray of uint8, shape (M, N)
        The codes of the cells.
    """
    region = _largest_region(np.isin(cells, (FREE, LOW_BUILDING)), cells == FREE)
    city = City(cells)
    for side in _SIDES:
        if side**2 >= region.sum():  # the zone would be all that a UAV can fly in
            continue
        best: list[tuple[int, int]] = []
        for space in range(_OPEN, -1, -1):
            corners = _corners((cells == FREE) & region, side, space)
            chosen, apart = _far_apart(corners, city)
            if len(chosen) == _ZONES and apart >= min(cells.shape) // 2:
                return [(r, c, side, side) for r, c in chosen]
            best = max(best, chosen, key=len)
        if best:
            return [(r, c, side, side) for r, c in best]
    return []


def place_zones(cells: NDArray[np.uint8], zones: Sequence[Zone]) -> NDArray[np.uint8]:
    """Return a copy of the map with landing zones.

    Raises
    ------
    GeodataError
        When a zone is not on the map, one of its cells is not free, or no UAV can fly from it to the others or anywhere.
    """
    placed = cells.copy()
    for row, col, height, width in zones:
        name = f"landing: the zone {row},{col},{height},{width}"
        if min(row, col) < 0 or min(height, width) < 1 or row + height > cells.shape[0] or col + width > cells.shape[1]:
            raise GeodataError(f"{name} is not on the map of {cells.shape[0]} rows × {cells.shape[1]} columns")
        taken = np.argwhere(cells[row : row + height, col : col + width] != FREE)
        if len(taken):
            r, c = (taken[0] + (row, col)).tolist()
            raise GeodataError(f"{name} is not free: row {r}, column {c} is a {CELL_NAMES[cells[r, c]]}")
        placed[row : row + height, col : col + width] = LANDING
    _check_reach(placed, zones)
    return placed


def _check_reach(placed: NDArray[np.uint8], zones: Sequence[Zone]) -> None:
    """Refuse landing zones if no UAV can fly from one to another, or anywhere else."""
    first = zones[0]
    reached = City(placed).distances(first[:2]) >= 0
    for zone in zones[1:]:
        if not reached[zone[:2]]:
            between = f"{','.join(map(str, first))} and {','.join(map(str, zone))}"
            raise GeodataError(
                f"landing: no UAV can fly between the zones {between}, because buildings or no-fly zones part them: "
                "leave one of them out, or move it"
            )
    if not (reached & (placed != LANDING)).any():
        raise GeodataError("landing: the zones leave no other cell that a UAV can fly to: give smaller ones, or move them")


def close_unreachable(cells: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], int]:
    """Return a copy of the map in which no UAV could fly where it cannot get to, and how many cells that changed.

    A free cell that no landing zone leads to, as in a yard that high buildings enclose, becomes a no-fly zone: sight still goes
    through it. A low building becomes one that blocks flight.
    """
    open_cells = np.isin(cells, (FREE, LANDING, LOW_BUILDING))
    apart = open_cells & (City(cells).distance_to_landing < 0)
    closed = cells.copy()
    closed[apart & (cells == FREE)] = NO_FLY
    closed[apart & (cells == LOW_BUILDING)] = BUILDING
    return closed, int(apart.sum())


def _largest_region(flyable: NDArray[np.bool_], counted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the connected region of flyable cells with the most counted ones; of equal regions, the northernmost."""
    wide = flyable.shape[1] + 2
    left = bytearray(np.pad(flyable, 1).astype(np.uint8).tobytes())
    worth = np.pad(counted, 1).ravel()
    best: list[int] = []
    most = 0
    for first in np.flatnonzero(np.pad(flyable, 1)).tolist():
        if not left[first]:
            continue
        left[first], region = 0, [first]
        for cell in region:  # which grows meanwhile
            for near in (cell - wide, cell + 1, cell + wide, cell - 1):
                if left[near]:
                    left[near] = 0
                    region.append(near)
        total = int(worth[region].sum())
        if total > most:
            best, most = region, total
    marked = np.zeros(worth.shape, dtype=np.bool_)
    marked[best] = True
    return marked.reshape(-1, wide)[1:-1, 1:-1]


def _corners(free: NDArray[np.bool_], side: int, space: int) -> list[tuple[int, int]]:
    """Return the first cell of each square of ``side`` cells that has at least ``space`` free cells around it."""
    whole = side + 2 * space
    if whole > min(free.shape):
        return []
    squares = np.lib.stride_tricks.sliding_window_view(free, (whole, whole)).all(axis=(2, 3))
    return [(r + space, c + space) for r, c in np.argwhere(squares).tolist()]


def _far_apart(corners: list[tuple[int, int]], city: City) -> tuple[list[tuple[int, int]], int]:
    """Return two corners that are far apart, and the number of moves between them; fewer corners if there are no two."""
    if not corners:
        return [], 0
    first = _farthest(corners, city, corners[0])[0]
    second, moves = _farthest(corners, city, first)
    return ([first, second], moves) if moves > 2 * _SIDES[0] else ([first], 0)


def _farthest(corners: list[tuple[int, int]], city: City, start: tuple[int, int]) -> tuple[tuple[int, int], int]:
    """Return the corner that is the most moves away from ``start``; of equal ones, the first."""
    distance = city.distances(start)
    return max(((corner, int(distance[corner])) for corner in corners), key=lambda pair: pair[1])
