"""What a mission is: how its targets are drawn, and what a step covers or collects.

This module does not import Numba, so that it is quick to import. docs/missions.md shows how to write a mission.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from uavbench.simulation.state import State
    from uavbench.world.city import City
    from uavbench.world.episode import Columns


class Mission(ABC):
    """What the simulator requires of a mission. ``index`` names slots of the batch; B is the size of the batch.

    A mission maintains the target map of the state (``target``, and ``counts`` or ``spots`` if its parameters name such a
    ``pooling``), the sums over it (``total`` and ``remaining``), the mission's own layers of the observation (``layers``), and
    any other arrays that it needs, which it names in `arrays`.

    The maps of the slots' cities are in the state, ``state.maps``. A mission that is made for one map may also read
    `uavbench.world.city.city_of` of its scenario.
    """

    #: How many threads `sample` and `collect` may use. The simulator sets it; a mission may use fewer.
    threads: int = 1

    #: The name of the option of ``reset`` that sets the targets by hand.
    option: ClassVar[str]

    @abstractmethod
    def sample(self, state: "State", index: NDArray[np.int64]) -> None:
        """Start episodes in the slots ``index``: draw their targets from their keys, and reset the mission's own arrays."""

    @abstractmethod
    def columns(self, state: "State", index: NDArray[np.int64]) -> "Columns":
        """Return the targets of the episodes just started in the slots ``index``, as columns of a table of episodes."""

    @abstractmethod
    def restore(self, state: "State", index: NDArray[np.int64], columns: "Columns") -> None:
        """Start episodes in the slots ``index`` with the targets in the rows of ``columns``, and reset the mission's arrays."""

    @abstractmethod
    def fits(self, columns: "Columns", city: "City") -> bool:
        """Return whether frozen columns can belong to this scenario; all their episodes take place in ``city``."""

    @abstractmethod
    def parse(self, value: Any, city: "City") -> "Columns":
        """Turn the value of the option of ``reset`` into columns with one row; raise a ValueError if it is wrong there."""

    @abstractmethod
    def collect(self, state: "State", uav: int) -> None:
        """Cover or collect with UAV ``uav`` of every slot where it is active, and add the gain times r_c to its reward."""

    def collect_at(self, state: "State", uav: int, place: tuple[float, float]) -> None:
        """Cover or collect with UAV ``uav`` of slot 0 from a place between cells, for flights outside the grid.

        Parameters
        ----------
        state : State
            A state of one slot.
        uav : int
        place : (float, float)
            Row and column, not rounded, on the map. By default what is covered or collected in the cell is.
        """
        rows, cols = state.target.shape[1:]
        cell = [min(max(round(place[0]), 0), rows - 1), min(max(round(place[1]), 0), cols - 1)]
        state.previous[0, uav] = state.position[0, uav] = cell
        self.collect(state, uav)

    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """Return the mission's own arrays that change within an episode or between episodes, each of shape (B, …).

        The simulator copies their rows when it gets or sets the state of a slot; other arrays are not saved or restored.
        """
        return {}

    def view(self, i: int) -> Mapping[str, NDArray[Any]]:
        """Return by name the arrays that agents on the state track see of slot ``i`` besides the target map."""
        return {}

    def marks(self, i: int) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return what pictures draw as marks in slot ``i``: cells, shape (K, 2), and the amount left at each, shape (K,).

        Without marks, pictures colour the cells of the target map.
        """
        return np.zeros((0, 2), dtype=np.int32), np.zeros(0)

    def shade(self, i: int, city: "City") -> NDArray[np.float32] | None:
        """Return how dark pictures of slot ``i`` draw each cell of its city, shape (M, N), in [0, 1]; None for no shade."""
        return None
