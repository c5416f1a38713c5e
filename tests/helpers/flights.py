"""Recorded flights and missions for the tests of ``uavbench.flight``."""

from functools import cache

import pytest

from uavbench import evaluate
from uavbench.evaluation.results import Result
from uavbench.flight.ground import Ground
from uavbench.flight.mission import Mission, Settings
from uavbench.flight.route import Flight, recorded_flight

for name in ("pyproj", "shapely"):
    pytest.importorskip(name, reason=f"missions need {name}: pip install 'uavbench[cities]'")

#: A place for maps that have none: in the middle of Munich.
ORIGIN = (48.137, 11.575)
SCENARIOS = ("Block8-CPP-v0", "Block8-DH-v0", "Helsinki32-CPP-v0", "Helsinki32-DH-v0", "Manhattan32-CPP-Team-v0")


@cache
def result_of(scenario: str, agent: str = "greedy", episodes: int = 4) -> Result:
    """Return a result that stays in memory."""
    return evaluate(agent, scenario, episodes=episodes)


def flight_of(scenario: str, episode: int = 0, agent: str = "greedy") -> Flight:
    return recorded_flight(result_of(scenario, agent), episode)


def mission_of(scenario: str, episode: int = 0, uav: int = 0, settings: Settings | None = None) -> Mission:
    flight = flight_of(scenario, episode)
    origin = None if flight.scenario.provenance else ORIGIN
    return Mission(flight, uav, Ground(flight.scenario, origin), settings or Settings())
