"""The city of a scenario, its static world: layers, lines of sight and distances."""

from collections.abc import Iterable, Sequence
from functools import cached_property, lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import BUILDING, LANDING, LOW_BUILDING, NO_FLY, cells_of
from uavbench.world.kernel import kernel
from uavbench.world.scenario import Scenario

NORTH, EAST, SOUTH, WEST, HOVER, LAND = range(6)
NUM_ACTIONS = 6
#: Row and column offset of each action.
OFFSETS = np.array([(-1, 0), (0, 1), (1, 0), (0, -1), (0, 0), (0, 0)], dtype=np.int32)
OFFSETS.flags.writeable = False

_Array = TypeVar("_Array", bound=NDArray[Any])
_OFFSETS: list[tuple[int, int]] = [(down, right) for down, right in OFFSETS.tolist()]


def neighbour(cell: tuple[int, int], action: int) -> tuple[int, int]:
    """Return the cell to which ``action`` leads from ``cell``, if nothing blocks it."""
    return cell[0] + _OFFSETS[action][0], cell[1] + _OFFSETS[action][1]


def action_between(cell: tuple[int, int], other: tuple[int, int]) -> int:
    """Return the move from ``cell`` to its neighbour ``other``, or ``HOVER`` if both are the same cell."""
    return _OFFSETS.index((other[0] - cell[0], other[1] - cell[1]))


