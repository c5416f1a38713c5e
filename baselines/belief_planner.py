"""Belief planner: remembers what it saw, works out what the averaged global map hides, and plans on the result.

It decides by the observation alone, as the paper's agent does, but uses more than that agent:

- the scenario's map, to find out where it is (the paper's agent sees the map too, but has to learn what it means);
- memory: after each move, the blocks of the global map contain other cells; together, they determine most cells
  (`uavbench.planning.belief`);
- the rules: it searches over whole flights, as `planner` does, and again whenever it knows something new.

It learns nothing. Its former name is pilot. In CPP a network then guessed the cells that are not determined, but it gained
nothing.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from planner import Agent as Planner

from uavbench.planning.belief import DeviceBelief, TargetBelief, places, static
from uavbench.planning.harvesting import rates_for
from uavbench.world.city import City, city_of


@dataclass
class Believed:
    """The parts of a state that `planner` reads, as far as they are known or estimated."""

    uav: int
    city: City
    position: tuple[int, int]
    budget: int
    target: Any
    device_cell: Any = None
    device_data: Any = None


class Flights(Planner):
    """The planner for a belief that changes: it searches less for the first flight, and in CPP improves it at every change."""

    def __init__(self, scenario):
        super().__init__(scenario)
        self.searches, self.changes, self.refined = (2 if self._harvests else 1), 250, 0
        if not self._harvests:  # in CPP a flight is improved only when something new is known, but then more
            self.mending_changes, self.mending_heat = 60_000, 1.0

    def revise(self, believed):
        """Take over new devices, or improve the flight for new targets."""
        if self._harvests:
            self._rates = rates_for(self._scenario, believed.device_cell, believed.city)
        elif self._flights:
            self._mend([believed])


class Agent:
    """Estimates where targets or data are, plans a flight, and plans again when it learns more.

    Parameters
    ----------
    scenario : Scenario
        A scenario for one UAV, with one map.
    """

    track = "observation"

    def __init__(self, scenario):
        if scenario.team:
            raise ValueError(f"belief_planner flies one UAV; {scenario.id} is for teams: choose one without Team in its id")
        if scenario.cities is not None:
            raise ValueError(f"belief_planner knows its map, and {scenario.id} has many cities: choose a scenario with one map")
        self._scenario, self._planner = scenario, Flights(scenario)
        self._harvests = scenario.mission.kind == "harvesting"
        self._city, self._places = city_of(scenario), places(scenario)

    def reset(self, info):
        """Forget the last episode."""
        self._planner.reset(info)
        self._belief: Any = (DeviceBelief if self._harvests else TargetBelief)(self._scenario)
        self._target = np.zeros(self._scenario.shape, dtype=np.float32)

    def act(self, observation, info):
        """Return the next action of the best flight found for what is known and estimated."""
        here = self._places[static(observation["global"])]
        believed = Believed(0, self._city, here, int(observation["budget"][0]), self._target)
        (self._believe_devices if self._harvests else self._believe_targets)(believed, observation)
        return self._planner.act_team([observation], [{**info, "state": believed}])[0]

    def _believe_devices(self, believed, observation):
        """Set the believed devices; the planner improves its flight for their data at every step."""
        changed = self._belief.learn(believed.position, observation)
        believed.device_cell, believed.device_data = self._belief.devices()
        if changed:
            self._planner.revise(believed)

    def _believe_targets(self, believed, observation):
        """Set the believed target map; if it has changed in cells that were not known before, improve the flight."""
        belief, before = self._belief, self._target
        unknown = ~belief.known
        if belief.learn(believed.position, observation):
            self._guess = belief.likely > 0.5
        believed.target = self._target = np.where(belief.known, belief.now, self._guess).astype(np.float32)
        if (self._target != before)[unknown].any():
            self._planner.revise(believed)
