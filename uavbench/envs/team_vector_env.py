"""Many teams side by side in one simulator: arrays with a row for each team and a place for each of its UAVs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from uavbench.envs.core import (
    SUCCESS_CR,
    Changes,
    action_space,
    check_options,
    check_success,
    check_threads,
    information,
    load,
    observation_space,
)
from uavbench.envs.episodes import Episodes, Generators
from uavbench.simulation.observation import Observation, Observer
from uavbench.simulation.options import check_start
from uavbench.simulation.simulator import Simulator
from uavbench.world.city import HOVER, NUM_ACTIONS
from uavbench.world.scenario import Scenario
from uavbench.world.values import as_integer, shown


class UAVTeamVectorEnv:
    """N teams in one simulator; bit for bit what N of `uavbench.envs.parallel_env.UAVParallelEnv` with ``keep_finished`` make.

    Neither Gymnasium nor PettingZoo has an interface for it, so this is a plain class. U is the largest number of UAVs
    of a team in the scenario. Where an episode ends, the next one begins in the same step.

    Parameters
    ----------
    scenario : str, Path or Scenario
        An id, the path of a TOML file, or a loaded scenario.
    num_envs : int
        N.
    num_uavs : int, optional
        How many UAVs fly in every episode; by default as many as the episode draws.
    split, order, start, success_cr, **changes
        As for `uavbench.envs.env.UAVEnv`; all slots share one cycle.
    threads : int
        How many threads share the slots of a step.

    Attributes
    ----------
    observation_space, action_space : gymnasium.spaces.Space
        Those of one UAV.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int = 1,
        *,
        num_uavs: int | None = None,
        split: str = "train",
        order: str = "random",
        start: str = "landing",
        success_cr: float = SUCCESS_CR,
        threads: int = 1,
        **changes: Unpack[Changes],
    ) -> None:
        number = as_integer(num_envs)
        if number is None or number < 1:
            raise ValueError(f"num_envs: {shown(num_envs)} is not an integer from 1 on")
        loaded = load(scenario, **changes)
        self.scenario = loaded if num_uavs is None else loaded.with_uavs(num_uavs)
        self.num_envs, self.max_uavs = number, self.scenario.max_uavs
        self._episodes = Episodes(self.scenario, split, order)
        self._start = check_start(start)
        self._success_cr = np.full(number, check_success(success_cr))
        self.simulator = Simulator(self.scenario, number, check_threads(threads))
        self._observer = Observer(self.scenario)
        self.observation_space = observation_space(self.scenario, self._observer)
        self.action_space = action_space()
        self._generators = Generators(number)
        self._ready = False

    @property
    def episode(self) -> tuple[tuple[str, int], ...]:
        """Split and number of every team's running episode; ``("custom", -1)`` where it was set by hand."""
        return tuple(self.simulator.episode(i) for i in range(self.num_envs))

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode in every slot.

        Parameters
        ----------
        seed : int or sequence of int, optional
            Slot i is seeded with ``seed + i``, or with ``seed[i]``.
        options : dict, optional
            As for `uavbench.envs.parallel_env.UAVParallelEnv.reset`, applied to every slot.

        Returns
        -------
        observations : dict of str to ndarray of float32
            ``local`` (N, U, C, l, l), ``global`` (N, U, C, h, w) and ``budget`` (N, U, 1); 0 for UAVs that do not fly.
        infos : dict of str to ndarray
            ``active`` bool (N, U): which UAVs fly. ``action_mask`` int8 (N, U, 6), only ``hover`` for those that do not. The
            team's ``split``, ``episode_number``, ``landed``, ``cr``, ``cral``, ``blocked`` and ``is_success``, each (N,).

        Raises
        ------
        ValueError
            When an option or the seeds do not fit. Nothing flies then until a reset succeeds.
        """
        self._ready = False
        given = {"start": self._start, **check_options(options, self.simulator.mission, extra=("num_uavs",))}
        self._generators.seed(seed, range(self.num_envs))
        if seed is not None:
            self._episodes.restart()
        for i in range(self.num_envs):
            split, number = self._episodes.choose(given, self._generators[i])
            self.simulator.reset([i], split, [number])
            self.simulator.customise(i, given)
        self._ready = True
        return self._observe(), self._infos()

    def step(
        self, actions: NDArray[np.integer[Any]]
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Fly one action with every UAV of every team, in their order.

        Parameters
        ----------
        actions : ndarray of int, shape (N, U)
            Each from 0 to 5; those of UAVs that do not fly are ignored.

        Returns
        -------
        observations : dict of str to ndarray of float32
            As `reset` returns them: where an episode has ended, those of the next one.
        rewards : ndarray of float64, shape (N, U)
            What each UAV earned.
        terminated, truncated : ndarray of bool, shape (N,)
            Which episodes have ended; none is truncated.
        infos : dict of str to ndarray
            As `reset` returns them. Where episodes have ended, also ``final_info``, the infos of all slots before the next
            episodes began, and ``final_obs``, their observations.

        Raises
        ------
        RuntimeError
            Before a successful `reset`.
        ValueError
            When the actions are not N × U integers from 0 to 5.
        """
        if not self._ready:
            raise RuntimeError("step() before a successful reset(): call reset() first")
        chosen = np.asarray(actions)
        if chosen.shape != (self.num_envs, self.max_uavs):
            raise ValueError(f"actions: shape {chosen.shape}, expected {(self.num_envs, self.max_uavs)}")
        state = self.simulator.state
        if chosen.dtype.kind in "iu":
            chosen = np.where(state.done, HOVER, chosen)
        self.simulator.step(chosen if self.scenario.team else chosen[:, 0])
        rewards, terminated = state.reward.copy(), np.asarray(state.done.all(axis=1))
        final: dict[str, Any] = {}
        over: list[int] = np.flatnonzero(terminated).tolist()
        if over:
            final = {"final_info": self._infos(), "final_obs": self._observe()}
            numbers = [self._episodes.choose({}, self._generators[i])[1] for i in over]
            self.simulator.reset(over, self._episodes.split, numbers)
            if self._start == "anywhere":
                self.simulator.scatter(np.array(over))
        return self._observe(), rewards, terminated, np.zeros(self.num_envs, dtype=np.bool_), {**self._infos(), **final}

    def _observe(self) -> Observation:
        """Return fresh arrays with the observations of all UAVs."""
        batch = self._observer.empty(self.num_envs * self.max_uavs)
        finished = self.simulator.state.done.reshape(-1)
        self._observer.write(self.simulator.state, np.flatnonzero(~finished), batch, self.simulator.threads)
        for values in batch.values():
            values[finished] = 0.0
        return {name: values.reshape(self.num_envs, self.max_uavs, *values.shape[1:]) for name, values in batch.items()}

    def _infos(self) -> dict[str, Any]:
        """Return fresh information about all teams."""
        active = ~self.simulator.state.done
        masks = self.simulator.action_mask().reshape(self.num_envs, self.max_uavs, NUM_ACTIONS)
        masks[~active] = np.arange(NUM_ACTIONS) == HOVER
        return {"active": active, "action_mask": masks, **information(self.simulator, self._success_cr)}
