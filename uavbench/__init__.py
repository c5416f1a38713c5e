"""uavbench: a benchmark suite for UAV path planning on grid cities.

Importing it registers its scenarios with Gymnasium, so that ``gymnasium.make("uavbench:uavbench/Manhattan32-CPP-v0")`` works,
and those for teams with PettingZoo, where the installed version has a registry.
"""

from pathlib import Path as _Path
from typing import TYPE_CHECKING
from typing import Any as _Any
from typing import cast as _cast

import gymnasium as _gymnasium
import pettingzoo as _pettingzoo  # pyright: ignore[reportMissingTypeStubs]

from uavbench import moved as _moved
from uavbench.errors import UavbenchError
from uavbench.world.resources import scenario_paths as _scenario_paths
from uavbench.world.scenario import Scenario, ScenarioError, load_scenario

if TYPE_CHECKING:
    from pettingzoo.utils.env import AECEnv as _AECEnv  # pyright: ignore[reportMissingTypeStubs]

    from uavbench.envs.parallel_env import UAVParallelEnv as _UAVParallelEnv

__version__ = "0.1.0"
__all__ = [
    "Scenario",
    "ScenarioError",
    "UavbenchError",
    "__version__",
    "aec_env",
    "load_scenario",
    "parallel_env",
    "scenario_ids",
]


def scenario_ids() -> list[str]:
    """Return the ids of the shipped scenarios."""
    return list(_scenario_paths())


def parallel_env(scenario: str | _Path | Scenario, **kwargs: _Any) -> "_UAVParallelEnv":
    """Return the PettingZoo ``ParallelEnv`` of a scenario: see `uavbench.envs.parallel_env.UAVParallelEnv`.

    Parameters
    ----------
    scenario : str, Path or Scenario
        An id, ``"Manhattan32-DH-Team-v0"``, the path of a TOML file, or a loaded scenario.
    **kwargs
        ``num_uavs``, ``local_size``, ``global_scale``, ``flat``, ``split``, ``order``, ``success_cr``, ``render_mode``.
    """
    from uavbench.envs.parallel_env import UAVParallelEnv

    return UAVParallelEnv(scenario, **kwargs)


def aec_env(scenario: str | _Path | Scenario, **kwargs: _Any) -> "_AECEnv[str, _Any, _Any]":
    """Return the PettingZoo ``AECEnv`` of a scenario, converted from `parallel_env`; the arguments are the same."""
    from uavbench.envs.parallel_env import aec_env as make

    return make(scenario, **kwargs)


_moved.install()

for _id in scenario_ids():
    _for_team = "-Team-" in _id
    _cast("_Any", _gymnasium).register(  # those of teams only to say how they are made
        id=f"uavbench/{_id}",
        entry_point="uavbench.envs.core:refuse_team" if _for_team else "uavbench.envs.env:UAVEnv",
        vector_entry_point="uavbench.envs.core:refuse_team" if _for_team else "uavbench.envs.vector_env:UAVVectorEnv",
        kwargs={"scenario": _id},
    )
    if _for_team and hasattr(_pettingzoo, "register"):  # since PettingZoo 1.27
        for _type, _maker in (("parallel", "UAVParallelEnv"), ("aec", "aec_env")):
            _cast("_Any", _pettingzoo).register(
                _type, f"uavbench/{_id}", f"uavbench.envs.parallel_env:{_maker}", kwargs={"scenario": _id}
            )
