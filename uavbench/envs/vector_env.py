"""The Gymnasium vector environment: N slots of one simulator."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from uavbench.envs.core import (
    METADATA,
    EnvState,
    action_space,
    check_alone,
    check_options,
    check_render_mode,
    choose_episode,
    load,
    observation_space,
)
from uavbench.envs.pictures import Pictures
from uavbench.episode import check_split
from uavbench.observation import Observation, Observer
from uavbench.scenario import Scenario, SplitName
from uavbench.simulator import Simulator

_RENDER_MODES = [mode for mode in METADATA["render_modes"] if mode != "human"]


class UAVVectorEnv(VectorEnv[Observation, NDArray[np.int64], NDArray[Any]]):
    """N copies of `uavbench.envs.env.UAVEnv` in one simulator; bit for bit what ``SyncVectorEnv`` of N makes of them.

    Parameters
    ----------
    scenario, local_size, global_scale, split, render_mode
        As for `uavbench.envs.env.UAVEnv`.
    num_envs : int
        N.
    autoreset_mode : AutoresetMode or str
        ``"NextStep"`` (default), ``"SameStep"`` or ``"Disabled"``.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int = 1,
        *,
        local_size: int | None = None,
        global_scale: int | None = None,
        split: str = "train",
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs: {num_envs} is not at least 1")
        self.scenario = check_alone(load(scenario, local_size, global_scale))
        self.num_envs = num_envs
        self.render_mode = check_render_mode(render_mode, _RENDER_MODES)
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            names = ", ".join(mode.value for mode in AutoresetMode)
            raise ValueError(f"autoreset_mode: {autoreset_mode!r} is not one of {names}") from None
        self.metadata = {**METADATA, "render_modes": _RENDER_MODES, "autoreset_mode": self.autoreset_mode}
        self._split: SplitName = check_split(split)
        self.simulator = Simulator(self.scenario, num_envs)
        self._observer = Observer(self.scenario)
        self.single_observation_space = observation_space(self.scenario, self._observer)
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._all = np.arange(num_envs)
        self._pictures = Pictures(self.simulator, self.render_mode)
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._ready = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start episodes in all slots, or in those of ``options["reset_mask"]``.

        Parameters
        ----------
        seed : int or sequence of int, optional
            Slot i is seeded with ``seed + i``, or with ``seed[i]``.
        options : dict, optional
            As for `UAVEnv.reset`, applied to every slot, except that ``episode`` may be a sequence of N numbers; and
            ``reset_mask``, bool (N,): the slots to reset.

        Raises
        ------
        ValueError, TypeError
            When an option or the seeds do not fit.
        """
        self._ready = False
        given = check_options(options, self.simulator.mission, extra=("reset_mask",))
        index = self._masked(given.pop("reset_mask", None))
        seeds = self._seeds(seed)
        episodes = given.pop("episode", None)
        slots: list[int] = index.tolist()
        for i in slots:
            own = seeds[i]
            if own is not None:
                self._generators[i] = seeding.np_random(own)[0]
        if seed is not None:
            self._np_random, self._np_random_seed = seeding.np_random(seeds[0])
        per_slot = {i: self._episode_option(given, episodes, i) for i in slots}
        self._start(index, per_slot)
        for i in slots:
            self.simulator.customise(i, given)
        self._pictures.begin(index.tolist())
        self._ready = True
        return self._observe(self._all), self._info(self._none(), index, index)

    def step(
        self, actions: Any
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Fly one action in every slot; the autoreset mode says what happens to those whose episode has ended.

        Raises
        ------
        RuntimeError
            Before a successful `reset`, and when ``autoreset_mode`` is ``"Disabled"`` and an episode has ended.
        ValueError
            When the actions are not N integers from 0 to 5.
        """
        if not self._ready:
            raise RuntimeError("step() before a successful reset(): call reset() first")
        state = self.simulator.state
        done = state.done[:, 0]
        before = done.copy()
        waiting = np.flatnonzero(before)
        if len(waiting) and self.autoreset_mode is not AutoresetMode.NEXT_STEP:
            raise RuntimeError(f"step() after the end of the episodes in slots {waiting.tolist()}: reset them first")
        self.simulator.step(actions)
        rewards, ended = state.reward[:, 0].copy(), done & ~before
        over, truncated = np.flatnonzero(ended), np.zeros(self.num_envs, dtype=np.bool_)
        self._pictures.extend()
        if self.autoreset_mode is AutoresetMode.SAME_STEP and len(over):
            infos = self._final(over)
            self._start(over, {})
            infos.update(self._info(self._none(), self._all, over))
        else:
            if len(waiting):
                self._start(waiting, {})
            infos = self._info(over, self._all, waiting)
        return self._observe(self._all), rewards, ended, truncated, infos

    def get_state(self, index: ArrayLike | None = None) -> EnvState:
        """Return the state of the episodes in the slots ``index`` (by default in all), to come back to them by `set_state`.

        The generators that draw the next episodes are not part of it.
        """
        return EnvState(self.simulator.get_state(index), self._pictures.get_state(self._listed(index)))

    def set_state(self, state: EnvState, index: ArrayLike | None = None) -> None:
        """Put the slots ``index`` (by default all) into a state that `get_state` returned, to the last bit.

        Parameters
        ----------
        state : EnvState
            Of as many slots, or of one, which then all of them get; of any environment of the scenario.
        index : array_like of int, shape (K,), optional
            The slots.

        Raises
        ------
        ValueError, IndexError
            When the state does not fit, or ``index`` does not name slots. Nothing is changed then.
        """
        self.simulator.set_state(state.simulator, index)
        self._ready = self._ready or index is None
        self._pictures.set_state(state.trails, self._listed(index))

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the actions that have their effect, bool (N, 6)."""
        return self.simulator.action_mask().astype(np.bool_)

    def render(self) -> tuple[Any, ...] | None:
        """Return a picture of every slot's episode, as `UAVEnv.render` does."""
        if self.render_mode is None:
            return None
        return tuple(self._pictures.of(i) for i in range(self.num_envs))

    def _listed(self, index: ArrayLike | None) -> list[int]:
        """Return slots as a list; all of them where ``index`` is None."""
        return (self._all if index is None else np.asarray(index)).tolist()

    def _start(self, index: NDArray[np.int64], options: dict[int, dict[str, Any]]) -> None:
        """Start the next episodes in the slots ``index``."""
        by_split: dict[SplitName, list[tuple[int, int]]] = {}
        slots: list[int] = index.tolist()
        for i in slots:
            generator = self._generators[i]
            if generator is None:
                generator = self._generators[i] = seeding.np_random()[0]
            split, number = choose_episode(self.scenario, self._split, options.get(i, {}), generator)
            by_split.setdefault(split, []).append((i, number))
        for split, chosen in by_split.items():
            started, numbers = zip(*chosen, strict=True)
            self.simulator.reset(started, split, numbers)
        self._pictures.begin(index.tolist())

    def _observe(self, index: NDArray[np.int64]) -> Observation:
        """Return fresh arrays with the observations of the slots ``index`` in their places."""
        batch = self._observer.empty(self.num_envs)
        self._observer.write(self.simulator.state, index, batch)
        return batch

    def _final(self, over: NDArray[np.int64]) -> dict[str, Any]:
        """Return what ``SAME_STEP`` keeps of the episodes that ended: their last observations and information."""
        batch = self._observe(over)
        final = np.full(self.num_envs, None, dtype=object)
        for i in over.tolist():
            final[i] = {name: values[i].copy() for name, values in batch.items()}
        ended = self._flags(over)
        return {
            "final_obs": final,
            "_final_obs": ended,
            "final_info": self._info(over, over, self._none()),
            "_final_info": ended.copy(),
        }

    def _info(self, ended: NDArray[np.int64], shown: NDArray[np.int64], started: NDArray[np.int64]) -> dict[str, Any]:
        """Return the batched information: masks of ``shown``, metrics of ``ended``, names of ``started`` slots."""
        infos: dict[str, Any] = {}

        def add(name: str, index: NDArray[np.int64], values: NDArray[Any]) -> None:
            whole = np.zeros((self.num_envs, *values.shape[1:]), dtype=values.dtype)
            if values.dtype == object:
                whole[:] = None
            whole[index] = values
            infos[name], infos[f"_{name}"] = whole, self._flags(index)

        if len(shown) == self.num_envs:
            infos["action_mask"], infos["_action_mask"] = self.simulator.action_mask(), np.ones(self.num_envs, np.bool_)
        else:
            add("action_mask", shown, self.simulator.action_mask()[shown])
        if len(ended):
            for name, values in self.simulator.outcomes(ended).items():
                add(name, ended, values)
        if len(started):
            names = [self.simulator.episode(i) for i in started.tolist()]
            add("split", started, np.array([split for split, _ in names], dtype=object))
            add("episode_number", started, np.array([number for _, number in names]))
        return infos

    def _flags(self, index: NDArray[np.int64]) -> NDArray[np.bool_]:
        flags = np.zeros(self.num_envs, dtype=np.bool_)
        flags[index] = True
        return flags

    @staticmethod
    def _none() -> NDArray[np.int64]:
        return np.zeros(0, dtype=np.int64)

    def _masked(self, mask: Any) -> NDArray[np.int64]:
        """Return the slots that ``reset_mask`` names."""
        if mask is None:
            return self._all
        chosen: NDArray[Any] = mask
        if not isinstance(mask, np.ndarray) or chosen.dtype != np.bool_:
            raise TypeError("reset_mask: not a numpy array of bool")
        if chosen.shape != (self.num_envs,) or not chosen.any():
            raise ValueError(f"reset_mask: shape {chosen.shape}, expected ({self.num_envs},) with at least one True")
        return np.flatnonzero(chosen)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        """Return the seed of every slot."""
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [int(seed) + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"seed: {len(seed)} seeds for {self.num_envs} environments")
        return list(seed)

    def _episode_option(self, given: dict[str, Any], episodes: Any, i: int) -> dict[str, Any]:
        """Return the options that pick slot ``i``'s episode."""
        if episodes is None:
            return given
        if np.ndim(episodes) == 0:
            return {**given, "episode": episodes}
        if len(episodes) != self.num_envs:
            raise ValueError(f"episode: {len(episodes)} numbers for {self.num_envs} environments")
        return {**given, "episode": episodes[i]}
