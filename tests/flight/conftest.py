"""A mission of each kind for the tests of this folder."""

import pytest
from flights import SCENARIOS, mission_of

from uavbench.flight.mission import Settings


@pytest.fixture(params=SCENARIOS)
def mission(request):
    """A mission, with settings that are no defaults."""
    return mission_of(request.param, 1, settings=Settings(4.0, 25.0, 2.0))
