"""How UAVs move: what one action does and costs, and which actions are valid.

The kernels of a step are called very often, so they take plain arrays: to pass a named tuple of arrays takes 1.5 µs.
"""

from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from uavbench.simulation.city_maps import LANDING_BIT, NO_FLY_BIT
from uavbench.world.city import HOVER, LAND, OFFSETS
from uavbench.world.kernel import kernel, parallel_kernel, share


@kernel
def wrong_action(actions: NDArray[np.int64]) -> int:
    """Return the row-major index of the first action that is out of range; −1 if there is none."""
    for i in range(len(actions)):
        for u in range(actions.shape[1]):
            if actions[i, u] < 0 or actions[i, u] > LAND:
                return i * actions.shape[1] + u
    return -1


@kernel
def held_by_active(position: NDArray[np.int32], done: NDArray[np.bool_], i: int, r: int, c: int, first: int) -> bool:
    """Return whether an active UAV with index ``first`` or higher is at the cell (r, c) in slot ``i``."""
    held = False
    for w in range(first, done.shape[1]):
        held = held or (not done[i, w] and position[i, w, 0] == r and position[i, w, 1] == c)
    return held


@kernel
def move(
    first: int,
    last: int,
    uav: int,
    actions: NDArray[np.int64],
    position: NDArray[np.int32],
    previous: NDArray[np.int32],
    budget: NDArray[np.int32],
    blocked: NDArray[np.int32],
    landed: NDArray[np.bool_],
    done: NDArray[np.bool_],
    reward: NDArray[np.float64],
    city: NDArray[np.int64],
    ground: NDArray[np.uint8],
    margin: int,
    movement: float,
    safety: float,
    crash: float,
) -> None:
    """Fly one action with UAV ``uav`` in the slots [``first``, ``last``), and set its whole reward except for the gain."""
    for i in range(first, last):
        if done[i, uav]:
            reward[i, uav] = 0.0
            continue
        action = actions[i, uav]
        r, c = position[i, uav, 0], position[i, uav, 1]
        previous[i, uav, 0], previous[i, uav, 1] = r, c
        stayed = True
        if action == LAND:
            landed[i, uav] = ground[city[i], r + margin, c + margin] & LANDING_BIT > 0
        elif action != HOVER:
            y, x = r + OFFSETS[action, 0], c + OFFSETS[action, 1]
            blocks = ground[city[i], y + margin, x + margin] & NO_FLY_BIT  # in the margin, too
            if not blocks and not held_by_active(position, done, i, y, x, 0):
                position[i, uav, 0], position[i, uav, 1] = y, x
                stayed = False
            else:
                blocked[i, uav] += 1
        budget[i, uav] -= 1
        paid = 0.0
        if not landed[i, uav]:
            paid += movement
            if stayed and action != HOVER:
                paid += safety
            if budget[i, uav] == 0:
                paid += crash
        reward[i, uav] = paid
        done[i, uav] = landed[i, uav] or budget[i, uav] == 0


@parallel_kernel
def move_apart(threads: int, uav: int, actions: NDArray[np.int64], *rest: Any) -> None:
    """Call `move` for all slots with several threads."""
    for part in prange(threads):
        first, last = share(len(actions), part, threads)
        move(first, last, uav, actions, *rest)


@kernel
def write_masks(
    position: NDArray[np.int32],
    done: NDArray[np.bool_],
    city: NDArray[np.int64],
    ground: NDArray[np.uint8],
    margin: int,
    mask: NDArray[np.int8],
) -> None:
    """Write the valid actions, shape (B, U, 6), given the maps of the cities and the other UAVs."""
    slots, uavs = position.shape[:2]
    for i in range(slots):
        m = city[i]
        for u in range(uavs):
            r, c = position[i, u, 0], position[i, u, 1]
            for action in range(HOVER):
                y, x = r + OFFSETS[action, 0], c + OFFSETS[action, 1]
                valid = ground[m, y + margin, x + margin] & NO_FLY_BIT == 0
                if valid and u + 1 < uavs:
                    valid = not held_by_active(position, done, i, y, x, u + 1)
                mask[i, u, action] = valid
            mask[i, u, HOVER] = 1
            mask[i, u, LAND] = ground[m, r + margin, c + margin] & LANDING_BIT > 0


@kernel
def write_safe_masks(
    position: NDArray[np.int32],
    budget: NDArray[np.int32],
    city: NDArray[np.int64],
    ground: NDArray[np.uint8],
    margin: int,
    homes: NDArray[np.int32],
    mask: NDArray[np.int8],
) -> None:
    """Write the safe actions, shape (B, U, 6), as `City.safe_action_mask` does; ``homes`` are the distances to landing."""
    slots, uavs = position.shape[:2]
    for i in range(slots):
        m = city[i]
        for u in range(uavs):
            r, c = position[i, u, 0], position[i, u, 1]
            safe = 0
            for action in range(LAND + 1):
                y, x = r + OFFSETS[action, 0], c + OFFSETS[action, 1]
                if ground[m, y + margin, x + margin] & NO_FLY_BIT:
                    y, x = r, c
                possible = homes[m, y, x] + 1 <= budget[i, u] - 1
                if action == LAND and ground[m, r + margin, c + margin] & LANDING_BIT:
                    possible = True
                mask[i, u, action] = possible
                safe += possible
            if safe == 0:
                mask[i, u] = 1
