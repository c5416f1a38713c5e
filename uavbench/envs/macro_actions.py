"""Wrappers with which a learner decides by macro-actions: see `uavbench.simulation.macro_actions`."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from uavbench.simulation.macro_actions import Flight, MacroKind
from uavbench.world.values import as_integer, shown


class MacroActions(gym.Wrapper[Any, Any, Any, Any]):
    """An environment in which each step is a macro-action: several moves, whose rewards are added up.

    The result is a semi-Markov decision process (Sutton, Precup, Singh, Artificial Intelligence 1999): the reward of a step is
    Σ γ^k r_k over its moves k = 0, 1, …, and the value of the state after it counts γ^d, where d is the number of moves.

    Parameters
    ----------
    env : UAVEnv
        An environment for one UAV, with a local map.
    kind : {"cells", "directions"}
        ``"cells"``: ``Discrete(l² + 1)``, a cell of the local map in row-major order, or ``land``, the last; the cell in the
        middle means to hover. ``"directions"``: ``Discrete(6)``, the usual actions, of which a move goes on until something
        changes.
    discount : float
        γ, from 0 to 1.

    Notes
    -----
    Infos also have ``macro_action_mask``, int8: 1 for macro-actions that can begin; ``duration`` (int), the number of moves of
    the last one, and ``discount`` (float), γ to the power of it. With ``safe_action_mask=True`` in the environment,
    macro-actions begin and go on only with safe actions, so that landing is always possible.

    Raises
    ------
    ValueError
        When the kind is unknown, the discount is not from 0 to 1, or the environment has no local map.
    """

    def __init__(self, env: gym.Env[Any, Any], kind: str = "cells", discount: float = 1.0) -> None:
        super().__init__(env)
        self._kind, self._discount = _kind_of(env.observation_space, kind), _checked(discount)
        self.action_space = spaces.Discrete(self._kind.number)
        self._seen: tuple[Any, dict[str, Any]] | None = None

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Start an episode, as the environment does."""
        self._seen = None
        observation, info = self.env.reset(**options)
        self._seen = observation, info
        return observation, self._told(observation, info, 0)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Fly a macro-action to its end, or to the end of the episode.

        Raises
        ------
        RuntimeError
            Before a successful `reset`.
        ValueError
            When there is no such macro-action, or it cannot begin.
        """
        if self._seen is None:
            raise RuntimeError("step() before a successful reset(): call reset() first")
        observation, info = self._seen
        flight = _begin(self._kind, action, observation["local"], _allowed(info))
        reward, factor, duration, terminated, truncated = 0.0, 1.0, 0, False, False
        while not (terminated or truncated):
            move = flight.next(observation["local"], _allowed(info))
            if move is None:
                break
            observation, gained, terminated, truncated, info = self.env.step(move)
            reward, factor, duration = reward + factor * float(gained), factor * self._discount, duration + 1
        self._seen = observation, info
        return observation, reward, terminated, truncated, self._told(observation, info, duration)

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the macro-actions that can begin, bool. MaskablePPO of sb3-contrib calls a method of this name."""
        if self._seen is None:
            raise RuntimeError("no episode has begun: call reset() first")
        observation, info = self._seen
        return self._kind.mask(observation["local"], _allowed(info)).astype(np.bool_)

    def _told(self, observation: Any, info: dict[str, Any], duration: int) -> dict[str, Any]:
        """Return the info with what the wrapper adds."""
        mask = self._kind.mask(observation["local"], _allowed(info))
        return {**info, "macro_action_mask": mask, "duration": duration, "discount": self._discount**duration}


