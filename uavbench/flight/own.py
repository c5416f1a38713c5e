"""One flight of a person's own: no benchmark and no split, but a start, a budget and targets that are given."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import AgentError, Job, evaluate
from uavbench.flight.ground import Ground
from uavbench.flight.own_targets import read_area, read_devices
from uavbench.flight.route import Cell, Flight, FlightError, flight_along
from uavbench.flight.zones import centres_of
from uavbench.world.city import City, city_of
from uavbench.world.scenario import Scenario

_MOST_BUDGET = 100_000
_MOST_TURN_COST = 100.0


@dataclass(frozen=True)
class Own:
    """A flight that was planned.

    Attributes
    ----------
    flight : Flight
    actions : ndarray of uint8, shape (T, 1)
        What the UAV does.
    options : dict
        What was given, as in `uavbench.simulation.simulator.Simulator.customise`.
    """

    flight: Flight
    actions: NDArray[np.uint8]
    options: dict[str, Any]


def plan_own(
    scenario: Scenario,
    targets: Path,
    ground: Ground,
    *,
    agent: str = "planner",
    start: tuple[float, float] | None = None,
    budget: int | None = None,
    turn_cost: float | None = None,
) -> Own:
    """Plan one flight.

    Parameters
    ----------
    scenario : Scenario
        Where it takes place; of one UAV, with one map.
    targets : Path
        What is to be covered, ``.geojson``, or to be collected, ``.csv``.
    ground : Ground
    agent : str
        Who plans: a built-in agent, or a file as for ``uavbench evaluate``.
    start : (float, float), optional
        Latitude and longitude in a landing zone; by default the middle of the landing zone that is nearest to the targets.
    budget : int, optional
        Moves; by default the largest budget of the scenario.
    turn_cost : float, optional
        How many moves a turn by 90° counts as; by default what the agent takes.

    Raises
    ------
    FlightError
        When something that is given does not fit the scenario, or the agent fails.
    """
    if scenario.team or scenario.cities is not None:
        raise FlightError(f"{scenario.id}: one flight is planned for one UAV on one map; this scenario has more")
    city = city_of(scenario)
    option = _option(scenario, targets, ground, city)
    places = np.argwhere(option["targets"]) if "targets" in option else np.array(option["devices"])[:, :2]
    moves = scenario.budget[1] if budget is None else budget
    if not 1 <= moves <= _MOST_BUDGET:
        raise FlightError(f"--budget {moves}: it must be from 1 to {_MOST_BUDGET}")
    if turn_cost is not None and not 0.0 <= turn_cost <= _MOST_TURN_COST:
        raise FlightError(f"--turn-cost {turn_cost:g}: it must be from 0 to {_MOST_TURN_COST:g} moves")
    own = _widened(scenario, moves, option)
    given = {**option, "start": _start(start, ground, city, places), "budget": moves, "noise": False}
    try:
        settings = None if turn_cost is None else {"turn_cost": turn_cost}
        job = Job(find_agent(agent), own, "train", None, options=given, settings=settings)
        (record,) = evaluate(job, [0])
    except AgentError as error:
        raise FlightError(f"--agent {agent}: {error}") from None
    except ValueError as error:
        raise FlightError(str(error)) from None
    return Own(flight_along(own, "train", 0, record.actions, agent, given), record.actions, given)


def _option(scenario: Scenario, targets: Path, ground: Ground, city: City) -> dict[str, Any]:
    """Return the mission's option of ``reset``."""
    wanted = "devices" if scenario.mission.words.mark else "targets"
    ending = {"devices": (".csv",), "targets": (".geojson", ".json")}[wanted]
    if targets.suffix.lower() not in ending:
        raise FlightError(f"--targets {targets}: {scenario.id} needs {wanted}, in a file that ends in {' or '.join(ending)}")
    if wanted == "devices":
        return {"devices": read_devices(targets, ground, city)}
    return {"targets": read_area(targets, ground, city)}


def _widened(scenario: Scenario, moves: int, option: Mapping[str, Any]) -> Scenario:
    """Return the scenario with this budget, and in DH with room for these devices."""
    mission = scenario.mission
    if "devices" in option:
        amounts = [data for _, _, data in option["devices"]]
        number, low, high = len(amounts), min(amounts), max(amounts)
        mission = mission.model_copy(update={"devices": (number, number), "data": (low, high)})
    return scenario.model_copy(update={"budget": (moves, moves), "mission": mission})


def _start(start: tuple[float, float] | None, ground: Ground, city: City, places: Any) -> Cell:
    """Return the cell in which the flight begins."""
    if start is None:
        middle = np.mean(places, axis=0)
        return min(centres_of(np.asarray(city.landing)), key=lambda cell: float(np.abs(np.array(cell) - middle).sum()))
    cell = ground.cell_at(*start)
    rows, cols = city.shape
    if not (0 <= cell[0] < rows and 0 <= cell[1] < cols):
        raise FlightError(f"--start {start[0]:g},{start[1]:g}: it is not on the map, {ground.bounds_text()}")
    if not city.landing[cell]:
        raise FlightError(f"--start {start[0]:g},{start[1]:g}: it is in the cell {cell}, which is in no landing zone")
    return cell
