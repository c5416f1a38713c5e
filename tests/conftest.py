"""Shared by all tests."""

import os
import signal

import pytest
from hypothesis import HealthCheck, settings

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.run import run

# The first example of a test may compile kernels. In CI the examples are the same each time; newer versions of Hypothesis
# would choose that by themselves, but the lowest declared one keeps its deadline there.
settings.register_profile(
    "uavbench", deadline=None, derandomize="CI" in os.environ, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("uavbench")
os.environ["SDL_VIDEODRIVER"] = "dummy"  # windows open nowhere


@pytest.fixture(autouse=True)
def signals_stay():
    """Handle signals after each test as before it: a command that is interrupted leaves a process that should end."""
    before = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}
    yield
    for each, handler in before.items():
        if signal.getsignal(each) is not handler:
            signal.signal(each, handler)


@pytest.fixture(scope="session")
def pictured(tmp_path_factory):
    """Results of greedy and random on a few scenarios, by agent and scenario."""
    out = tmp_path_factory.mktemp("results")
    names = ("Block8-CPP-v0", "Block8-DH-v0", "Manhattan32-DH-Team-v0")
    return {
        (agent, name): run(Job(find_agent(agent), load_scenario(name), "test"), 20 if "Team" in name else 60, out)
        for agent in ("greedy", "random")
        for name in names
    }
