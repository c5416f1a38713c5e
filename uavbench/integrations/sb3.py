"""Stable-Baselines3: a vector environment that steps all episodes in one compiled simulator.

Needs ``pip install stable-baselines3``; docs/integrations.md shows it in use.
"""

# pyright: basic, reportMissingImports=false
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv as _VecEnv

from uavbench.envs.vector_env import UAVVectorEnv
from uavbench.world.scenario import Scenario


class VecEnv(_VecEnv):
    """N environments of a scenario for Stable-Baselines3 and sb3-contrib.

    It gives the same observations, rewards, dones and infos of ended episodes as ``DummyVecEnv`` with N single environments,
    bit for bit, in a fraction of the time. ``VecMonitor``, ``VecNormalize`` and ``MaskablePPO`` work on it.

    Parameters
    ----------
    scenario : str, Path or Scenario
        An id, the path of a TOML file, or a loaded scenario.
    num_envs : int
        N.
    every_info : bool
        Whether ``infos`` are filled for every slot at every step, as in ``DummyVecEnv``. By default only the infos of episodes
        that have just ended are filled, because filling N dictionaries takes longer than the step.
    **kwargs
        As for `uavbench.envs.vector_env.UAVVectorEnv`, except ``autoreset_mode``.

    Raises
    ------
    ScenarioError, ValueError
        When there is no such scenario, it is for a team, or an argument does not fit.

    Examples
    --------
    >>> from stable_baselines3.common.vec_env import VecMonitor
    >>> from uavbench.integrations.sb3 import VecEnv
    >>> envs = VecMonitor(VecEnv("Block8-CPP-v0", num_envs=64))
    >>> envs.reset()["budget"].shape
    (64, 1)
    """

    def __init__(self, scenario: str | Path | Scenario, num_envs: int = 1, *, every_info: bool = False, **kwargs: Any) -> None:
        if "autoreset_mode" in kwargs:
            raise ValueError("autoreset_mode: in Stable-Baselines3 the next episode always begins in the same step")
        self.envs = UAVVectorEnv(scenario, num_envs, autoreset_mode="SameStep", **kwargs)
        self._every_info = every_info
        self._actions: NDArray[np.int64] = np.zeros(num_envs, dtype=np.int64)
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)

    def reset(self) -> dict[str, NDArray[np.float32]]:
        """Start an episode in every slot, with the seeds from `seed` if it was called; return the observations."""
        seeds, options = list(self._seeds), self._options[0]
        if any(each != options for each in self._options):
            raise ValueError("options: they differ between the environments; a VecEnv of uavbench takes the same for all")
        given = None if all(seed is None for seed in seeds) else seeds
        observations, infos = self.envs.reset(seed=given, options=dict(options) or None)
        self.reset_infos = self._infos(infos, range(self.num_envs))
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions of the next step, shape (N,)."""
        self._actions = np.asarray(actions)

    def step_wait(
        self,
    ) -> tuple[dict[str, NDArray[np.float32]], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Fly one action in every slot; if an episode ends, the next one begins in the same step."""
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        dones = terminated | truncated
        over: list[int] = np.flatnonzero(dones).tolist()
        told: list[dict[str, Any]] = (
            self._infos(infos, range(self.num_envs)) if self._every_info else [{} for _ in range(self.num_envs)]
        )
        if over:
            begun, ended = self._infos(infos, over), self._infos(infos["final_info"], over)
            for k, i in enumerate(over):
                self.reset_infos[i] = begun[k]
                told[i] = {**ended[k], "terminal_observation": infos["final_obs"][i]}
        for i in range(self.num_envs) if self._every_info else over:
            told[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
        return observations, rewards.astype(np.float32), dones, told

    @staticmethod
    def _infos(infos: dict[str, Any], slots: Sequence[int]) -> list[dict[str, Any]]:
        """Return the infos of some slots, each as a single environment returns it."""
        names = [name for name in infos if f"_{name}" in infos and name not in ("final_info", "final_obs")]
        return [{name: infos[name][i] for name in names} for i in slots]

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of slots: see `uavbench.envs.vector_env.UAVVectorEnv.call`. ``spec`` is None."""
        if attr_name == "spec":
            return [None for _ in self._get_indices(indices)]
        values = self.envs.call(attr_name)
        return [values[i] for i in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set ``success_cr`` in some slots; no other attribute can be set."""
        values = list(self.envs.get_attr(attr_name))
        for i in self._get_indices(indices):
            values[i] = value
        self.envs.set_attr(attr_name, values)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Call a method of slots: ``action_masks`` or ``render``."""
        values = self.envs.call(method_name, *method_args, **method_kwargs)
        return [values[i] for i in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: Any = None) -> list[bool]:  # noqa: ARG002
        """Return False for every slot: there are no single environments to wrap."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a picture of every slot."""
        return list(self.envs.render() or [None] * self.num_envs)
