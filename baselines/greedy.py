"""Greedy: fly to what pays most for the way, as long as the way home fits the budget; then fly home and land.

CPP: the cell from which the camera newly covers most per move that it takes to get there.
DH: the device with most data left per action that it takes to get there and hover, hovered over until it is empty.
"""

import numpy as np

from uavbench.city import HOVER, LAND, OFFSETS
from uavbench.missions.coverage import camera_gain


class Agent:
    """Chooses a goal anew at every decision."""

    track = "state"

    def __init__(self, scenario):
        self._gains = self._coverage_gains if scenario.mission.kind == "coverage" else self._harvesting_gains

    def act(self, observation, info):
        """Return the first action of the way to the best goal; without one, of the way home."""
        state = info["state"]
        away, home = state.city.distances(state.position), state.city.home
        actions = np.maximum(away, 1)  # a goal right here costs a hover
        fits = (away >= 0) & (home >= 0) & (actions + home + 1 <= state.budget)  # + 1 to land
        value = np.where(fits, self._gains(state) / actions, 0.0)
        if not value.any():
            return self._follow(state, home, LAND)
        goal = np.unravel_index(np.argmax(value), value.shape)
        return self._follow(state, state.city.distances(goal), HOVER)

    def _coverage_gains(self, state):
        """Return how many targets the camera would cover from each cell."""
        return camera_gain(state.scenario, state.target)

    def _harvesting_gains(self, state):
        """Return the data left at the device that each cell is the best place for."""
        gains = np.zeros(state.city.shape)
        for cell, data in zip(state.device_cell.tolist(), state.device_data.tolist(), strict=True):
            place = self._place(state.city, *cell)
            gains[place] = max(gains[place], data)
        return gains

    @staticmethod
    def _place(city, r, c):
        """Return where to hover for the device at (r, c): over it, or as close as one may fly."""
        if city.home[r, c] >= 0:
            return r, c
        rows, cols = np.indices(city.shape)
        distance = np.where(city.home >= 0, np.hypot(rows - r, cols - c), np.inf)
        return np.unravel_index(np.argmin(distance), distance.shape)

    @staticmethod
    def _follow(state, way, arrived):
        """Return the first action of a shortest way down the distances ``way``, or ``arrived`` at its end."""
        r, c = state.position
        if way[r, c] == 0:
            return arrived
        for action, (down, right) in enumerate(OFFSETS[:4]):
            y, x = r + down, c + right
            if 0 <= y < way.shape[0] and 0 <= x < way.shape[1] and way[y, x] == way[r, c] - 1:
                return action
        raise AssertionError("a shortest way goes down by one at every move")
