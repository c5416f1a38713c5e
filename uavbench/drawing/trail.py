"""The record of a flight that pictures need: the cells of each UAV, the first target map, and which marks were served."""

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.simulation.simulator import Simulator

Cell = tuple[int, int]


class Trail:
    """The trail of an episode that has just begun in a slot. Call `extend` after every step.

    Parameters
    ----------
    simulator : Simulator
    i : int
        The slot.

    Attributes
    ----------
    cells : list of list of (int, int)
        For each UAV, its cells at the start and after each of its steps.
    served : list of int
        For each step, in which all flying UAVs act, the mark (DH: the device) whose amount fell most; −1 if none fell.
    target : ndarray of float32, shape (M, N)
        The target map at the start.
    shade : ndarray of float32, shape (M, N), optional
        How dark pictures draw each cell: see `uavbench.simulation.missions.Mission.shade`.
    """

    def __init__(self, simulator: Simulator, i: int) -> None:
        state, mission = simulator.state, simulator.mission
        self._simulator, self._slot = simulator, i
        self.cells: list[list[Cell]] = [[(r, c)] for r, c in state.position[i, : state.uavs[i]].tolist()]
        self._spent: list[int] = self._used()  # actions before the trail began
        self.target: NDArray[np.float32] = state.target[i].copy()
        self.served: list[int] = []
        self._amounts = mission.marks(i)[1].copy()
        self.shade = mission.shade(i, simulator.city_at(i))

    def extend(self) -> None:
        """Add the step that was just flown."""
        used = self._used()
        flown = [len(way) <= used[u] - self._spent[u] for u, way in enumerate(self.cells)]
        for u, way in enumerate(self.cells):
            if flown[u]:
                r, c = self._simulator.state.position[self._slot, u].tolist()
                way.append((r, c))
        if any(flown):
            now = self._simulator.mission.marks(self._slot)[1]
            lost = self._amounts - now
            self.served.append(int(lost.argmax()) if lost.any() else -1)
            self._amounts = now.copy()

    def get_state(self) -> dict[str, Any]:
        """Return a copy of everything that the trail holds."""
        return copy.deepcopy({name: value for name, value in vars(self).items() if name not in ("_simulator", "_slot")})

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore what `get_state` returned for a trail of the same scenario."""
        vars(self).update(copy.deepcopy(dict(state)))

    def _used(self) -> list[int]:
        """Return how many actions each UAV has taken in the episode."""
        state, i = self._simulator.state, self._slot
        return (state.initial_budget[i] - state.budget[i])[: state.uavs[i]].tolist()