class City:
    """The static world of an episode. All arrays are read-only; M is the number of rows, N the number of columns.

    Parameters
    ----------
    cells : ndarray of uint8, shape (M, N)
        The codes of the map's cells: see `uavbench.world.cells`.

    Attributes
    ----------
    cells : ndarray of uint8, shape (M, N)
        The codes of the map's cells.
    landing, no_fly, building : ndarray of bool, shape (M, N)
        The layers. ``building`` holds all buildings, also low ones; ``no_fly`` holds no-fly zones and the buildings that are
        not low.
    landing_cells : ndarray of int32, shape (K, 2)
        The cells of the landing zones in row-major order.
    action_mask : ndarray of int8, shape (M, N, 6)
        1 for the valid actions at a cell: a move that is not blocked, ``hover``, and ``land`` in a landing zone.
    distance_to_landing : ndarray of int32, shape (M, N)
        Number of moves from a cell to the nearest landing cell; −1 if none can be reached.
    """

    def __init__(self, cells: NDArray[np.uint8]) -> None:
        self.cells: NDArray[np.uint8] = _fixed(cells.copy())
        self.shape: tuple[int, int] = (cells.shape[0], cells.shape[1])
        self.landing: NDArray[np.bool_] = _fixed(cells == LANDING)
        self.building: NDArray[np.bool_] = _fixed((cells == BUILDING) | (cells == LOW_BUILDING))
        self.no_fly: NDArray[np.bool_] = _fixed((cells == NO_FLY) | (cells == BUILDING))

    @cached_property
    def landing_cells(self) -> NDArray[np.int32]:
        """See the attributes of the class; this and what follows is computed when it is first asked for."""
        return _fixed(np.argwhere(self.landing).astype(np.int32))

    @cached_property
    def action_mask(self) -> NDArray[np.int8]:
        """See the attributes of the class."""
        return _fixed(_action_mask(self.landing, self.no_fly))

    @cached_property
    def distance_to_landing(self) -> NDArray[np.int32]:
        """See the attributes of the class."""
        return _fixed(_distances(self.no_fly, self.landing_cells))

    def distances(self, cell: Sequence[int], avoid: Iterable[tuple[int, int]] = ()) -> NDArray[np.int32]:
        """Return the number of moves from ``cell`` to every cell, shape (M, N); −1 for cells that cannot be reached.

        Parameters
        ----------
        cell : (int, int)
            The cell to measure from.
        avoid : iterable of (int, int)
            Cells that count as no-fly cells too, for example those of other UAVs.
        """
        closed = self.no_fly
        for n, held in enumerate(avoid):
            closed = closed if n else closed.copy()
            closed[held] = True
        return _distances(closed, np.array([cell], dtype=np.int32))

    def safe_action_mask(self, positions: NDArray[np.integer[Any]], budgets: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
        """Return the safe actions: those after which a UAV can still land within its budget, or has landed; bool, shape (B, 6).

        If no action is safe, all are returned as safe, because the UAV crashes whatever it does. Other UAVs are not considered.

        Parameters
        ----------
        positions : ndarray of int, shape (B, 2)
            Cells from which a landing cell can be reached.
        budgets : ndarray of int, shape (B,)
            Actions left.
        """
        row, col = positions[:, 0], positions[:, 1]
        mask = self.action_mask[row, col] > 0
        there = positions[:, None] + mask[..., None] * OFFSETS  # after an action that is not valid, the UAV stays
        possible = self.distance_to_landing[there[..., 0], there[..., 1]] + 1 <= budgets[:, None] - 1
        possible[:, LAND] |= self.landing[row, col]
        return possible | ~possible.any(axis=1, keepdims=True)

    def step_towards(self, distance: NDArray[np.integer[Any]], cell: tuple[int, int]) -> int:
        """Return the first move, in the order of the actions, that leads from ``cell`` one move nearer to a goal.

        Parameters
        ----------
        distance : ndarray of int, shape (M, N)
            Moves from every cell to a goal, −1 if it cannot be reached: from `distances`, or `distance_to_landing`.
        cell : (int, int)
            A cell from which the goal can be reached, and which is not the goal itself.

        Raises
        ------
        ValueError
            When no neighbour is nearer.
        """
        for action in (NORTH, EAST, SOUTH, WEST):
            r, c = neighbour(cell, action)
            if 0 <= r < self.shape[0] and 0 <= c < self.shape[1] and distance[r, c] == distance[cell] - 1 >= 0:
                return action
        raise ValueError(f"cell: {cell} has no neighbour that is nearer to the goal")

    def visible(self, cell: Sequence[int]) -> NDArray[np.bool_]:
        """Return the cells that a ray from ``cell`` reaches before its first building; shape (M, N)."""
        seen = np.zeros(self.shape, dtype=np.bool_)
        mark_visible(self.building, cell[0], cell[1], seen)
        return seen


@lru_cache(maxsize=32)
def _city_of_rows(rows: tuple[str, ...]) -> City:
    return City(cells_of(rows))


def city_of(scenario: Scenario) -> City:
    """Return the only city of a scenario; scenarios with the same map share it.

    Raises
    ------
    ValueError
        When the scenario has many cities: then the city of an episode is in its state, `StateView.city`.
    """
    if scenario.cities is not None:
        raise ValueError(f"{scenario.id} has many cities, and each episode has its own: read state.city")
    return _city_of_rows(scenario.rows)


def _fixed(array: _Array) -> _Array:
    """Make an array read-only, and return it."""
    array.flags.writeable = False
    return array


def _action_mask(landing: NDArray[np.bool_], no_fly: NDArray[np.bool_]) -> NDArray[np.int8]:
    """Return the valid actions at each cell."""
    rows, cols = no_fly.shape
    padded = np.pad(no_fly, 1, constant_values=True)
    mask = np.ones((rows, cols, NUM_ACTIONS), dtype=np.int8)
    for action in (NORTH, EAST, SOUTH, WEST):
        down, right = OFFSETS[action]
        mask[:, :, action] = ~padded[1 + down : 1 + down + rows, 1 + right : 1 + right + cols]
    mask[:, :, LAND] = landing
    return mask


@kernel
def _distances(no_fly: NDArray[np.bool_], sources: NDArray[np.int32]) -> NDArray[np.int32]:
    """Breadth-first search from ``sources`` over the cells that are not ``no_fly``."""
    rows, cols = no_fly.shape
    distance = np.full((rows, cols), -1, dtype=np.int32)
    queue = np.empty((rows * cols, 2), dtype=np.int32)
    head = tail = 0
    for k in range(len(sources)):
        distance[sources[k, 0], sources[k, 1]] = 0
        queue[tail] = sources[k]
        tail += 1
    while head < tail:
        r, c = queue[head]
        head += 1
        for action in range(4):
            y, x = r + OFFSETS[action, 0], c + OFFSETS[action, 1]
            if 0 <= y < rows and 0 <= x < cols and not no_fly[y, x] and distance[y, x] < 0:
                distance[y, x] = distance[r, c] + 1
                queue[tail, 0], queue[tail, 1] = y, x
                tail += 1
    return distance


@kernel
def mark_visible(building: NDArray[np.bool_], r: int, c: int, seen: NDArray[np.bool_]) -> None:
    """Cast a ray from (r, c) to each border cell, and mark the visible cells in ``seen``.

    Visibility is not symmetric: camera rays start at the UAV, radio rays at the device.
    """
    rows, cols = building.shape
    walls, marks = building.reshape(-1), seen.reshape(-1)
    seen[r, c] = True
    for x in range(cols):
        _cast(walls, cols, r, c, 0, x, marks)
        _cast(walls, cols, r, c, rows - 1, x, marks)
    for y in range(1, rows - 1):
        _cast(walls, cols, r, c, y, 0, marks)
        _cast(walls, cols, r, c, y, cols - 1, marks)


@kernel
def _cast(
    building: NDArray[np.bool_],
    cols: int,
    r0: int,
    c0: int,
    r1: int,
    c1: int,
    seen: NDArray[np.bool_],
) -> None:
    """Mark the cells on the ray from (r0, c0) to (r1, c1) before its first building.

    The source cell is not checked, so a ray may start in a building (as in uavSim, where no UAV or device is ever in one).
    This is a variant of Bresenham's line in which one step moves along one axis only, as in uavSim. ``building`` and ``seen``
    are flattened, and the step is selected without a branch, because a processor cannot predict which axis is next.
    """
    dx, dy = abs(c0 - c1), -abs(r0 - r1)
    step_c, step_r = (1 if c1 > c0 else -1), (cols if r1 > r0 else -cols)
    error = dx + dy
    cell = r0 * cols + c0
    for _ in range(dx - dy):
        along = 4 * error > dx + dy  # 2e − dy > dx − 2e
        error += dy if along else dx
        cell += step_c if along else step_r
        if building[np.uint64(cell)]:  # unsigned: Numba need not check for negative indices
            return
        seen[np.uint64(cell)] = True
