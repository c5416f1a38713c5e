"""The routes of a recorded flight: where each UAV turns, waits and ends, and what it covers or collects."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.errors import UavbenchError
from uavbench.evaluation.replay import flown_in, fly_recorded
from uavbench.evaluation.results import Result
from uavbench.simulation.simulator import Simulator
from uavbench.world.city import City
from uavbench.world.scenario import Scenario, SplitName

Cell = tuple[int, int]


class FlightError(UavbenchError, ValueError):
    """A flight cannot leave the grid; the message names what is wrong, and what to change."""


@dataclass(frozen=True)
class Stop:
    """A cell in which a UAV begins, turns, waits or ends.

    Attributes
    ----------
    cell : (int, int)
    wait : int
        How many steps the UAV stays there: it hovers, is blocked, or tries to land where it cannot.
    """

    cell: Cell
    wait: int


@dataclass(frozen=True)
class Route:
    """The way of one UAV.

    Attributes
    ----------
    stops : tuple of Stop
        From the start to the end; the way from one to the next is straight.
    moves : int
        How many cells the UAV flies.
    landed : bool
        Whether it lands at the end; otherwise it crashes there.
    """

    stops: tuple[Stop, ...]
    moves: int
    landed: bool


@dataclass(frozen=True)
class Flight:
    """A recorded episode.

    Attributes
    ----------
    scenario : Scenario
    agent : str
        Who flew it.
    split : {"train", "validation", "test"}
    episode : int
    city : City
    routes : tuple of Route
        One for each UAV.
    target : ndarray of float32, shape (M, N)
        The target map at the start.
    left : ndarray of float32, shape (M, N)
        The target map at the end.
    cr : float
        In [0, 1].
    """

    scenario: Scenario
    agent: str
    split: SplitName
    episode: int
    city: City
    routes: tuple[Route, ...]
    target: NDArray[np.float32]
    left: NDArray[np.float32]
    cr: float

    @property
    def landed(self) -> bool:
        """Whether every UAV landed."""
        return all(route.landed for route in self.routes)


class _Watch:
    """Notes the cells of each UAV while an episode is simulated again."""

    def __init__(self) -> None:
        self.cells: list[list[Cell]] = []
        self.landed: list[bool] = []
        self.target = self.left = np.zeros((0, 0), dtype=np.float32)
        self.city: City | None = None
        self._flew: list[bool] = []
        self._cr = 0.0

    def __call__(self, simulator: Simulator) -> None:
        state = simulator.state
        uavs = int(state.uavs[0])
        if not self.cells:
            self.cells, self._flew = [[] for _ in range(uavs)], [True] * uavs
            self.target, self.city = state.target[0].copy(), simulator.city_at(0)
        for u in range(uavs):
            if self._flew[u]:
                row, col = state.position[0, u].tolist()
                self.cells[u].append((row, col))
        self._flew = [not done for done in state.done[0, :uavs].tolist()]
        self.left, self.landed = state.target[0].copy(), state.landed[0, :uavs].tolist()
        self._cr = float(simulator.outcome(0)["cr"])

    def flight(self, scenario: Scenario, agent: str, split: SplitName, number: int) -> Flight:
        """Return what was watched."""
        assert self.city is not None
        routes = tuple(route_of(cells, landed) for cells, landed in zip(self.cells, self.landed, strict=True))
        return Flight(scenario, agent, split, number, self.city, routes, self.target, self.left, self._cr)


def recorded_flight(result: Result, number: int, scenario_file: str | None = None) -> Flight:
    """Return a recorded episode of a result, after simulating it again.

    Raises
    ------
    FlightError
        When the result does not have this episode, or its actions are not those of a whole episode.
    ResultError
        When the scenario has another digest than that of the result, or a file is damaged.
    """
    scenario, split = flown_in(result, scenario_file)
    actions = result.actions()
    if number not in actions:
        raise FlightError(f"--episode {number}: {result.folder} holds the episodes 0 to {len(actions) - 1}")
    watch = _Watch()
    if fly_recorded(scenario, split, number, actions[number], watch) is None:
        raise FlightError(f"{result.folder}: episode {number}: actions.npz does not hold the actions of a whole episode")
    return watch.flight(scenario, result.summary["agent"], split, number)


def flight_along(
    scenario: Scenario, split: SplitName, number: int, actions: NDArray[np.uint8], agent: str, options: Mapping[str, Any]
) -> Flight:
    """Return the flight of an episode of which something was set by hand.

    Parameters
    ----------
    scenario, split, number
        The episode.
    actions : ndarray of uint8, shape (T, 1)
        What the UAV did.
    agent : str
        Who flew it.
    options : mapping
        As in `Simulator.customise`.
    """
    simulator, watch = Simulator(scenario, 1), _Watch()
    simulator.reset([0], split, [number])
    simulator.customise(0, options)
    watch(simulator)
    for row in actions:
        simulator.step(row)
        watch(simulator)
    return watch.flight(scenario, agent, split, number)


def route_of(cells: list[Cell], landed: bool) -> Route:
    """Return the route along cells, one for each step; whoever landed spent the last step with it, in the same cell."""
    way = cells[:-1] if landed else cells
    stops: list[Stop] = []
    for k, cell in enumerate(way):
        if k and cell == way[k - 1]:
            stops[-1] = Stop(cell, stops[-1].wait + 1)
        elif len(stops) > 1 and not stops[-1].wait and _straight(stops[-2].cell, stops[-1].cell, cell):
            stops[-1] = Stop(cell, 0)
        else:
            stops.append(Stop(cell, 0))
    return Route(tuple(stops), sum(one != other for one, other in itertools.pairwise(way)), landed)


def _straight(first: Cell, second: Cell, third: Cell) -> bool:
    """Say whether three cells lie on a straight way in this order."""
    (a, b), (c, d), (e, f) = first, second, third
    return (c - a) * (f - d) == (d - b) * (e - c) and (c - a) * (e - c) + (d - b) * (f - d) > 0
