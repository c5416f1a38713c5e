"""The state of a batch of episodes: plain arrays, batch first, changed in place and never reallocated."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class State(NamedTuple):
    """The state of B episodes on an M×N map.

    Attributes
    ----------
    key : ndarray of uint64, shape (B,)
        The episode keys.
    noise : ndarray of bool, shape (B,)
        Whether shadow fading is on.
    position, previous : ndarray of int32, shape (B, 2)
        The UAVs' cells (row, column), now and before the last move.
    budget, initial_budget : ndarray of int32, shape (B,)
        Actions left, b(t), and at the start.
    blocked : ndarray of int32, shape (B,)
        How often the safety controller kept the UAV in place.
    landed, done : ndarray of bool, shape (B,)
        Whether the UAV has landed, and whether the episode has ended (landed or crashed).
    target : ndarray of float32, shape (B, M, N)
        The target map D(t): 1 where a cell is still to cover, or the data left at a device's cell.
    row_targets : ndarray of int32, shape (B, M)
        How many cells of each row of the target map are not 0: the observation passes over the others.
    total, remaining : ndarray of float64, shape (B,)
        Target cells or data units at the start, and left.
    reward : ndarray of float64, shape (B,)
        The reward of the last step.
    """

    key: NDArray[np.uint64]
    noise: NDArray[np.bool_]
    position: NDArray[np.int32]
    previous: NDArray[np.int32]
    budget: NDArray[np.int32]
    initial_budget: NDArray[np.int32]
    blocked: NDArray[np.int32]
    landed: NDArray[np.bool_]
    done: NDArray[np.bool_]
    target: NDArray[np.float32]
    row_targets: NDArray[np.int32]
    total: NDArray[np.float64]
    remaining: NDArray[np.float64]
    reward: NDArray[np.float64]


def new_state(num_envs: int, shape: tuple[int, int]) -> State:
    """Return a state in which no episode runs (``done`` everywhere)."""
    return State(
        key=np.zeros(num_envs, dtype=np.uint64),
        noise=np.ones(num_envs, dtype=np.bool_),
        position=np.zeros((num_envs, 2), dtype=np.int32),
        previous=np.zeros((num_envs, 2), dtype=np.int32),
        budget=np.zeros(num_envs, dtype=np.int32),
        initial_budget=np.zeros(num_envs, dtype=np.int32),
        blocked=np.zeros(num_envs, dtype=np.int32),
        landed=np.zeros(num_envs, dtype=np.bool_),
        done=np.ones(num_envs, dtype=np.bool_),
        target=np.zeros((num_envs, *shape), dtype=np.float32),
        row_targets=np.zeros((num_envs, shape[0]), dtype=np.int32),
        total=np.zeros(num_envs, dtype=np.float64),
        remaining=np.zeros(num_envs, dtype=np.float64),
        reward=np.zeros(num_envs, dtype=np.float64),
    )
