"""What a mission is: how its targets are drawn, and what a step covers or collects.

Light to import: scenarios are read without a compiler. docs/missions.md shows how to write one.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from uavbench.simulation.state import State
    from uavbench.world.episode import Columns


class Mission(ABC):
    """What the simulator asks of a mission. ``index`` names slots of the batch; B is its size.

    A mission owns the target map of the state (``target``, and ``counts`` or ``spots`` if its parameters name such a
    ``pooling``), the sums that belong to it (``total`` and ``remaining``), its layers of the observation (``layers``), and
    whatever arrays it needs besides, which it names in `arrays`.
    """

    #: How many threads `sample` and `collect` may use: the simulator sets it. A mission need not use more than one.
    threads: int = 1

    #: The one option of ``reset`` that sets the targets by hand.
    option: ClassVar[str]

    @abstractmethod
    def sample(self, state: "State", index: NDArray[np.int64]) -> None:
        """Begin episodes in the slots ``index``: draw their targets from their keys, and reset the mission's own arrays."""

    @abstractmethod
    def columns(self, state: "State", index: NDArray[np.int64]) -> "Columns":
        """Return the targets that the episodes in the slots ``index`` began with, as columns of a table of episodes."""

    @abstractmethod
    def restore(self, state: "State", index: NDArray[np.int64], columns: "Columns") -> None:
        """Begin episodes in the slots ``index`` with the targets of the rows of ``columns``, and reset the own arrays."""

    @abstractmethod
    def fits(self, columns: "Columns") -> bool:
        """Say whether frozen columns can be of this scenario."""

    @abstractmethod
    def parse(self, value: Any) -> "Columns":
        """Turn the option of ``reset`` into columns of one row, or raise a ValueError that says what is wrong."""

    @abstractmethod
    def collect(self, state: "State", uav: int) -> None:
        """Cover or collect with UAV ``uav`` of every slot, where it flies on, and add the gain to its reward."""

    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """Return the mission's own arrays that change in an episode or from episode to episode, each of shape (B, …).

        The simulator copies their rows when it takes or sets the state of a slot, so what is not in here is lost then.
        """
        return {}

    def view(self, i: int) -> Mapping[str, NDArray[Any]]:
        """Return what agents on the state track see of slot ``i`` besides the target map, by name."""
        return {}

    def marks(self, i: int) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return what pictures draw as marks in slot ``i``: cells, shape (K, 2), and the amount left at each, shape (K,).

        Without marks, pictures colour the cells of the target map.
        """
        return np.zeros((0, 2), dtype=np.int32), np.zeros(0)

    def shade(self, i: int) -> NDArray[np.float32] | None:
        """Return how dark pictures of slot ``i`` draw each cell, shape (M, N), in [0, 1]; None for no shade anywhere."""
        return None
