"""The state of a batch of episodes: plain arrays, batch first, changed in place and never reallocated."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.simulation.city_maps import CityMaps, new_maps
from uavbench.simulation.pooling import count_targets, find_targets, new_counts
from uavbench.world.scenario import Scenario


class State(NamedTuple):
    """The state of B episodes with at most U UAVs each on an M×N map.

    Attributes
    ----------
    maps : CityMaps
        The maps of the cities: see `uavbench.simulation.city_maps`.
    key : ndarray of uint64, shape (B,)
        The episode keys.
    noise : ndarray of bool, shape (B,)
        Whether shadow fading is on.
    uavs : ndarray of int32, shape (B,)
        How many UAVs the episode has; they come first in its row. The other UAVs of the row count as landed from the start.
    position, previous : ndarray of int32, shape (B, U, 2)
        The UAVs' cells (row, column), now and before the last move.
    budget, initial_budget : ndarray of int32, shape (B, U)
        Actions left, b(t), and at the start.
    blocked : ndarray of int32, shape (B, U)
        How often the safety controller kept the UAV in place.
    landed, done : ndarray of bool, shape (B, U)
        Whether the UAV has landed, and whether it is done (landed or crashed). The episode ends when all its UAVs are done.
    target : ndarray of float32, shape (B, M, N)
        The target map D(t): 1 where a cell is still to cover, or the data left at a device's cell.
    counts : ndarray of int, shape (B, g, H, g, W)
        The numbers of targets in the blocks of the global map, if the mission's ``pooling`` is ``"counts"``: see
        `uavbench.simulation.pooling`. Otherwise of shape (B, 0, 0, 0, 0).
    spots : ndarray of int32, shape (B, K, 2)
        The cells of the target map that can differ from 0, if ``pooling`` is ``"spots"``. Otherwise of shape (B, 0, 2).
    num_spots : ndarray of int32, shape (B,)
        The number of cells in ``spots``.
    layers : ndarray of float32, shape (B, L, M, N)
        The layers that the mission adds to the observation besides the target map; L may be 0.
    total, remaining : ndarray of float64, shape (B,)
        Target cells or data units at the start, and those left.
    reward : ndarray of float64, shape (B, U)
        The rewards of the last step.
    """

    maps: CityMaps
    key: NDArray[np.uint64]
    noise: NDArray[np.bool_]
    uavs: NDArray[np.int32]
    position: NDArray[np.int32]
    previous: NDArray[np.int32]
    budget: NDArray[np.int32]
    initial_budget: NDArray[np.int32]
    blocked: NDArray[np.int32]
    landed: NDArray[np.bool_]
    done: NDArray[np.bool_]
    target: NDArray[np.float32]
    counts: NDArray[Any]
    spots: NDArray[np.int32]
    num_spots: NDArray[np.int32]
    layers: NDArray[np.float32]
    total: NDArray[np.float64]
    remaining: NDArray[np.float64]
    reward: NDArray[np.float64]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that have a row for each slot, by name: all except the maps, which follow from the keys."""
        return {name: array for name, array in self._asdict().items() if name != "maps"}


def new_state(scenario: Scenario, num_envs: int, max_uavs: int) -> State:
    """Return the state of a batch in which no episode is running (``done`` everywhere)."""
    each, shape, mission = (num_envs, max_uavs), scenario.shape, scenario.mission
    return State(
        maps=new_maps(scenario, num_envs),
        key=np.zeros(num_envs, dtype=np.uint64),
        noise=np.ones(num_envs, dtype=np.bool_),
        uavs=np.zeros(num_envs, dtype=np.int32),
        position=np.zeros((*each, 2), dtype=np.int32),
        previous=np.zeros((*each, 2), dtype=np.int32),
        budget=np.zeros(each, dtype=np.int32),
        initial_budget=np.zeros(each, dtype=np.int32),
        blocked=np.zeros(each, dtype=np.int32),
        landed=np.zeros(each, dtype=np.bool_),
        done=np.ones(each, dtype=np.bool_),
        target=np.zeros((num_envs, *shape), dtype=np.float32),
        counts=new_counts(num_envs, shape, scenario.observation.global_scale)
        if mission.pooling == "counts"
        else np.zeros((num_envs, 0, 0, 0, 0), dtype=np.uint8),
        spots=np.zeros((num_envs, mission.max_targets if mission.pooling == "spots" else 0, 2), dtype=np.int32),
        num_spots=np.zeros(num_envs, dtype=np.int32),
        layers=np.zeros((num_envs, len(mission.layers), *shape), dtype=np.float32),
        total=np.zeros(num_envs, dtype=np.float64),
        remaining=np.zeros(num_envs, dtype=np.float64),
        reward=np.zeros(each, dtype=np.float64),
    )


def index_targets(state: State) -> None:
    """Compute ``counts`` or ``spots`` of target maps that were set from outside."""
    for i in range(len(state.target)):
        if state.counts.size:
            count_targets(state.target[i], state.counts[i])
        elif state.spots.size:
            state.num_spots[i] = find_targets(state.target[i], state.spots[i])
