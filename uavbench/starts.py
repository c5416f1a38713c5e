"""How an episode starts: how many UAVs, from which cells, with which budgets; drawn from the episode's key."""

import numpy as np
from numpy.typing import NDArray

from uavbench.kernel import kernel
from uavbench.keyed import SCATTER, START, TEAM, next_integer, stream
from uavbench.state import State


@kernel
def draw_starts(
    state: State,
    index: NDArray[np.int64],
    landing_cells: NDArray[np.int32],
    low: int,
    high: int,
    fewest: int,
    most: int,
) -> None:
    """Draw how many UAVs fly, start cells and budgets of the slots ``index``, and clear what an earlier episode left.

    Cells and budgets are drawn for as many UAVs as there may be, so that those of the first do not depend on how many fly.
    """
    cursor = np.empty(1, dtype=np.uint64)
    for n in range(len(index)):
        i = int(index[n])
        cursor[0] = stream(state.key[i], TEAM)
        state.uavs[i] = fewest + next_integer(cursor, most - fewest + 1)
        cursor[0] = stream(state.key[i], START)
        for u in range(most):
            taken = True
            while taken:
                cell = landing_cells[next_integer(cursor, len(landing_cells))]
                taken = False
                for w in range(u):
                    taken = taken or (state.position[i, w, 0] == cell[0] and state.position[i, w, 1] == cell[1])
                state.position[i, u] = cell
            state.previous[i, u] = state.position[i, u]
            state.budget[i, u] = state.initial_budget[i, u] = low + next_integer(cursor, high - low + 1)
            state.blocked[i, u] = 0
            state.landed[i, u] = state.done[i, u] = u >= state.uavs[i]
            state.reward[i, u] = 0.0
        state.noise[i] = True


@kernel
def scatter_starts(
    state: State, index: NDArray[np.int64], free: NDArray[np.int32], home: NDArray[np.int32], largest: int
) -> None:
    """Draw cells among ``free``, and budgets that allow to land, for the UAVs of the slots ``index``."""
    cursor = np.empty(1, dtype=np.uint64)
    for n in range(len(index)):
        i = int(index[n])
        cursor[0] = stream(state.key[i], SCATTER)
        for u in range(state.uavs[i]):
            r, c, taken = 0, 0, True
            while taken:
                r, c = free[next_integer(cursor, len(free))]
                taken = home[r, c] >= largest
                for w in range(u):
                    taken = taken or (state.position[i, w, 0] == r and state.position[i, w, 1] == c)
            state.position[i, u, 0], state.position[i, u, 1] = r, c
            state.previous[i, u] = state.position[i, u]
            least = int(home[r, c]) + 1
            state.budget[i, u] = state.initial_budget[i, u] = least + next_integer(cursor, largest - least + 1)
