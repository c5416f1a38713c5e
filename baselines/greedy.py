"""Greedy: fly to the goal that pays most per move, as long as the budget suffices to land after it; then land.

CPP: the goal is the cell from which the camera newly covers most targets per move that it takes to get there.
DH: the goal is the place to hover for the device with most data left per move that it takes to get there.
A goal in the UAV's own cell costs one hover. Goals are chosen again at every step.

In a team, the best pair of UAV and goal is chosen first. The targets or devices of that goal are then no goals for the others.
"""

import numpy as np

from uavbench.simulation.missions.coverage import camera_gain, camera_views
from uavbench.world.city import HOVER, LAND, action_between, neighbour


class Agent:
    """Chooses goals again at every decision."""

    track = "state"

    def __init__(self, scenario):
        coverage = scenario.mission.kind == "coverage"
        self._gains = self._coverage_gains if coverage else self._harvesting_gains
        self._take = self._cover if coverage else self._empty

    def act_team(self, observations, infos):
        """Return the first action of each UAV on the way to its goal, or to a landing zone if it has no goal."""
        states = [info["state"] for info in infos]
        goals = self._goals(states)
        held = [state.position for state in states]
        actions = []
        for k, state in enumerate(states):  # UAVs act in order: those before this one have already moved
            others = [cell for w, cell in enumerate(held) if w != k]
            action = self._towards(state, goals[k], others) if k in goals else self._homeward(state, others)
            actions.append(action)
            if action < HOVER:
                held[k] = neighbour(state.position, action)
        return actions

    def _goals(self, states):
        """Return the UAVs' goals by index in ``states``; a UAV has none if no goal pays and leaves enough budget to land."""
        city, targets = states[0].city, states[0].target.copy()
        goals, waiting = {}, list(range(len(states)))
        slack = 2 * (len(states) - 1)  # kept in reserve, because UAVs may be in each other's way
        away = [city.distances(state.position) for state in states]
        actions = [np.maximum(distance, 1) for distance in away]  # a goal in the UAV's cell costs a hover
        fits = [
            (distance >= 0)
            & (city.distance_to_landing >= 0)
            & (spent + city.distance_to_landing + 1 + slack <= state.budget)  # + 1 to land
            for distance, spent, state in zip(away, actions, states, strict=True)
        ]
        while waiting:
            gains = self._gains(states[0], targets)
            values = {k: np.where(fits[k], gains / actions[k], 0.0) for k in waiting}
            best = max(waiting, key=lambda k, values=values: values[k].max())
            if not values[best].any():
                break
            goals[best] = divmod(int(np.argmax(values[best])), targets.shape[1])
            self._take(states[0], targets, goals[best])
            waiting.remove(best)
        return goals

    @staticmethod
    def _coverage_gains(state, targets):
        """Return how many targets the camera would cover from each cell."""
        return camera_gain(state.scenario, targets, state.city)

    @staticmethod
    def _cover(state, targets, goal):
        """Remove the targets that the camera sees from ``goal``."""
        view = int(camera_views(state.scenario, state.city)[goal])
        size = state.scenario.mission.camera_size
        for bit in range(size * size):
            if view >> bit & 1:
                targets[goal[0] + bit // size - size // 2, goal[1] + bit % size - size // 2] = 0

    def _harvesting_gains(self, state, targets):
        """Return, for each cell, the most data left at a device for which it is the place to hover; 0 for other cells."""
        gains = np.zeros(targets.shape)
        for cell in np.argwhere(targets).tolist():
            place = self._place(state.city, *cell)
            gains[place] = max(gains[place], targets[tuple(cell)])
        return gains

    def _empty(self, state, targets, goal):
        """Remove the devices for which ``goal`` is the place to hover."""
        for cell in np.argwhere(targets).tolist():
            if self._place(state.city, *cell) == goal:
                targets[tuple(cell)] = 0

    @staticmethod
    def _place(city, r, c):
        """Return where to hover for the device at (r, c): its cell, or the nearest one that the UAV can fly to."""
        if city.distance_to_landing[r, c] >= 0:
            return r, c
        rows, cols = np.indices(city.shape)
        distance = np.where(city.distance_to_landing >= 0, np.hypot(rows - r, cols - c), np.inf)
        return divmod(int(np.argmin(distance)), distance.shape[1])

    def _homeward(self, state, others):
        """Return the next action on a way to a landing zone that avoids the others; there, ``land``."""
        home, cell = state.city.distance_to_landing, state.position
        if home[cell] == 0:
            return LAND
        action = state.city.step_towards(home, cell)
        if neighbour(cell, action) not in others:
            return action
        away = state.city.distances(cell, avoid=others)
        free = np.where(state.city.landing & (away >= 0), away, away.size)
        return self._towards(state, divmod(int(np.argmin(free)), free.shape[1]), others)

    def _towards(self, state, goal, others):
        """Return the next action on a shortest path to ``goal`` that avoids the others; hover there, or if none exists."""
        away = state.city.distances(state.position, avoid=others)
        if away[goal] <= 0:
            return HOVER
        while away[goal] > 1:
            goal = neighbour(goal, state.city.step_towards(away, goal))
        return action_between(state.position, goal)
