"""Greedy: fly to what pays most for the way, as long as the way home fits the budget; then fly home and land.

CPP: the cell from which the camera newly covers most per move that it takes to get there.
DH: the device with most data left per action that it takes to get there and hover, hovered over until it is empty.
"""

import numpy as np

from uavbench.city import HOVER, LAND, OFFSETS
from uavbench.missions.coverage import camera_gain

MOVES = [tuple(offset) for offset in OFFSETS[:4].tolist()]  # north, east, south, west


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
            return LAND if home[state.position] == 0 else self._step(state.position, self._nearer(home, state.position))
        goal = divmod(int(np.argmax(value)), value.shape[1])
        if goal == state.position:
            return HOVER
        while away[goal] > 1:
            goal = self._nearer(away, goal)
        return self._step(state.position, goal)

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
    def _nearer(distance, cell):
        """Return a neighbour of ``cell`` at one move less of ``distance``."""
        for down, right in MOVES:
            r, c = cell[0] + down, cell[1] + right
            inside = 0 <= r < distance.shape[0] and 0 <= c < distance.shape[1]
            if inside and distance[r, c] == distance[cell] - 1:
                return r, c
        raise AssertionError("distances go down by one at every move")

    @staticmethod
    def _step(cell, neighbour):
        """Return the move from ``cell`` to ``neighbour``."""
        return MOVES.index((neighbour[0] - cell[0], neighbour[1] - cell[1]))
