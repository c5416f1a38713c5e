"""uavbench: a benchmark suite for UAV path planning on grid cities.

Importing it registers its scenarios with Gymnasium, so that
``gymnasium.make("uavbench:uavbench/Manhattan32-CPP-v0")`` works.
"""

from typing import Any as _Any
from typing import cast as _cast

import gymnasium as _gymnasium

from uavbench.resources import scenario_paths as _scenario_paths
from uavbench.scenario import Scenario, ScenarioError, load_scenario

__version__ = "0.1.0"
__all__ = ["Scenario", "ScenarioError", "__version__", "load_scenario", "scenario_ids"]


def scenario_ids() -> list[str]:
    """Return the ids of the shipped scenarios."""
    return list(_scenario_paths())


for _id in scenario_ids():
    _cast("_Any", _gymnasium).register(
        id=f"uavbench/{_id}",
        entry_point="uavbench.envs.env:UAVEnv",
        vector_entry_point="uavbench.envs.vector_env:UAVVectorEnv",
        kwargs={"scenario": _id},
    )
