"""uavbench: a benchmark suite for UAV path planning on grid cities.

Importing it registers its scenarios with Gymnasium, so that ``gymnasium.make("uavbench:uavbench/Manhattan32-CPP-v0")`` works,
and those for teams with PettingZoo, where the installed version has a registry.

What is named here is the public interface; it is documented on one page, docs/reference.md, and loaded when it is first used.
Everything else is private and may change in any version.
"""

import importlib
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import gymnasium
import pettingzoo  # pyright: ignore[reportMissingTypeStubs]

from uavbench import moved
from uavbench.errors import UavbenchError
from uavbench.world.resources import scenario_paths
from uavbench.world.scenario import Scenario, ScenarioError, load_scenario

if TYPE_CHECKING:
    from pettingzoo.utils.env import AECEnv  # pyright: ignore[reportMissingTypeStubs]

    from uavbench.agents.agent import find_agent
    from uavbench.agents.protocols import Agent, Learner
    from uavbench.envs.env import UAVEnv
    from uavbench.envs.parallel_env import UAVParallelEnv
    from uavbench.envs.team_vector_env import UAVTeamVectorEnv
    from uavbench.envs.vector_env import UAVVectorEnv
    from uavbench.evaluation.front import compare, evaluate
    from uavbench.evaluation.replay import replay
    from uavbench.evaluation.results import Result, load_result
    from uavbench.pictures.plot import plot
    from uavbench.simulation.observation import Observer
    from uavbench.simulation.simulator import Simulator
    from uavbench.world.city import City

__version__ = "0.1.0"
__all__ = [
    "Agent",
    "City",
    "Learner",
    "Observer",
    "Result",
    "Scenario",
    "ScenarioError",
    "Simulator",
    "UavbenchError",
    "__version__",
    "aec_env",
    "compare",
    "evaluate",
    "find_agent",
    "list_scenarios",
    "load_result",
    "load_scenario",
    "make",
    "make_vec",
    "parallel_env",
    "parallel_vec",
    "plot",
    "replay",
]

# Where each name is that is imported when it is first used: Numba, pandas and Matplotlib take their time.
_LAZY = {
    "Agent": "agents.protocols",
    "City": "world.city",
    "Learner": "agents.protocols",
    "Observer": "simulation.observation",
    "Result": "evaluation.results",
    "Simulator": "simulation.simulator",
    "compare": "evaluation.front",
    "evaluate": "evaluation.front",
    "find_agent": "agents.agent",
    "load_result": "evaluation.results",
    "plot": "pictures.plot",
    "replay": "evaluation.replay",
}