class VectorMacroActions(VectorWrapper):
    """A vector environment whose slots decide by macro-actions, each when its last one is over.

    Macro-actions take different times. A step flies all slots until at least one of them has to decide again.
    ``info["decides"]``, bool (N,), says which do: only their parts of the next actions count, and only their rewards are
    complete; those of the other slots are 0 until then.

    Parameters
    ----------
    envs : UAVVectorEnv
        A vector environment for one UAV in each slot, with local maps; not with ``autoreset_mode="Disabled"``.
    kind, discount
        As for `MacroActions`.

    Notes
    -----
    Infos have the keys of `MacroActions`, as arrays with a row for each slot; ``duration`` counts what is in the reward. The
    end of an episode is a decision, too: with ``NEXT_STEP``, the slot's next action is ignored, and its duration is 0.

    Raises
    ------
    ValueError
        As for `MacroActions`, and when ``autoreset_mode`` is ``"Disabled"``.
    """

    def __init__(self, envs: Any, kind: str = "cells", discount: float = 1.0) -> None:
        super().__init__(envs)
        self._kind, self._discount = _kind_of(envs.single_observation_space, kind), _checked(discount)
        self.single_action_space = spaces.Discrete(self._kind.number)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        mode = envs.metadata["autoreset_mode"]
        if mode is gym.vector.AutoresetMode.DISABLED:
            raise ValueError('autoreset_mode: macro-actions need "NextStep" or "SameStep"')
        self._next_step = mode is gym.vector.AutoresetMode.NEXT_STEP
        self._seen: tuple[Any, dict[str, Any]] | None = None

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Start episodes in all slots, as the vector environment does."""
        self._seen = None
        observation, info = self.env.reset(seed=seed, options=options)
        self._seen = observation, info
        self._flights: list[Flight | None] = [None] * self.num_envs
        self._moves, self._over = np.zeros(self.num_envs, dtype=np.int64), np.zeros(self.num_envs, dtype=np.bool_)
        self._rewards, self._durations = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=np.int64)
        return observation, self._told(observation, info, np.ones(self.num_envs, dtype=np.bool_))

    def step(self, actions: Any) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Begin macro-actions in the slots that decide, and fly all slots until one has to decide again.

        Raises
        ------
        RuntimeError
            Before a successful `reset`.
        ValueError
            When the actions are not N, or one of a slot that decides does not exist or cannot begin.
        """
        if self._seen is None:
            raise RuntimeError("step() before a successful reset(): call reset() first")
        if len(actions) != self.num_envs:
            raise ValueError(f"actions: {len(actions)} actions for {self.num_envs} environments")
        local, allowed = self._seen[0]["local"], _allowed(self._seen[1])
        deciding = [i for i, flight in enumerate(self._flights) if flight is None and not self._over[i]]
        begun = {i: _begin(self._kind, actions[i], local[i], allowed[i]) for i in deciding}
        for i, flight in begun.items():  # only now, because an action may have been refused
            self._flights[i] = flight
            first = flight.next(local[i], allowed[i])
            assert first is not None
            self._moves[i] = first
        while True:
            observation, gained, terminated, truncated, info = self.env.step(self._moves.copy())
            self._seen = observation, info
            flew = ~self._over  # the others were reset, if this is the mode
            self._rewards[flew] += self._discount ** self._durations[flew] * gained[flew]
            self._durations[flew] += 1
            ended = terminated | truncated
            for i in np.flatnonzero(ended | ~flew).tolist():
                self._flights[i] = None
            self._over = ended & self._next_step
            self._go_on(observation["local"], _allowed(info))
            decides = np.array([flight is None for flight in self._flights])
            if decides.any():
                break
        told = self._told(observation, info, decides)
        rewards = np.where(decides, self._rewards, 0.0)
        self._rewards[decides] = self._durations[decides] = 0
        return observation, rewards, terminated, truncated, told

    def _go_on(self, local: NDArray[Any], allowed: NDArray[Any]) -> None:
        """Note the next moves of all flights, and remove the flights that are over."""
        for i, flight in enumerate(self._flights):
            if flight is not None:
                move = flight.next(local[i], allowed[i])
                if move is None:
                    self._flights[i] = None
                else:
                    self._moves[i] = move

    def _told(self, observation: Any, info: dict[str, Any], decides: NDArray[np.bool_]) -> dict[str, Any]:
        """Return the infos with what the wrapper adds."""
        allowed, local = _allowed(info), observation["local"]
        masks = np.stack([self._kind.mask(local[i], allowed[i]) for i in range(self.num_envs)])
        durations = np.where(decides, self._durations, 0)
        added = {"macro_action_mask": masks, "decides": decides, "duration": durations, "discount": self._discount**durations}
        return {**info, **added}


def _kind_of(space: Any, kind: str) -> MacroKind:
    """Return the macro-actions for observations of a space."""
    parts: Any = getattr(space, "spaces", {})
    if "local" not in parts:
        raise ValueError("env: macro-actions need observations with a local map: uavbench's, with local_size of at least 3")
    return MacroKind(kind, parts["local"].shape[-1])


def _checked(discount: float) -> float:
    """Return a discount factor; raise a ValueError if it is not from 0 to 1."""
    if not 0.0 <= discount <= 1.0:
        raise ValueError(f"discount: {discount} is not from 0 to 1")
    return float(discount)


def _allowed(info: dict[str, Any]) -> NDArray[Any]:
    """Return the actions that are valid, and safe if the info says which are."""
    valid = np.asarray(info["action_mask"])
    return valid & np.asarray(info["safe_action_mask"]) if "safe_action_mask" in info else valid


def _begin(kind: MacroKind, action: Any, local: NDArray[Any], allowed: NDArray[Any]) -> Flight:
    """Return the flight of a macro-action that can begin; raise a ValueError if it cannot."""
    chosen = as_integer(action)
    if chosen is None or not 0 <= chosen < kind.number:
        raise ValueError(f"actions: {shown(action)} is not one integer from 0 to {kind.number - 1}")
    if not kind.mask(local, allowed)[chosen]:
        raise ValueError(f"actions: the macro-action {chosen} cannot begin here: see info['macro_action_mask']")
    return kind.begin(chosen, local)
