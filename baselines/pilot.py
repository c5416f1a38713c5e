"""Pilot: remembers what it saw, completes what the blurred map hides by a learned network, and plans on that.

It decides by the observation alone, as the paper's agent does, and uses more than that one did:

- the scenario's map, which tells where it is (the paper's agent sees it, too, but has to learn what it means);
- memory: blocks of the global map overlap from cell to cell, and tell most cells apart (`uavbench.planning.belief`);
- in CPP a network, learned from episodes of the train split, for what they do not tell: how target zones look;
- the rules: it searches over whole flights, as `planner` does, again whenever it has learned something new.

It learns nothing in DH: devices are anywhere with the same likelihood. Needs PyTorch for CPP: ``pip install 'uavbench[ddqn]'``.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from planner import Agent as Planner

from uavbench.city import City, city_of
from uavbench.keyed import mix
from uavbench.observation import Observer
from uavbench.planning.belief import DeviceBelief, TargetBelief, places, static
from uavbench.planning.harvesting import expected_rates
from uavbench.resources import shipped_weights
from uavbench.simulator import Simulator


@dataclass
class Believed:
    """What `planner` asks of a state, as far as it is known."""

    uav: int
    city: City
    position: tuple[int, int]
    budget: int
    target: Any
    device_cell: Any = None
    device_data: Any = None


class Agent(Planner):
    """Believes, plans, and plans again as it learns more.

    Parameters
    ----------
    scenario : Scenario
        For one UAV.
    weights : Path, optional
        Of the network; by default the ones that come with the suite. Where there are none, only sums of blocks count.
    """

    track = "observation"

    def __init__(self, scenario, weights: Path | None = None):
        if scenario.team:
            raise ValueError(f"pilot flies one UAV; {scenario.id} is for teams: choose one without Team in its id")
        super().__init__(scenario)
        self._city, self._places = city_of(scenario), places(scenario)
        weights = weights or shipped_weights("pilot").get(scenario.id)
        self._completion = None if self._harvests or weights is None else _load(weights)

    def reset(self, info):
        """Forget the last episode."""
        super().reset(info)
        self._belief = DeviceBelief(self._scenario) if self._harvests else TargetBelief(self._scenario)
        self._guess = np.zeros(self._scenario.shape, dtype=bool)

    def act(self, observation, info):
        """Return the next action of the flight that is best for all that is known."""
        here = self._places[static(observation["global"])]
        belief, budget = self._belief, int(observation["budget"][0])
        if isinstance(belief, DeviceBelief):
            changed = belief.learn(here, observation)
            state = Believed(0, self._city, here, budget, belief.data, **belief.devices())
            if changed:
                self._rates = expected_rates(self._scenario, state.device_cell)
        else:
            if belief.learn(here, observation):
                self._guess = (belief.likely if self._completion is None else self._completion.complete(belief)) > 0.5
            target = np.where(belief.known, belief.now, self._guess).astype(np.float32)
            state = Believed(0, self._city, here, budget, target)
            if self._flights and (target > self._expected).any() | (target < self._expected).any():
                self._mend([state])
            self._expected = target
        return self.act_team([observation], [{**info, "state": state}])[0]
