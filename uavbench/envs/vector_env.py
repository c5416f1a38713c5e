"""The Gymnasium vector environment: a simulator with N slots."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from uavbench.envs.core import (
    METADATA,
    SUCCESS_CR,
    Changes,
    EnvState,
    action_space,
    check_alone,
    check_options,
    check_render_mode,
    check_success,
    check_threads,
    information,
    load,
    observation_space,
)
from uavbench.envs.episodes import Episodes, Generators
from uavbench.envs.forms import Form
from uavbench.envs.pictures import Pictures
from uavbench.simulation.observation import Observation, Observer
from uavbench.simulation.options import check_start
from uavbench.simulation.simulator import Simulator
from uavbench.world.scenario import Scenario, SplitName
from uavbench.world.values import as_integer, as_list, shown

_RENDER_MODES = [mode for mode in METADATA["render_modes"] if mode != "human"]
_NO_LIMIT = np.iinfo(np.int64).max

# The names that `UAVVectorEnv.call` accepts: attributes that all slots share, with their names in the vector environment, and
# those that each slot has for itself.
_SHARED = {
    "action_space": "single_action_space",
    "observation_space": "single_observation_space",
    "render_mode": "render_mode",
    "scenario": "scenario",
}
_OF_EACH = ("action_masks", "episode", "render", "success_cr")


class UAVVectorEnv(VectorEnv[Observation, NDArray[np.int64], NDArray[Any]]):
    """N copies of `uavbench.envs.env.UAVEnv` in one simulator, with the same results as ``SyncVectorEnv``, bit for bit.

    Parameters
    ----------
    scenario, split, start, safe_action_mask, compact, normalize, success_cr, render_mode, **changes
        As for `uavbench.envs.env.UAVEnv`.
    num_envs : int
        N.
    order : {"random", "cycle"}
        As for `uavbench.envs.env.UAVEnv`, except that all slots share one cycle: each slot that is reset takes the next
        episode. (In a ``SyncVectorEnv`` each environment has its own cycle, and goes through all episodes.)
    max_episode_steps : int, optional
        Truncates episodes after this number of steps, as Gymnasium's ``TimeLimit`` does; None or −1 for no limit.
    threads : int
        Number of threads that share the slots of a step, with the same results to the last bit. One by default, so that
        many environments on one machine do not compete for its cores. More help with large batches: see docs/performance.md.
    autoreset_mode : AutoresetMode or str
        ``"NextStep"`` (default), ``"SameStep"`` or ``"Disabled"``.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int = 1,
        *,
        split: str = "train",
        start: str = "landing",
        safe_action_mask: bool = False,
        compact: bool = False,
        normalize: bool = False,
        order: str = "random",
        success_cr: float = SUCCESS_CR,
        max_episode_steps: int | None = None,
        threads: int = 1,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **changes: Unpack[Changes],
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs: {num_envs} is not at least 1")
        self.scenario = check_alone(load(scenario, **changes))
        self.num_envs = num_envs
        self.render_mode = check_render_mode(render_mode, _RENDER_MODES)
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            names = ", ".join(mode.value for mode in AutoresetMode)
            raise ValueError(f"autoreset_mode: {autoreset_mode!r} is not one of {names}") from None
        self.metadata = {**METADATA, "render_modes": _RENDER_MODES, "autoreset_mode": self.autoreset_mode}
        self._episodes = Episodes(self.scenario, split, order)
        self._start_option, self._shows_safe = check_start(start), safe_action_mask
        self._success_cr = np.full(num_envs, check_success(success_cr))
        self._limit = _check_limit(max_episode_steps)
        self.simulator = Simulator(self.scenario, num_envs, check_threads(threads))
        self._observer = Observer(self.scenario)
        self._form = Form(self.scenario, compact, normalize)
        self.single_observation_space = self._form.space(observation_space(self.scenario, self._observer))
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._all = np.arange(num_envs)
        self._pictures = Pictures(self.simulator, self.render_mode)
        self._generators = Generators(num_envs)
        self._elapsed = np.zeros(num_envs, dtype=np.int64)
        self._names: list[str] = []
        self._same_step = self.autoreset_mode is AutoresetMode.SAME_STEP
        self._ready = False

    @property
    def episode(self) -> tuple[tuple[str, int], ...]:
        """The split and the number of every slot's current episode; ``("custom", -1)`` if it was set by hand."""
        return tuple(self.simulator.episode(i) for i in range(self.num_envs))

    @property
    def success_cr(self) -> tuple[float, ...]:
        """The CR that a success needs at least, for every slot; `set_attr` changes it."""
        return tuple(self._success_cr.tolist())

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
            When an option or the seeds do not fit. Then `step` fails until a reset succeeds.
        """
        self._ready = False
        given = {"start": self._start_option, **check_options(options, self.simulator.mission, extra=("reset_mask",))}
        index = self._masked(given.pop("reset_mask", None))
        slots: list[int] = index.tolist()
        seeds = self._generators.seed(seed, slots)
        if seed is not None:
            self._np_random, self._np_random_seed = seeding.np_random(seeds[0])
            self._episodes.restart()
        try:
            self._start(index, self._episode_options(given, slots))
            for i in slots:
                self.simulator.customise(i, given)
        except ValueError:
            self.simulator.state.done[index] = True  # a later reset of other slots must not let these fly
            self._pictures.end(slots)
            raise
        self._pictures.begin(index.tolist())
        self._ready = True
        return self._observe(self._all), self._info(index)

    def step(
        self, actions: Any
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Fly one action in every slot; the autoreset mode decides what happens in slots whose episode has ended.

        Raises
        ------
        RuntimeError
            Before a successful `reset`; and with ``autoreset_mode="Disabled"``, when an episode has ended and was not reset.
        ValueError
            When the actions are not N integers from 0 to 5.
        """
        if not self._ready:
            raise RuntimeError("step() before a successful reset(): call reset() first")
        state = self.simulator.state
        done = state.done[:, 0]
        before = done.copy() if self._limit == _NO_LIMIT else done | (self._elapsed >= self._limit)  # whose episode is over
        waiting = before.nonzero()[0]
        if len(waiting) and self.autoreset_mode is not AutoresetMode.NEXT_STEP:
            raise RuntimeError(f"step() after the end of the episodes in slots {waiting.tolist()}: reset them first")
        self.simulator.step(actions)
        self._elapsed += 1
        rewards, terminated = state.reward[:, 0].copy(), done > before
        if self._limit == _NO_LIMIT:
            truncated = np.zeros(self.num_envs, dtype=np.bool_)
        else:
            rewards[waiting] = 0.0  # if only the limit ended an episode, the simulator has flown on
            truncated = (self._elapsed >= self._limit) > before
        self._pictures.extend()
        final: dict[str, Any] = {}
        if self._same_step:
            over = (terminated | truncated).nonzero()[0]
            if len(over):
                final = self._final(over)
                self._restart(over)
        elif len(waiting):
            self._restart(waiting)
        return self._observe(self._all), rewards, terminated, truncated, {**final, **self._info(self._all)}

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Return the attribute ``name`` of every slot, or if it is a method, what it returns, as ``SyncVectorEnv`` does.

        Raises
        ------
        AttributeError
            When ``name`` is not one of ``action_masks``, ``action_space``, ``episode``, ``observation_space``, ``render``,
            ``render_mode``, ``scenario`` and ``success_cr``.
        """
        if name in _SHARED:
            return (getattr(self, _SHARED[name]),) * self.num_envs
        if name not in _OF_EACH:
            raise AttributeError(f"call: {shown(name)} is not one of {', '.join(sorted((*_SHARED, *_OF_EACH)))}")
        found: Any = getattr(self, name)
        each: Any = found(*args, **kwargs) if callable(found) else found
        return (None,) * self.num_envs if each is None else tuple(each)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of every slot: see `call`."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set ``success_cr``, for all slots or by a list of N.

        Raises
        ------
        AttributeError
            When ``name`` is another.
        ValueError
            When there are not N values, or one is not from 0 to 1.
        """
        if name != "success_cr":
            raise AttributeError(f"set_attr: {shown(name)} cannot be set; success_cr can")
        listed = as_list(values)
        each = [values] * self.num_envs if listed is None else listed
        if len(each) != self.num_envs:
            raise ValueError(f"{name}: {len(each)} values for {self.num_envs} environments")
        self._success_cr = np.array([check_success(value) for value in each])

    def get_state(self, index: ArrayLike | None = None) -> EnvState:
        """Return the state of the episodes in the slots ``index`` (all by default), so that `set_state` can restore it.

        The generators that draw the next episodes are not part of it.
        """
        slots = self._listed(index)
        return EnvState(self.simulator.get_state(index), self._pictures.get_state(slots), self._elapsed[slots])

    def set_state(self, state: EnvState, index: ArrayLike | None = None) -> None:
        """Restore a state that `get_state` returned in the slots ``index`` (all by default), to the last bit.

        Parameters
        ----------
        state : EnvState
            A state of as many slots, or of one slot, which all of them then get; from any environment of the scenario.
        index : array_like of int, shape (K,), optional
            The slots.

        Raises
        ------
        ValueError, IndexError
            When the state does not fit, or ``index`` does not name slots. Nothing is changed then.
        """
        self.simulator.set_state(state.simulator, index)
        self._ready = self._ready or index is None
        self._elapsed[self._listed(index)] = state.elapsed
        self._pictures.set_state(state.trails, self._listed(index))

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the valid actions, bool (N, 6)."""
        return self.simulator.action_mask().astype(np.bool_)

    def render(self) -> tuple[Any, ...] | None:
        """Return a picture of every slot's episode, as `UAVEnv.render` does."""
        if self.render_mode is None:
            return None
        return tuple(self._pictures.of(i) for i in range(self.num_envs))

    def _listed(self, index: ArrayLike | None) -> list[int]:
        """Return slots as a list; all of them if ``index`` is None."""
        return (self._all if index is None else np.asarray(index)).tolist()

    def _restart(self, index: NDArray[np.int64]) -> None:
        """Start the next episodes of the environment's own split in the slots ``index``."""
        slots: list[int] = index.tolist()
        numbers = [self._episodes.choose({}, self._generators[i])[1] for i in slots]
        self.simulator.reset(index, self._episodes.split, numbers)
        if self._start_option == "anywhere":
            self.simulator.scatter(index)
        self._elapsed[index] = 0
        self._pictures.begin(slots)

    def _start(self, index: NDArray[np.int64], options: dict[int, dict[str, Any]]) -> None:
        """Start episodes in the slots ``index``, each with its options of ``reset``."""
        by_split: dict[SplitName, list[tuple[int, int]]] = {}
        slots: list[int] = index.tolist()
        for i in slots:
            split, number = self._episodes.choose(options[i], self._generators[i])
            by_split.setdefault(split, []).append((i, number))
        for split, chosen in by_split.items():
            started, numbers = zip(*chosen, strict=True)
            self.simulator.reset(started, split, numbers)
        self._elapsed[index] = 0
        self._pictures.begin(index.tolist())

    def _observe(self, index: NDArray[np.int64]) -> Observation:
        """Return fresh arrays for all slots, with the observations of the slots ``index``."""
        batch = self._observer.empty(self.num_envs)
        self._observer.write(self.simulator.state, index, batch, self.simulator.threads)
        if self._form.plain:
            return batch
        formed = self._form.apply({name: values[index] for name, values in batch.items()})
        whole = {name: np.zeros((self.num_envs, *values.shape[1:]), values.dtype) for name, values in formed.items()}
        for name, values in formed.items():
            whole[name][index] = values
        return whole

    def _final(self, over: NDArray[np.int64]) -> dict[str, Any]:
        """Return the last observations and infos of the episodes that ended, which ``SAME_STEP`` puts into the infos."""
        batch = self._observe(over)
        final = np.full(self.num_envs, None, dtype=object)
        for i in over.tolist():
            final[i] = {name: values[i].copy() for name, values in batch.items()}
        ended = self._flags(over)
        return {
            "final_obs": final,
            "_final_obs": ended,
            "final_info": self._info(over),
            "_final_info": ended.copy(),
        }

    def _info(self, index: NDArray[np.int64]) -> dict[str, Any]:
        """Return the batched infos of the slots ``index``, with zeros for the other slots."""
        safe = {"safe_action_mask": self.simulator.safe_action_mask()} if self._shows_safe else {}
        known = {"action_mask": self.simulator.action_mask(), **safe, **information(self.simulator, self._success_cr)}
        flags = np.full((len(known), self.num_envs), fill_value=True)  # a row for each value, so that no array is shared
        if len(index) < self.num_envs:
            flags[:, ~self._flags(index)] = False
            for values in known.values():
                values[~flags[0]] = 0
        return {**known, **dict(zip(self._flag_names(known), flags, strict=True))}

    def _flag_names(self, known: dict[str, Any]) -> list[str]:
        """Return the names of the flags that say, as in Gymnasium, for which slots each value is set. They never change."""
        if not self._names:
            self._names = [f"_{name}" for name in known]
        return self._names

    def _flags(self, index: NDArray[np.int64]) -> NDArray[np.bool_]:
        flags = np.zeros(self.num_envs, dtype=np.bool_)
        flags[index] = True
        return flags

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

    def _episode_options(self, given: dict[str, Any], slots: list[int]) -> dict[int, dict[str, Any]]:
        """Return the options of each of the ``slots``: ``episode`` may be a sequence of N numbers."""
        numbers = as_list(given.get("episode"))
        if numbers is None:
            return dict.fromkeys(slots, given)
        if len(numbers) != self.num_envs:
            raise ValueError(f"episode: {len(numbers)} numbers for {self.num_envs} environments")
        return {i: {**given, "episode": numbers[i]} for i in slots}


def _check_limit(steps: object) -> int:
    """Return the number of steps after which episodes are truncated; `_NO_LIMIT` if they never are."""
    limit = as_integer(steps)
    if steps is None or limit == -1:
        return _NO_LIMIT
    if limit is None or limit < 1:
        raise ValueError(f"max_episode_steps: {shown(steps)} is not an integer from 1 on, nor None or -1 for no limit")
    return limit
