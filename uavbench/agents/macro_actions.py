"""The base of agents that decide by macro-actions: they are evaluated as any others, action by action."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.simulation.macro_actions import Flight, MacroKind
from uavbench.world.scenario import Scenario


class MacroAgent:
    """An agent for one UAV that decides by macro-actions (`uavbench.simulation.macro_actions`).

    A subclass defines `choose`. The moves of a macro-action are those of the wrapper `uavbench.envs.macro_actions.MacroActions`
    around an environment with ``safe_action_mask=True``, so a policy that was trained there flies here as there.

    Parameters
    ----------
    scenario : Scenario
        A scenario with a local map.

    Raises
    ------
    ValueError
        When the scenario is for teams, or has no local map.
    """

    track = "observation"
    #: Asks the evaluation for the safe actions.
    safe_mask = True
    #: ``"cells"`` or ``"directions"``.
    kind = "cells"

    def __init__(self, scenario: Scenario) -> None:
        if scenario.team:
            raise ValueError(f"macro-actions are for one UAV; {scenario.id} is for teams: choose one without Team in its id")
        self.macro_actions = MacroKind(self.kind, scenario.observation.local_size)
        self._flight: Flight | None = None

    def reset(self, info: Mapping[str, Any]) -> None:  # noqa: ARG002  # of the protocol of agents
        """Forget the macro-action of the last episode."""
        self._flight = None

    def choose(self, observation: Mapping[str, NDArray[np.float32]], mask: NDArray[np.int8], info: Mapping[str, Any]) -> int:
        """Return the next macro-action, one of those that ``mask``, shape (number,), has 1 for."""
        raise NotImplementedError

    def act(self, observation: Mapping[str, NDArray[np.float32]], info: Mapping[str, Any]) -> int:
        """Return the next action of the macro-action that is being flown; when it is over, choose another one."""
        local, allowed = observation["local"], info["action_mask"] & info["safe_action_mask"]
        action = None if self._flight is None else self._flight.next(local, allowed)
        if action is None:
            chosen = int(self.choose(observation, self.macro_actions.mask(local, allowed), info))
            self._flight = self.macro_actions.begin(chosen, local)
            action = self._flight.next(local, allowed)
        assert action is not None
        return action
