"""Planner: whole flights by simulated annealing, for one UAV or a team; the strongest built-in agent.

CPP: it plans once, by several searches, of which it improves the best, and then flies the plan. DH: it plans with expected
rates, and improves the rest of the flights at every step, for the data that are really left. It stops searching when a plan
gets everything. The settings of the searches are attributes of the agent.

On a large map, one search starts from a tour of the places that pay most; in DH, it improves the next part of the flights
every few steps.
"""

import math

from uavbench.planning import coverage, harvesting
from uavbench.planning.distances import is_large
from uavbench.planning.turns import turns_at
from uavbench.world.city import HOVER, LAND, action_between, neighbour


class Agent:
    """Follows the best flights that it finds."""

    track = "state"

    mending_changes = 2_000  # tried at every step in DH
    mending_heat = 0.3  # initial temperature in data units: low enough to improve a flight instead of replacing it
    refining_heat = 0.7  # initial temperature in target cells when the best plans are improved
    turn_cost = 0.0  # moves that a turn by 90° counts as

    def __init__(self, scenario):
        self._scenario = scenario
        self._harvests = scenario.mission.kind == "harvesting"
        # The number of searches at the start, the changes that each tries for each action of the UAVs' budgets, and how many of
        # the best plans are improved, with twice as many changes.
        self.searches, self.changes, self.refined = (24, 140, 0) if self._harvests else (8, 250, 2)
        self.mending_interval, self.mending_horizon = 1, None  # steps from one mending to the next; cells that it may change
        self._large = is_large(scenario.shape)
        if self._large:
            self.searches, self.changes, self.refined = 1, 300 if self._harvests else 1_500, 0
            self.tour_changes, self.heat = 20_000_000, 0.5
            self.mending_interval, self.mending_horizon = 4, 100

    def reset(self, info):
        """Begin an episode."""
        self._seed = info["seed"] & 0xFFFFFFFF
        self._flights = {}
        self._steps = 0
        self._before = {}  # the cell of each UAV before its last move
        self._turned = {}  # moves that its turns count as

    def act_team(self, observations, infos):
        """Return the next action of each UAV's flight."""
        states = [info["state"] for info in infos]
        if not self._flights:
            self._plan(states)
        elif self._harvests and self._steps % self.mending_interval == 0:
            self._mend(states)
        self._steps += 1
        held = [state.position for state in states]
        actions = []
        for k, state in enumerate(states):  # UAVs act in order: those before this one have already moved
            others = [cell for w, cell in enumerate(held) if w != k]
            self._flights[state.uav] = flight = self._around(state, self._flights[state.uav], others)
            if len(flight) == 1:
                actions.append(LAND if state.city.landing[state.position] else HOVER)
                continue
            here, there = flight[:2]
            self._note_turn(state, there)
            actions.append(action_between(here, there))
            held[k] = there
            self._flights[state.uav] = flight[1:]
        return actions

    def _plan(self, states):
        """Search several times for flights of the whole team, improve the best, and keep the best of all."""
        if self._harvests:
            self._rates = harvesting.rates_for(self._scenario, states[0].device_cell, states[0].city)
        start = {"first": self._tours(states), "hot": self.heat} if self._large else {}
        changes = self.changes * sum(state.budget for state in states)
        plans = self._searched(states, [], [start] * self.searches, changes)
        best = sorted(plans, key=_value, reverse=True)[: self.refined]
        starts = [{"first": plan.flights, "hot": self.refining_heat} for plan in best]
        best = max(self._searched(states, plans, starts, 2 * changes), key=_value)
        self._flights = {state.uav: flight for state, flight in zip(states, best.flights, strict=True)}

    def _searched(self, states, plans, starts, changes):
        """Return the plans and those that searches from other starts find, up to the first plan that gets everything."""
        plans = list(plans)
        for start in starts:
            if plans and self._is_everything(states, max(plans, key=_value)):
                break
            plans.append(self._search(states, self._seed + len(plans), changes, **start))
        return plans

    def _mend(self, states):
        """Search on from the current flights, for what is left now, unless in DH they already get everything."""
        first = [self._flights[state.uav] for state in states]
        if self._harvests and self._is_everything(states, self._search(states, self._seed, 0, first=first)):
            return
        more = {"horizon": self.mending_horizon} if self._harvests else {}
        plan = self._search(states, self._seed, self.mending_changes, first=first, hot=self.mending_heat, **more)
        self._flights = {state.uav: flight for state, flight in zip(states, plan.flights, strict=True)}

    def _is_everything(self, states, plan):
        """Return whether a plan gets everything that is left."""
        everything = states[0].device_data.sum() if self._harvests else (states[0].target > 0).sum()
        return plan.value > everything - 1e-6  # sums of data are rounded

    def _search(self, states, seed, changes, **more):
        """Search for flights; in a team, each UAV keeps some actions in reserve, because another may be in its way."""
        starts, budgets = self._problem(states, [len(flight) for flight in more.get("first", ())])
        more |= {"seed": seed, "moves": changes, "city": states[0].city, "turn_cost": self.turn_cost}
        if self._harvests:
            devices, data = states[0].device_cell, states[0].device_data
            return harvesting.search(self._scenario, self._rates, devices, data, starts, budgets, **more)
        return coverage.search(self._scenario, states[0].target, starts, budgets, **more)

    def _note_turn(self, state, there):
        """Add the turn that a UAV makes in its cell to those that its budget has paid for."""
        before, here = self._before.get(state.uav), state.position
        cols = state.city.shape[1]
        if before is not None:
            first, middle, last = (r * cols + c for r, c in (before, here, there))
            turns = turns_at(first, middle, last, cols)
            self._turned[state.uav] = self._turned.get(state.uav, 0.0) + self.turn_cost * turns
        self._before[state.uav] = here

    def _tours(self, states):
        """Return first flights for a large map."""
        starts, budgets = self._problem(states)
        city, more = states[0].city, {"seed": self._seed, "changes": self.tour_changes}
        if self._harvests:
            return harvesting.first_flights(states[0].device_data, states[0].device_cell, starts, budgets, city, **more)
        return coverage.first_flights(self._scenario, states[0].target, starts, budgets, city, **more)

    def _problem(self, states, needed=()):
        """Return the UAVs' cells, and the actions that their flights may take; at least what is needed."""
        slack = 2 * (len(states) - 1)
        needed = needed or [int(s.city.distance_to_landing[s.position]) + 1 for s in states]
        spent = [slack + math.ceil(self._turned.get(state.uav, 0.0)) for state in states]
        budgets = [max(s.budget - less, need) for s, less, need in zip(states, spent, needed, strict=True)]
        return [state.position for state in states], budgets

    @staticmethod
    def _around(state, flight, others):
        """Return the flight, or a flight that avoids or waits for the others if one of them is in its way."""
        here = state.position
        if flight[0] != here:  # a UAV should never leave its flight; if it does, it flies to the nearest landing cell
            flight = [here]
        elif len(flight) == 1 or flight[1] not in others:
            return flight
        away = state.city.distances(here, avoid=others)
        for k in range(2, len(flight)):
            if away[flight[k]] > 0 and away[flight[k]] + len(flight) - k <= state.budget:
                return _way(state.city, away, flight[k]) + flight[k + 1 :]
        if len(flight) > 1 and len(flight) < state.budget:
            return [here, *flight]  # wait
        homes = [cell for cell in map(tuple, state.city.landing_cells.tolist()) if 0 <= away[cell] < state.budget]
        return _way(state.city, away, min(homes, key=lambda cell: away[cell])) if homes else [here, *flight]


def _value(plan):
    """Return what the flights of a plan get."""
    return plan.value


def _way(city, away, goal):
    """Return the cells of a shortest path to ``goal`` from the cell where ``away`` is 0, both included."""
    way = [goal]
    while away[way[-1]] > 0:
        way.append(neighbour(way[-1], city.step_towards(away, way[-1])))
    return way[::-1]
