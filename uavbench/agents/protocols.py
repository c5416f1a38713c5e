"""What an agent and a learner look like, for type checkers and readers. The whole contract is docs/agents.md."""

from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@runtime_checkable
class Agent(Protocol):
    """An agent that decides for one UAV at a time.

    Instead of ``act``, or beside it, it may have ``act_batch(observations, infos)``, which decides for many episodes at once,
    or ``act_team(observations, infos)``, which decides for all UAVs of a team together. If it has ``reset(info)``, that is
    called before each episode. With ``track = "state"``, ``info["state"]`` shows everything but the noise to come.
    """

    def act(self, observation: dict[str, NDArray[np.float32]], info: dict[str, Any]) -> int:
        """Return an action: 0 north, 1 east, 2 south, 3 west, 4 hover, 5 land.

        Parameters
        ----------
        observation : dict of str to ndarray of float32
            ``local`` (C, l, l), ``global`` (C, h, w) and ``budget`` (1,).
        info : dict
            ``action_mask`` int8 (6,), ``episode``, ``uav``, ``seed``; on the state track also ``state``.
        """
        ...


@runtime_checkable
class Learner(Protocol):
    """What ``uavbench train`` asks of a learned agent's ``Learner(scenario, config, seed)``: see docs/agents.md.

    Attributes
    ----------
    updates, samples : int
        Gradient steps done, and steps of episodes that were learned from.
    """

    updates: int

    @property
    def samples(self) -> int:
        """How many steps of episodes have been learned from."""
        ...

    def advance(self) -> dict[str, float]:
        """Make one update, and return numbers to plot, by name."""
        ...

    def start_from(self, path: Path) -> None:
        """Begin with the weights in a file."""
        ...

    def weights(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that the agent needs to fly, by name."""
        ...

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that changes in a training, as arrays by name."""
        ...

    def resume(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Go on from a `snapshot`."""
        ...
