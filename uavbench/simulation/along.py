"""What a flight outside the grid covers or collects, by the rules of the mission: the camera and the radio along any way."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uavbench.simulation.simulator import Simulator
from uavbench.world.scenario import Scenario, SplitName


def collected_along(scenario: Scenario, split: SplitName, number: int, ways: Sequence[NDArray[np.float64]]) -> float:
    """Return the CR of an episode whose UAVs fly along ways.

    Parameters
    ----------
    scenario : Scenario
    split : {"train", "validation", "test"}
    number : int
        Which episode; only its start, budget and targets are used.
    ways : sequence of ndarray, shape (T, 2)
        For each UAV, the places at which it covers or collects: row and column, not rounded. In DH, each is one communication
        step. Places off the map count as the nearest cell.

    Returns
    -------
    float
        In [0, 1].
    """
    simulator = Simulator(scenario, 1)
    simulator.reset([0], split, [number])
    state, limits = simulator.state, np.array(scenario.shape) - 1.0
    for step in range(max(map(len, ways), default=0)):
        for uav, way in enumerate(ways):
            if step < len(way):
                state.budget[0, uav] = state.initial_budget[0, uav] - step  # which counts the steps, and so draws the noise
                row, col = np.clip(way[step], 0.0, limits).tolist()
                simulator.mission.collect_at(state, uav, (row, col))
    total = float(state.total[0])
    return 1.0 - float(state.remaining[0]) / total if total else 1.0
