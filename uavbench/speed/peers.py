"""The most similar tasks of other suites, for `uavbench speed`. They are optional: those that are installed are measured.

A peer steps a batch of environments with fixed actions, and starts the next episodes in its own way.
"""

import importlib.util
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from uavbench.errors import one_line

_ENVIRONMENTS = 256
_FEW = 16  # number of environments written in Python: a round of more would take seconds


@dataclass(frozen=True)
class Peer:
    """A batch of another suite's environments.

    Attributes
    ----------
    task, interface : str
        The environment, and the interface by which it is stepped.
    environments : int
        Number of environments.
    bytes : int
        Size of the observation of one environment.
    step : callable
        Steps them all once.
    """

    task: str
    interface: str
    environments: int
    bytes: int
    step: Callable[[], Any]


def installed_peers(on_failure: Callable[[str], None]) -> Iterator[Peer]:
    """Yield the peers that are installed; call ``on_failure`` with a line about each one that cannot be made."""
    for (module, name), make in _MAKERS.items():
        if importlib.util.find_spec(module) is None:
            continue
        try:
            yield make(name)
        except Exception as error:  # another library in an untested version may raise anything
            on_failure(f"{name} of {module} cannot be measured: {type(error).__name__}: {one_line(error)}")


def _minigrid(name: str) -> Peer:
    """Return MiniGrid, which is written in Python, in Gymnasium's vector environment."""
    import gymnasium as gym

    importlib.import_module("minigrid")
    return _vector_peer(name, "SyncVectorEnv", gym.vector.SyncVectorEnv([lambda: gym.make(name)] * _FEW), _FEW)


def _envpool(name: str) -> Peer:
    """Return EnvPool's MiniGrid, which is written in C++."""
    envpool: Any = importlib.import_module("envpool")
    envs = envpool.make(name, env_type="gymnasium", num_envs=_ENVIRONMENTS, num_threads=1)
    return _vector_peer(name, "EnvPool", envs, _ENVIRONMENTS)


def _vector_peer(name: str, interface: str, envs: Any, environments: int) -> Peer:
    """Return a peer with the interface of Gymnasium's vector environments; its actions are to turn and to go forward."""
    observation, _ = envs.reset()
    actions = np.random.default_rng(0).integers(0, 3, environments).astype(np.int32)
    return Peer(name, interface, environments, _size(observation) // environments, lambda: envs.step(actions))


def _jumanji(name: str) -> Peer:
    """Return one of Jumanji's environments, compiled by JAX; all its actions are the one that its specification generates."""
    jax: Any = importlib.import_module("jax")
    jumanji: Any = importlib.import_module("jumanji")
    wrappers: Any = importlib.import_module("jumanji.wrappers")
    env = wrappers.VmapAutoResetWrapper(jumanji.make(name))
    state, timestep = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), _ENVIRONMENTS))
    step, kept = jax.jit(env.step), [state]
    action = np.stack([env.action_spec.generate_value()] * _ENVIRONMENTS)

    def run() -> None:
        kept[0], shown = step(kept[0], action)
        jax.block_until_ready(shown.observation)

    size = sum(_size(part) for part in jax.tree_util.tree_leaves(timestep.observation))
    return Peer(name, "Jumanji, JAX", _ENVIRONMENTS, size // _ENVIRONMENTS, run)


def _size(observation: Any) -> int:
    """Return the size of the numbers in an observation, in bytes; text, such as MiniGrid's mission, is not counted."""
    if isinstance(observation, dict):
        return sum(_size(part) for part in cast("dict[str, Any]", observation).values())
    array: Any = np.asarray(observation)
    return array.nbytes if array.dtype.kind in "biuf" else 0


# By module and environment.
_MAKERS: dict[tuple[str, str], Callable[[str], Peer]] = {
    ("minigrid", "MiniGrid-FourRooms-v0"): _minigrid,
    ("envpool", "MiniGrid-Empty-8x8-v0"): _envpool,
    ("jumanji", "Cleaner-v0"): _jumanji,
    ("jumanji", "Snake-v1"): _jumanji,
}
