"""What an agent on the state track sees: everything except the noise of future steps."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.simulation.simulator import Simulator
from uavbench.world.city import City
from uavbench.world.scenario import Scenario


class StateView:
    """A read-only view of one running episode for one of its UAVs. Its values change in each step: read them for each decision.

    Attributes
    ----------
    scenario : Scenario
        All parameters.
    uav : int
        The index of the UAV; UAV 0 moves first.
    """

    __slots__ = ("_i", "_simulator", "scenario", "uav")

    def __init__(self, simulator: Simulator, i: int, uav: int = 0) -> None:
        self.scenario: Scenario = simulator.scenario
        self._simulator = simulator
        self._i = i
        self.uav = uav

    @property
    def city(self) -> City:
        """The city of the episode: layers, distances, lines of sight."""
        return self._simulator.city_at(self._i)

    @property
    def position(self) -> tuple[int, int]:
        """The UAV's cell (row, column)."""
        r, c = self._simulator.state.position[self._i, self.uav].tolist()
        return r, c

    @property
    def budget(self) -> int:
        """Actions left."""
        return int(self._simulator.state.budget[self._i, self.uav])

    @property
    def positions(self) -> NDArray[np.int32]:
        """The cells of the team's UAVs, shape (U, 2), including UAVs that have landed or crashed."""
        return _read_only(self._simulator.state.position[self._i, : self._uavs])

    @property
    def budgets(self) -> NDArray[np.int32]:
        """The team's budgets, shape (U,)."""
        return _read_only(self._simulator.state.budget[self._i, : self._uavs])

    @property
    def active(self) -> NDArray[np.bool_]:
        """Which of the team's UAVs are active (neither landed nor crashed), shape (U,)."""
        return _read_only(~self._simulator.state.done[self._i, : self._uavs])

    @property
    def target(self) -> NDArray[np.float32]:
        """The target map D(t), shape (M, N): 1 where a cell is still to cover, or the data left at a device's cell."""
        return _read_only(self._simulator.state.target[self._i])

    @property
    def total(self) -> float:
        """Target cells or data units at the start."""
        return float(self._simulator.state.total[self._i])

    @property
    def remaining(self) -> float:
        """Target cells or data units left."""
        return float(self._simulator.state.remaining[self._i])

    @property
    def device_cell(self) -> NDArray[np.int32]:
        """DH: the devices' cells, shape (K, 2)."""
        return self._mission("device_cell")

    @property
    def device_data(self) -> NDArray[np.float64]:
        """DH: the data left at each device, shape (K,)."""
        return self._mission("device_data")

    @property
    def _uavs(self) -> int:
        return int(self._simulator.state.uavs[self._i])

    def __getattr__(self, name: str) -> NDArray[Any]:
        """Return another array that the mission shows: see `uavbench.simulation.missions.Mission.view`."""
        if name.startswith("_"):  # ``copy`` and ``pickle`` ask for names before ``_simulator`` exists
            raise AttributeError(name)
        return self._mission(name)

    def _mission(self, name: str) -> NDArray[Any]:
        arrays = self._simulator.mission.view(self._i)
        if name not in arrays:
            raise AttributeError(f"{self.scenario.id} has no {name}: its mission is {self.scenario.mission.kind}")
        return _read_only(arrays[name])


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only copy, so that an agent cannot change the simulator's array even by changing the flags."""
    copy = array.copy()
    copy.flags.writeable = False
    return copy
