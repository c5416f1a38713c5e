"""What a mission is: how its targets are drawn, and what a step covers or collects.

A mission is one file here and its parameters in `uavbench.parameters`. It owns the target map of the state and whatever
arrays it needs besides; the simulator moves the UAVs and then asks it to `collect`.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from uavbench.city import City
from uavbench.episode import Columns
from uavbench.parameters import Coverage
from uavbench.scenario import Scenario
from uavbench.state import State


class Mission(Protocol):
    """What the simulator asks of a mission. ``index`` names slots of the batch; N is the batch size."""

    #: The one option of ``reset`` that sets the targets by hand.
    option: str

    def sample(self, state: State, index: NDArray[np.int64]) -> None:
        """Draw the targets of the slots ``index`` from their keys."""
        ...

    def columns(self, state: State, index: NDArray[np.int64]) -> Columns:
        """Return the targets of the slots ``index`` as columns of a table of episodes."""
        ...

    def restore(self, state: State, index: NDArray[np.int64], columns: Columns) -> None:
        """Set the targets of the slots ``index`` from the rows of ``columns``."""
        ...

    def fits(self, columns: Columns) -> bool:
        """Say whether frozen columns can be of this scenario."""
        ...

    def parse(self, value: Any) -> Columns:
        """Turn the option of ``reset`` into columns of one row, or raise a ValueError that says what is wrong."""
        ...

    def collect(self, state: State, uav: int) -> None:
        """Cover or collect with UAV ``uav`` of every slot, where it flies on, and add the gain to its reward."""
        ...

    def view(self, i: int) -> Mapping[str, NDArray[Any]]:
        """Return the mission's own arrays of slot ``i``, for agents on the state track."""
        ...


def mission_of(scenario: Scenario, city: City, num_envs: int) -> Mission:
    """Return the scenario's mission, with arrays for a batch of ``num_envs``."""
    if isinstance(scenario.mission, Coverage):
        from uavbench.missions.coverage import CoverageMission

        return CoverageMission(scenario, scenario.mission, city)
    from uavbench.missions.harvesting import HarvestingMission

    return HarvestingMission(scenario, scenario.mission, city, num_envs)
