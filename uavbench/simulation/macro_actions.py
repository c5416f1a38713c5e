"""Macro-actions: one decision for several moves, as the paper names them among its future work (Sutton, Precup, Singh 1999).

A macro-action is defined by what the UAV observes alone: the local map, and the masks of its six actions. So environments and
agents mean the same by it. There are two kinds:

- ``"cells"``: fly to a cell of the local map, by a shortest path on this map; the cell in the middle means to hover once. One
  more macro-action lands.
- ``"directions"``: the six actions, of which a move goes on until something changes: an opening to the left or to the right
  begins or ends, or a landing zone does.

Both end early where the next action is not allowed: it is blocked, or after it landing is not possible any more.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.world.city import HOVER, LAND, NUM_ACTIONS, OFFSETS
from uavbench.world.kernel import kernel

KINDS = ("cells", "directions")
_LANDING_LAYER, _NO_FLY_LAYER = 0, 1


class MacroKind:
    """The macro-actions of one kind.

    Parameters
    ----------
    kind : {"cells", "directions"}
    local_size : int
        The size l of the local map.

    Attributes
    ----------
    number : int
        How many there are: l² + 1 cells (row-major, then ``land``), or 6 directions.

    Raises
    ------
    ValueError
        When the kind is unknown, or there is no local map.
    """

    def __init__(self, kind: str, local_size: int) -> None:
        if kind not in KINDS:
            raise ValueError(f"kind: {kind!r} is not one of {', '.join(KINDS)}")
        if local_size < 3:
            raise ValueError(f"local_size: macro-actions need a local map of at least 3×3 cells, this one has {local_size}")
        self.kind, self._size = kind, local_size
        self.number = local_size**2 + 1 if kind == "cells" else NUM_ACTIONS

    def mask(self, local: NDArray[Any], allowed: NDArray[Any]) -> NDArray[np.int8]:
        """Return the macro-actions whose first action is allowed.

        Parameters
        ----------
        local : ndarray, shape (C, l, l)
            The local map.
        allowed : ndarray, shape (6,)
            Not 0 for actions that are allowed.

        Returns
        -------
        ndarray of int8, shape (number,)
            1 for macro-actions that can begin.
        """
        if self.kind == "directions":
            return (np.asarray(allowed) != 0).astype(np.int8)
        firsts = _first_actions(_closed(local))
        mask = np.zeros(self.number, dtype=np.int8)
        mask[:-1] = np.append(np.asarray(allowed) != 0, False)[firsts.reshape(-1)]  # −1, no path, is the last
        mask[-1] = allowed[LAND] != 0
        return mask

    def begin(self, chosen: int, local: NDArray[Any]) -> "Flight":
        """Return the flight of a macro-action that begins where the local map was seen.

        Raises
        ------
        ValueError
            When there is no such macro-action, or no path to its cell.
        """
        if not 0 <= chosen < self.number:
            raise ValueError(f"actions: {chosen} is not a macro-action from 0 to {self.number - 1}")
        if self.kind == "directions":
            return Flight([chosen], straight=chosen < HOVER)
        if chosen == self.number - 1:
            return Flight([LAND])
        path = _path(_closed(local), chosen)
        if not len(path):
            raise ValueError(f"actions: there is no path on the local map to its cell {divmod(chosen, self._size)}")
        return Flight(path.tolist())


class Flight:
    """A macro-action that has begun: `next` names its actions one after the other.

    Parameters
    ----------
    actions : list of int
        The actions, or the only one, which is repeated if ``straight``.
    straight : bool
        Whether the flight goes on until something changes.
    """

    def __init__(self, actions: list[int], straight: bool = False) -> None:
        self._actions, self._straight = actions, straight
        self._seen: tuple[bool, ...] | None = None
        self._flown = 0

    def next(self, local: NDArray[Any], allowed: NDArray[Any]) -> int | None:
        """Return the next action; None if the macro-action is over.

        Parameters
        ----------
        local : ndarray, shape (C, l, l)
            The local map that the UAV sees now.
        allowed : ndarray, shape (6,)
            Not 0 for actions that are allowed now. The first action is returned in any case.
        """
        if self._straight:
            action, seen = self._actions[0], _surroundings(local, self._actions[0])
            over = self._seen is not None and seen != self._seen
            self._seen = seen
        else:
            over = self._flown == len(self._actions)
            action = self._actions[min(self._flown, len(self._actions) - 1)]
        if over or (self._flown and not allowed[action]):
            return None
        self._flown += 1
        return action


def _closed(local: NDArray[Any]) -> NDArray[np.bool_]:
    """Return the cells of the local map that may not be flown, shape (l, l)."""
    return np.ascontiguousarray(local[_NO_FLY_LAYER] != 0)


def _surroundings(local: NDArray[Any], action: int) -> tuple[bool, ...]:
    """Return what may change on a straight flight: walls to the left and to the right, and whether this is a landing cell."""
    middle, (down, right) = local.shape[1] // 2, OFFSETS[action].tolist()
    sides = ((-right, down), (right, -down))
    closed = (bool(local[_NO_FLY_LAYER, middle + y, middle + x]) for y, x in sides)
    return (*closed, bool(local[_LANDING_LAYER, middle, middle]))


@kernel
def _search(closed: NDArray[np.bool_], last: NDArray[np.int64]) -> None:
    """Write the last action of a shortest path from the middle to each cell, shape (l, l); −1 where there is none.

    Moves are tried in the order of the actions, so paths are always the same. To the middle leads ``hover``.
    """
    size = len(closed)
    queue = np.empty(size * size, dtype=np.int64)
    last[:] = -1
    queue[0] = (size // 2) * size + size // 2
    last[size // 2, size // 2] = HOVER
    first, number = 0, 1
    while first < number:
        r, c = queue[first] // size, queue[first] % size
        first += 1
        for action in range(HOVER):
            y, x = r + OFFSETS[action, 0], c + OFFSETS[action, 1]
            if 0 <= y < size and 0 <= x < size and not closed[y, x] and last[y, x] < 0:
                last[y, x] = action
                queue[number] = y * size + x
                number += 1


@kernel
def _first_actions(closed: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the first action of the path to each cell, shape (l, l); −1 where there is none."""
    size = len(closed)
    last = np.empty((size, size), dtype=np.int64)
    _search(closed, last)
    first = last.copy()
    for r in range(size):
        for c in range(size):
            y, x = r, c
            while last[y, x] >= 0 and last[y, x] != HOVER:
                first[r, c] = last[y, x]
                y, x = y - OFFSETS[first[r, c], 0], x - OFFSETS[first[r, c], 1]
    return first


@kernel
def _path(closed: NDArray[np.bool_], cell: int) -> NDArray[np.int64]:
    """Return the actions of the path to a cell, which is given by its row-major number; none if there is no path."""
    size = len(closed)
    last = np.empty((size, size), dtype=np.int64)
    _search(closed, last)
    actions = np.empty(size * size, dtype=np.int64)
    y, x, number = cell // size, cell % size, 0
    if last[y, x] == HOVER:
        actions[0], number = HOVER, 1
    while last[y, x] >= 0 and last[y, x] != HOVER:
        actions[number] = last[y, x]
        y, x = y - OFFSETS[actions[number], 0], x - OFFSETS[actions[number], 1]
        number += 1
    return actions[:number][::-1].copy()
