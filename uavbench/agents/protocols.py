"""The methods of agents and learners, for type checkers and readers. docs/agents.md has the complete contract."""

from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@runtime_checkable
class Agent(Protocol):
    """An agent that decides for one UAV at a time.

    Instead of ``act``, or in addition to it, it may have ``act_batch(observations, infos)``, which decides for many episodes at
    once, or ``act_team(observations, infos)``, which decides for all UAVs of a team together. If it has ``reset(info)``, this
    is called before each episode. With ``track = "state"``, ``info["state"]`` shows everything except future noise. With
    ``safe_mask = True``, ``info["safe_action_mask"]`` says which actions are safe.
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
    """What ``uavbench train`` needs from the class ``Learner(scenario, config, seed)`` of a learned agent: see docs/agents.md.

    Attributes
    ----------
    updates, samples : int
        Number of gradient steps so far, and number of steps of episodes that the learner has learned from.
    """

    updates: int

    @property
    def samples(self) -> int:
        """Number of steps of episodes that the learner has learned from."""
        ...

    def advance(self) -> dict[str, float]:
        """Do one update, and return numbers to plot, by name."""
        ...

    def start_from(self, path: Path) -> None:
        """Start from the weights in a file."""
        ...

    def weights(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that the agent needs to fly, by name."""
        ...

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that changes during a training, as arrays by name."""
        ...

    def resume(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Continue from a `snapshot`."""
        ...
