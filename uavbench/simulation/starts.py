"""How an episode starts: the number of UAVs, their start cells and budgets, all drawn from the episode's key."""

import numpy as np
from numpy.typing import NDArray

from uavbench.simulation.city_maps import fill_landing_cells
from uavbench.world.kernel import kernel
from uavbench.world.keyed import SCATTER, START, TEAM, next_integer, stream


@kernel
def draw_starts(
    index: NDArray[np.int64],
    key: NDArray[np.uint64],
    uavs: NDArray[np.int32],
    position: NDArray[np.int32],
    previous: NDArray[np.int32],
    budget: NDArray[np.int32],
    initial_budget: NDArray[np.int32],
    blocked: NDArray[np.int32],
    landed: NDArray[np.bool_],
    done: NDArray[np.bool_],
    noise: NDArray[np.bool_],
    reward: NDArray[np.float64],
    city: NDArray[np.int64],
    ground: NDArray[np.uint8],
    margin: int,
    low: int,
    high: int,
    min_uavs: int,
    max_uavs: int,
    listed: NDArray[np.int64],
    landing_cells: NDArray[np.int32],
) -> None:
    """Draw the numbers of UAVs, start cells and budgets of the slots ``index``, and clear what earlier episodes left.

    Cells and budgets are always drawn for the largest possible number of UAVs, so that those of the first UAVs do not depend on
    how many UAVs fly. ``listed``, shape (2,), holds the number of the map whose landing cells are in ``landing_cells``,
    shape (M · N, 2), and how many they are; −1 at first. Slots in one city share the list.
    """
    cursor = np.empty(1, dtype=np.uint64)
    for n in range(len(index)):
        i = int(index[n])
        if city[i] != listed[0]:
            listed[0], listed[1] = city[i], fill_landing_cells(ground[city[i]], margin, landing_cells)
        cursor[0] = stream(key[i], TEAM)
        uavs[i] = min_uavs + next_integer(cursor, max_uavs - min_uavs + 1)
        cursor[0] = stream(key[i], START)
        noise[i] = True
        for u in range(max_uavs):
            r, c, taken = 0, 0, True
            while taken:
                r, c = landing_cells[next_integer(cursor, listed[1])]
                taken = False
                for w in range(u):
                    taken = taken or (position[i, w, 0] == r and position[i, w, 1] == c)
            position[i, u, 0], position[i, u, 1] = r, c
            previous[i, u, 0], previous[i, u, 1] = r, c
            budget[i, u] = initial_budget[i, u] = low + next_integer(cursor, high - low + 1)
            blocked[i, u] = 0
            landed[i, u] = done[i, u] = u >= uavs[i]
            reward[i, u] = 0.0


@kernel
def scatter_starts(
    index: NDArray[np.int64],
    key: NDArray[np.uint64],
    uavs: NDArray[np.int32],
    position: NDArray[np.int32],
    previous: NDArray[np.int32],
    budget: NDArray[np.int32],
    initial_budget: NDArray[np.int32],
    free: NDArray[np.int32],
    home: NDArray[np.int32],
    largest: int,
) -> None:
    """Draw cells among ``free``, and budgets that suffice to land, for the UAVs of the slots ``index``, all in one city.

    ``home`` holds the distance to landing of each cell, ``largest`` is the largest budget.
    """
    cursor = np.empty(1, dtype=np.uint64)
    for n in range(len(index)):
        i = int(index[n])
        cursor[0] = stream(key[i], SCATTER)
        for u in range(uavs[i]):
            r, c, taken = 0, 0, True
            while taken:
                r, c = free[next_integer(cursor, len(free))]
                taken = home[r, c] >= largest
                for w in range(u):
                    taken = taken or (position[i, w, 0] == r and position[i, w, 1] == c)
            position[i, u, 0], position[i, u, 1] = r, c
            previous[i, u] = position[i, u]
            least = int(home[r, c]) + 1
            budget[i, u] = initial_budget[i, u] = least + next_integer(cursor, largest - least + 1)
