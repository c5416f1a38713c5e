"""Upper bounds of many test episodes of a scenario."""

from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.bounds.coverage import coverage_bound
from uavbench.bounds.harvesting import harvesting_bound
from uavbench.evaluation.cluster import Cluster, work_on
from uavbench.evaluation.crew import Crew
from uavbench.evaluation.metrics import tolerance
from uavbench.evaluation.parcel import ScenarioParcel, pack_scenario, unpack_scenario
from uavbench.evaluation.processes import work_apart
from uavbench.evaluation.reference import SPLIT, Known, Reference
from uavbench.evaluation.replay import fly_recorded
from uavbench.evaluation.results import Result
from uavbench.planning import coverage
from uavbench.simulation.simulator import Simulator
from uavbench.world.scenario import Scenario, ScenarioError

_PLAN_CHANGES = 100_000  # that the search for a plan tries, if no result has a flight that lands

Cell = tuple[int, int]


class EpisodeBound(NamedTuple):
    """The upper bound of the CRAL of one test episode, in [0, 1], and what gave it."""

    episode: int
    value: float
    method: str


def check_boundable(scenario: Scenario) -> None:
    """Raise a ScenarioError if bounds cannot be computed for a scenario."""
    if scenario.team:
        raise ScenarioError(f"{scenario.id}: uavs: bounds are for scenarios of one UAV")
    if scenario.mission.kind not in ("coverage", "harvesting"):
        raise ScenarioError(f"{scenario.id}: mission.kind: bounds are for coverage and harvesting, not {scenario.mission.kind}")


def bound_episodes(
    scenario: Scenario, numbers: Sequence[int], known: Reference, results: Iterable[Result], seconds: float, workers: Crew = 1
) -> Generator[EpisodeBound]:
    """Compute upper bounds of test episodes, and yield each when it is ready.

    Parameters
    ----------
    scenario : Scenario
        A scenario for one UAV.
    numbers : sequence of int
        The numbers of the episodes.
    known : Reference
        What is known so far. In DH, no lower bound than all data is sought for episodes in which all data have been collected.
    results : iterable of Result
        In CPP, the best flight of an episode in these results is the plan for its bound; without one, a quick search makes it.
    seconds : float
        Processor time that each bound may take.
    workers : int or Cluster
        The number of processes, or a cluster.
    """
    flights = _best_flights(results) if scenario.mission.kind == "coverage" else {}
    tasks = [(number, known.get(number, Known(number)).best_known, flights.get(number)) for number in numbers]
    bounder = _Bounder(scenario, seconds)
    if isinstance(workers, Cluster):
        yield from work_on(workers, _bound_there, (pack_scenario(scenario), seconds), lambda _: tasks)
    elif workers == 1:
        for task in tasks:
            yield from bounder(task)
    else:
        yield from work_apart(bounder, tasks, workers)


_Task = tuple[int, float, NDArray[np.uint8] | None]


def _bound_there(sent: tuple[ScenarioParcel, float], task: _Task) -> Iterator[EpisodeBound]:
    """Yield the bound of an episode on the machine where this is called."""
    return _Bounder(unpack_scenario(sent[0]), sent[1])(task)


@dataclass(frozen=True)
class _Bounder:
    """Computes the bound of an episode, in this process or in a worker."""

    scenario: Scenario
    seconds: float

    def __call__(self, task: _Task, _shown: Any = None) -> Iterator[EpisodeBound]:
        """Yield the bound of an episode, given its number, the best known CRAL and the actions of a flight."""
        yield _bound(self.scenario, *task, seconds=self.seconds)


def _best_flights(results: Iterable[Result]) -> dict[int, NDArray[np.uint8]]:
    """Return for every episode the actions of the best flight in all results, among those that land."""
    best: dict[int, tuple[float, NDArray[np.uint8]]] = {}
    for result in results:
        actions, table = result.actions(), result.episodes()
        for number, cral, landed in zip(
            table["episode"].tolist(), table["cral"].tolist(), table["landed"].tolist(), strict=True
        ):
            if landed and cral > best.get(number, (-1.0,))[0]:
                best[number] = (cral, actions[number])
    return {number: actions for number, (_, actions) in best.items()}


def _bound(scenario: Scenario, number: int, best: float, actions: NDArray[np.uint8] | None, seconds: float) -> EpisodeBound:
    """Return the bound of one episode."""
    simulator = Simulator(scenario, 1)
    simulator.reset([0], SPLIT, [number])
    state = simulator.state
    start, budget, city = _cell(state.position), int(state.budget[0, 0]), simulator.city_at(0)
    if scenario.mission.kind == "harvesting":
        view = simulator.mission.view(0)
        cells, data = view["device_cell"], view["device_data"]
        planned = float(data.sum()) if best >= 1.0 - tolerance(scenario) else 0.0
        collected = harvesting_bound(scenario, start, budget, cells, data, planned, seconds=seconds, city=city)
        return EpisodeBound(number, collected.cr, collected.method)
    plan: list[Cell] = []
    if actions is None:
        found = coverage.search(scenario, state.target[0], [start], [budget], seed=number, moves=_PLAN_CHANGES, city=city)
        plan = found.flights[0]
    else:
        fly_recorded(scenario, SPLIT, number, actions, lambda simulator: plan.append(_cell(simulator.state.position)))
        plan.pop()  # the last action landed, in the same cell
    covered = coverage_bound(scenario, start, budget, state.target[0], plan, seconds, city)
    return EpisodeBound(number, covered.cr, covered.method)


def _cell(position: NDArray[np.int32]) -> Cell:
    """Return the cell of the only UAV in the only slot."""
    r, c = position[0, 0].tolist()
    return r, c
