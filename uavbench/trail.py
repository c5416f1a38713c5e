"""What a flight leaves behind, for pictures: the cells of each UAV, what was there at first, and which device was served."""

import numpy as np
from numpy.typing import NDArray

from uavbench.simulator import Simulator

Cell = tuple[int, int]


class Trail:
    """The way of the episode that has just begun in a slot; `extend` after every step.

    Parameters
    ----------
    simulator : Simulator
    i : int
        The slot.

    Attributes
    ----------
    cells : list of list of (int, int)
        Where each UAV was: at the start, and after each of its steps.
    served : list of int
        DH with one UAV: the device that lost most data in each step; −1 for none.
    target : ndarray of float32, shape (M, N)
        The target map at the start.
    unseen : ndarray of float32, shape (M, N)
        DH: the share of devices that a cell has no line of sight to. Nothing in CPP.
    """

    def __init__(self, simulator: Simulator, i: int) -> None:
        state = simulator.state
        self._simulator, self._slot = simulator, i
        self.cells: list[list[Cell]] = [[(r, c)] for r, c in state.position[i, : state.uavs[i]].tolist()]
        self.target: NDArray[np.float32] = state.target[i].copy()
        self.served: list[int] = []
        view = simulator.mission.view(i)
        self._data = view["device_data"].copy() if "device_data" in view else None
        devices: list[list[int]] = view["device_cell"].tolist() if "device_cell" in view else []
        sights = np.array([simulator.city.visible(cell) for cell in devices], dtype=np.bool_).reshape(
            len(devices), *simulator.city.shape
        )
        self.unseen: NDArray[np.float32] = (~sights).sum(axis=0, dtype=np.float32) / max(len(devices), 1)

    def extend(self) -> None:
        """Add the step that was just flown."""
        state, i = self._simulator.state, self._slot
        flown = [len(way) <= int(state.initial_budget[i, u] - state.budget[i, u]) for u, way in enumerate(self.cells)]
        for u, way in enumerate(self.cells):
            if flown[u]:
                r, c = state.position[i, u].tolist()
                way.append((r, c))
        if self._data is not None and any(flown):
            now = self._simulator.mission.view(i)["device_data"]
            lost = self._data - now
            self.served.append(int(lost.argmax()) if lost.any() else -1)
            self._data = now.copy()