def __getattr__(name: str) -> Any:
    if name == "scenario_ids":
        warnings.warn("scenario_ids is now list_scenarios; the old name works until version 0.3", DeprecationWarning, 2)
        return list_scenarios
    if name not in _LAZY:
        raise AttributeError(f"module 'uavbench' has no attribute {name!r}")
    found = getattr(importlib.import_module(f"uavbench.{_LAZY[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)


def list_scenarios() -> list[str]:
    """Return the ids of the shipped scenarios.

    Examples
    --------
    >>> import uavbench
    >>> "Manhattan32-CPP-v0" in uavbench.list_scenarios()
    True
    """
    return list(scenario_paths())


def make(scenario: str | Path | Scenario, **kwargs: Any) -> "UAVEnv":
    """Return the Gymnasium environment of a scenario for one UAV: see `uavbench.envs.env.UAVEnv`.

    It is what ``gymnasium.make("uavbench/…")`` returns, without wrappers, and takes scenarios of your own.

    Parameters
    ----------
    scenario : str, Path or Scenario
        An id, the path of a TOML file, or a loaded scenario.
    **kwargs
        As for `uavbench.envs.env.UAVEnv`.

    Raises
    ------
    ScenarioError, ValueError
        When there is no such scenario, it is for a team, or an argument does not fit.

    Examples
    --------
    >>> import uavbench
    >>> env = uavbench.make("Block8-CPP-v0", rewards={"crash": -50.0})
    >>> observation, info = env.reset(seed=0)
    >>> observation["budget"].shape
    (1,)
    """
    from uavbench.envs.env import UAVEnv

    return UAVEnv(scenario, **kwargs)


def make_vec(scenario: str | Path | Scenario, num_envs: int = 1, **kwargs: Any) -> "UAVVectorEnv":
    """Return the Gymnasium vector environment of a scenario: N environments in one simulator.

    Parameters
    ----------
    scenario : str, Path or Scenario
        An id, the path of a TOML file, or a loaded scenario.
    num_envs : int
        N.
    **kwargs
        As for `uavbench.envs.vector_env.UAVVectorEnv`.

    Raises
    ------
    ScenarioError, ValueError
        When there is no such scenario, it is for a team, or an argument does not fit.

    Examples
    --------
    >>> import uavbench
    >>> envs = uavbench.make_vec("Block8-CPP-v0", num_envs=16)
    >>> observations, infos = envs.reset(seed=0)
    >>> observations["budget"].shape
    (16, 1)
    """
    from uavbench.envs.vector_env import UAVVectorEnv

    return UAVVectorEnv(scenario, num_envs, **kwargs)


def parallel_env(scenario: str | Path | Scenario, **kwargs: Any) -> "UAVParallelEnv":
    """Return the PettingZoo ``ParallelEnv`` of a scenario: see `uavbench.envs.parallel_env.UAVParallelEnv`.

    Parameters
    ----------
    scenario : str, Path or Scenario
        An id, ``"Manhattan32-DH-Team-v0"``, the path of a TOML file, or a loaded scenario.
    **kwargs
        As for `uavbench.envs.parallel_env.UAVParallelEnv`.

    Raises
    ------
    ScenarioError, ValueError
        When there is no such scenario, or an argument does not fit.

    Examples
    --------
    >>> import uavbench
    >>> env = uavbench.parallel_env("Manhattan32-DH-Team-v0", num_uavs=2)
    >>> observations, infos = env.reset(seed=0)
    >>> env.agents
    ['uav_0', 'uav_1']
    """
    from uavbench.envs.parallel_env import UAVParallelEnv

    return UAVParallelEnv(scenario, **kwargs)


def parallel_vec(scenario: str | Path | Scenario, num_envs: int = 1, **kwargs: Any) -> "UAVTeamVectorEnv":
    """Return many teams side by side in one simulator: see `uavbench.envs.team_vector_env.UAVTeamVectorEnv`.

    Parameters
    ----------
    scenario : str, Path or Scenario
        An id, the path of a TOML file, or a loaded scenario.
    num_envs : int
        How many teams.
    **kwargs
        As for `uavbench.envs.team_vector_env.UAVTeamVectorEnv`.

    Raises
    ------
    ScenarioError, ValueError
        When there is no such scenario, or an argument does not fit.

    Examples
    --------
    >>> import uavbench
    >>> envs = uavbench.parallel_vec("Manhattan32-DH-Team-v0", num_envs=16)
    >>> observations, infos = envs.reset(seed=0)
    >>> observations["budget"].shape, infos["action_mask"].shape
    ((16, 3, 1), (16, 3, 6))
    """
    from uavbench.envs.team_vector_env import UAVTeamVectorEnv

    return UAVTeamVectorEnv(scenario, num_envs, **kwargs)


def aec_env(scenario: str | Path | Scenario, **kwargs: Any) -> "AECEnv[str, Any, Any]":
    """Return the PettingZoo ``AECEnv`` of a scenario, converted from `parallel_env`, which takes the same arguments.

    Examples
    --------
    >>> import uavbench
    >>> env = uavbench.aec_env("Manhattan32-DH-Team-v0")
    >>> env.reset(seed=0)
    >>> env.agent_selection
    'uav_0'
    """
    from uavbench.envs.parallel_env import aec_env as convert

    return convert(scenario, **kwargs)


def _register() -> None:
    """Register the shipped scenarios with Gymnasium and PettingZoo."""
    for name in list_scenarios():
        team = "-Team-" in name
        cast("Any", gymnasium).register(  # those of teams only to say how they are made
            id=f"uavbench/{name}",
            entry_point="uavbench.envs.core:refuse_team" if team else "uavbench.envs.env:UAVEnv",
            vector_entry_point="uavbench.envs.core:refuse_team" if team else "uavbench.envs.vector_env:UAVVectorEnv",
            kwargs={"scenario": name},
        )
        if team and hasattr(pettingzoo, "register"):  # since PettingZoo 1.27
            for kind, maker in (("parallel", "UAVParallelEnv"), ("aec", "aec_env")):
                cast("Any", pettingzoo).register(
                    kind, f"uavbench/{name}", f"uavbench.envs.parallel_env:{maker}", kwargs={"scenario": name}
                )


moved.install()
_register()
