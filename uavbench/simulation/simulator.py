"""The simulator: a batch of episodes, reset from keys and stepped by the rules of the world.

Source: the paper's eqs. (1) and (2), with uavSim settling what they leave open; teams after Bayerlein et al., IEEE OJCOMS
2021. In a step, one UAV after the other flies its action and pays for it from its budget; if it has neither landed nor crashed
with that, the mission then covers or collects with it. On a UAV's terminal step nothing is covered or collected. A single UAV
is a team of one.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavbench.simulation.city_maps import CityWriter, margin_of
from uavbench.simulation.missions import Mission
from uavbench.simulation.moves import move, move_apart, write_masks, write_safe_masks, wrong_action
from uavbench.simulation.options import is_anywhere, read_budget, read_noise, read_start, read_uavs
from uavbench.simulation.outcomes import outcome_of, outcomes_of
from uavbench.simulation.slots import SimulatorState, put, take
from uavbench.simulation.starts import draw_starts, scatter_starts
from uavbench.simulation.state import State, new_state
from uavbench.world.cities import city_at, city_keys
from uavbench.world.city import NUM_ACTIONS, City, city_of
from uavbench.world.episode import Columns, check_number, episode_keys, frozen_columns
from uavbench.world.resources import scenario_paths
from uavbench.world.scenario import SPLITS, Scenario, ScenarioError, SplitName

_CUSTOM = len(SPLITS)  # the code of an episode set by hand; the code of any other is the index of its split in SPLITS
_NAMES: tuple[str, ...] = (*SPLITS, "custom")
_REDRAWN = 8  # frozen episodes that are drawn again, to check that they belong to the scenario as it is now


class Simulator:
    """A batch of episodes of one scenario.

    Parameters
    ----------
    scenario : Scenario
        What is simulated.
    num_envs : int
        Size B of the batch: the number of slots, each of which holds one episode at a time.
    threads : int
        How many threads share the slots of a step. The results do not depend on it, to the last bit.

    Attributes
    ----------
    slots : ndarray of int64, shape (B,)
        The numbers of all slots.
    state : State
        The state of all slots; `step` and the resets change it in place.
    mission : Mission
        The mission, with its own arrays.
    """

    #: Name of the split of an episode set by hand; its number is −1.
    CUSTOM = _NAMES[_CUSTOM]

    def __init__(self, scenario: Scenario, num_envs: int, threads: int = 1) -> None:
        self.scenario = scenario
        self.num_envs = num_envs
        self.threads = threads
        self.state: State = new_state(scenario, num_envs, scenario.max_uavs)
        self.mission: Mission = scenario.mission.make(scenario, num_envs)
        self.mission.threads = threads
        self.slots = np.arange(num_envs)
        self._splits = np.full(num_envs, _CUSTOM, dtype=np.int64)
        self._numbers = np.full(num_envs, -1, dtype=np.int64)
        self._fitting: set[str] = set()  # splits whose frozen episodes have been checked against the scenario
        self._only_city = city_of(scenario) if scenario.cities is None else None
        self._cities = CityWriter(scenario, self.state.maps)
        self._last_cities: dict[int, tuple[np.uint64, City]] = {}  # by slot: the last one that was asked for, and its key
        self._homes: NDArray[np.int32] | None = None  # the distances to landing in each slot's city, once they are needed
        self._homes_keys = self._cities.keys.copy()
        rewards = scenario.rewards
        state, self._margin = self.state, margin_of(scenario)
        self._maps = (state.maps.city, state.maps.ground, self._margin)
        self._landing_cells = np.full(2, -1), np.empty((scenario.shape[0] * scenario.shape[1], 2), dtype=np.int32)
        self._moved = (  # what `move` takes, listed once: the arrays are never reallocated
            state.position,
            state.previous,
            state.budget,
            state.blocked,
            state.landed,
            state.done,
            state.reward,
            *self._maps,
            rewards.movement,
            rewards.safety,
            rewards.crash,
        )
        self._shape = (num_envs, scenario.max_uavs) if scenario.team else (num_envs,)
        self._mask_shape = (num_envs, scenario.max_uavs, NUM_ACTIONS)

    @property
    def city(self) -> City:
        """The only city of the scenario.

        Raises
        ------
        ValueError
            When the scenario has many cities: `city_at` returns the city of a slot.
        """
        if self._only_city is None:
            raise ValueError(f"{self.scenario.id} has many cities: city_at(i) returns the city of slot i")
        return self._only_city

    def city_at(self, i: int) -> City:
        """Return the city of the episode in slot ``i``."""
        if self._only_city is not None:
            return self._only_city
        key = self._cities.keys[i]
        if i not in self._last_cities or self._last_cities[i][0] != key:
            self._last_cities[i] = key, city_at(self.scenario, key)
        return self._last_cities[i][1]

    def reset(self, index: ArrayLike, split: SplitName, numbers: ArrayLike) -> None:
        """Start the episodes ``numbers`` of ``split`` in the slots ``index``.

        Parameters
        ----------
        index, numbers : array_like of int, shape (K,)
            Slots, and for each the number of its episode.
        split : {"train", "validation", "test"}
            The split.

        Raises
        ------
        ValueError
            When the split has no episode with such a number. Nothing is changed then.
        """
        slots = np.asarray(index, dtype=np.int64)
        wanted = np.asarray(numbers, dtype=np.int64)
        listed: list[int] = wanted.tolist()
        for number in (min(listed), max(listed)):
            check_number(self.scenario, split, number)
        frozen = frozen_columns(self.scenario, split)
        if frozen is None:
            self.sample(slots, episode_keys(split, wanted))
        else:
            if split not in self._fitting:
                self._check_fit(split, frozen)
            self._restore(slots, {name: column[wanted] for name, column in frozen.items()})
        self._splits[slots] = SPLITS.index(split)
        self._numbers[slots] = wanted

    def episode(self, i: int) -> tuple[str, int]:
        """Return split and number of the episode in slot ``i``; ``("custom", -1)`` if it was set by hand."""
        return _NAMES[int(self._splits[i])], int(self._numbers[i])

    def episode_code(self, i: int) -> tuple[np.int64, np.int64]:
        """Return the index in `SPLITS` of the split of the episode in slot ``i``, and its number; 3 and −1 if set by hand."""
        return self._splits[i], self._numbers[i]

    def episodes(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the indices in `SPLITS` of the splits of all slots' episodes, and their numbers; 3 and −1 if set by hand."""
        return self._splits.copy(), self._numbers.copy()

    def sample(self, index: NDArray[np.int64], keys: NDArray[np.uint64]) -> None:
        """Start the episodes of ``keys`` in the slots ``index``, drawn from the keys even if they are frozen."""
        self._cities.enter(index, keys)
        state = self.state
        state.key[index] = keys
        if self._only_city is None:  # the map of a slot may be that of another city now
            self._landing_cells[0][0] = -1
        draw_starts(
            index,
            state.key,
            state.uavs,
            state.position,
            state.previous,
            state.budget,
            state.initial_budget,
            state.blocked,
            state.landed,
            state.done,
            state.noise,
            state.reward,
            *self._maps,
            *self.scenario.budget,
            *(self.scenario.uavs or (1, 1)),
            *self._landing_cells,
        )
        self.mission.sample(state, index)

    def scatter(self, index: NDArray[np.int64]) -> None:
        """Move the UAVs of the episodes just started in the slots ``index`` to random cells, with budgets that suffice to land.

        For training: a learner then sees states that it would seldom reach. Distinct cells, and budgets up to the scenario's
        largest, are drawn from the episode's key.
        """
        state, slots = self.state, np.asarray(index, dtype=np.int64)
        arrays = (state.key, state.uavs, state.position, state.previous, state.budget, state.initial_budget)
        for together in [slots] if self._only_city else slots[:, None]:
            if len(together):
                home = self.city_at(int(together[0])).distance_to_landing
                free = np.argwhere(home >= 0).astype(np.int32)
                scatter_starts(together, *arrays, free, home, self.scenario.budget[1])
        self._splits[index], self._numbers[index] = _CUSTOM, -1

    def get_state(self, index: ArrayLike | None = None) -> SimulatorState:
        """Return everything that changes in the slots ``index``, as fresh arrays.

        Parameters
        ----------
        index : array_like of int, shape (K,), optional
            Slots; all of them by default.

        Raises
        ------
        ValueError, IndexError
            When ``index`` does not name slots.
        """
        return take(self.scenario.digest, self._arrays(), index)

    def set_state(self, state: SimulatorState, index: ArrayLike | None = None) -> None:
        """Put the slots ``index`` into a state from `get_state`: the same actions then have the same results, bit for bit.

        Parameters
        ----------
        state : SimulatorState
            A state of as many slots as ``index`` names, or of one slot, which all of them then get. It may come from any
            simulator of the same scenario.
        index : array_like of int, shape (K,), optional
            Slots; all of them by default.

        Raises
        ------
        ValueError, IndexError
            When the state belongs to another scenario or has another number of slots, or ``index`` does not name slots.
            Nothing is changed then.
        """
        put(state, self.scenario.digest, self._arrays(), index)
        slots = self.slots if index is None else np.asarray(index, dtype=np.int64)
        self._cities.enter(slots, self.state.key[slots])

    def snapshot(self) -> Columns:
        """Return everything that changes, as fresh arrays by name, to be saved in a file: `resume` continues from them."""
        return self.get_state().arrays

    def resume(self, arrays: Columns) -> None:
        """Continue from a `snapshot` of a simulator of the same scenario and size; a ValueError says what differs."""
        self.set_state(SimulatorState(self.scenario.digest, arrays))

    def _arrays(self) -> Columns:
        """Return all arrays that change, the simulator's own and the mission's, with a row for each slot."""
        own = {"splits": self._splits, "numbers": self._numbers}
        return {**self.state.arrays(), **own, **{f"mission.{name}": array for name, array in self.mission.arrays().items()}}

    def columns(self) -> Columns:
        """Return the episodes just started in all slots as columns of a table, as a frozen file holds them."""
        columns = self._columns(np.arange(self.num_envs))
        if not self.scenario.team:
            del columns["uavs"]
            columns["start"], columns["budget"] = columns["start"][:, 0], columns["budget"][:, 0]
        return {name: column.astype(np.int16) if column.dtype == np.int32 else column for name, column in columns.items()}

    def customise(self, i: int, options: Mapping[str, Any]) -> None:
        """Set by hand what ``options`` name in the episode just started in slot ``i``; the rest stays as drawn.

        Parameters
        ----------
        i : int
            The slot.
        options : mapping
            ``start`` (row, column), ``"anywhere"`` as `scatter` does, or ``"landing"`` as drawn; ``budget``; ``targets`` (CPP:
            a mask, shape (M, N)) or ``devices`` (DH: rows of row, column, data); ``noise`` (DH: False switches shadow fading
            off). In teams also ``num_uavs``, a list of starts, and a budget for all or a list of them.

        Raises
        ------
        ValueError
            When a value does not fit the scenario. Nothing is changed then.
        """
        noise, options, anywhere = read_noise(options), dict(options), is_anywhere(options)
        if isinstance(options.get("start"), str):
            del options["start"]
        changed = {"num_uavs", "start", "budget", self.mission.option} & options.keys()
        before = self.get_state([i]) if anywhere else None
        if anywhere:
            self.scatter(np.array([i]))
        try:
            if changed:
                self._restore(np.array([i]), self._parse(i, options))
        except ValueError:
            if before is not None:
                self.set_state(before, [i])
            raise
        if changed or not noise:
            self._splits[i], self._numbers[i] = _CUSTOM, -1
        self.state.noise[i] = noise

    def step(self, actions: ArrayLike) -> None:
        """Fly one action with every UAV, in their order. UAVs that have landed or crashed do nothing and get a reward of 0.

        Parameters
        ----------
        actions : array_like of int, shape (B,), in teams (B, U)
            0 north, 1 east, 2 south, 3 west, 4 hover, 5 land.

        Raises
        ------
        ValueError
            When an action is out of range or the shape is wrong. Nothing is changed then.
        """
        chosen = np.asarray(actions)
        if chosen.shape != self._shape or chosen.dtype.kind not in "iu":
            raise ValueError(f"actions: {chosen.dtype} of shape {chosen.shape}, expected integers, {self._shape}")
        checked = chosen.astype(np.int64, order="C").reshape(self.num_envs, -1)
        wrong = wrong_action(checked)
        if wrong >= 0:
            raise ValueError(f"actions: {chosen.flat[wrong]} is not an action from 0 to {NUM_ACTIONS - 1}")
        self.fly(checked)

    def fly(self, actions: NDArray[np.int64]) -> None:
        """Do what `step` does, without checking ``actions``: a contiguous array, shape (B, U), of numbers from 0 to 5."""
        for uav in range(actions.shape[1]):
            if self.threads > 1:
                move_apart(self.threads, uav, actions, *self._moved)
            else:
                move(0, self.num_envs, uav, actions, *self._moved)
            self.mission.collect(self.state, uav)

    def outcomes(self, index: ArrayLike | None = None) -> dict[str, NDArray[Any]]:
        """Return the metrics of the episodes in the slots ``index`` (all of them by default), each of shape (K,).

        Returns
        -------
        dict
            ``landed`` (bool: whether every UAV has landed), ``cr`` and ``cral`` (float64, in [0, 1]), ``blocked`` (int64: how
            often UAVs were blocked, summed over the team).
        """
        return outcomes_of(self.state, self.slots if index is None else np.asarray(index, dtype=np.int64))

    def outcome(self, i: int) -> dict[str, bool | float | int]:
        """Return the metrics of the episode in slot ``i``, those of `outcomes`, as Python numbers."""
        return outcome_of(self.state, i)

    def action_mask(self) -> NDArray[np.int8]:
        """Return the valid actions as a new array of 0 and 1, shape (B, 6), in teams (B, U, 6).

        UAVs decide at the same time and move in order. So a move to the cell of a UAV that moves later is not valid, because it
        is blocked. A move to the cell of a UAV that moves earlier is valid, because the cell may be free by then.
        """
        mask = np.empty(self._mask_shape, dtype=np.int8)
        write_masks(self.state.position, self.state.done, *self._maps, mask)
        return mask.reshape(*self._shape, NUM_ACTIONS)

    def safe_action_mask(self) -> NDArray[np.int8]:
        """Return the safe actions, shape (B, 6), in teams (B, U, 6), freshly allocated: see `City.safe_action_mask`.

        In a team each UAV is looked at alone: another UAV may still stand in its way.
        """
        mask = np.empty(self._mask_shape, dtype=np.int8)
        write_safe_masks(self.state.position, self.state.budget, *self._maps, self._distances_to_landing(), mask)
        return mask.reshape(*self._shape, NUM_ACTIONS)

    def _distances_to_landing(self) -> NDArray[np.int32]:
        """Return the distances to landing in the cities of all slots, shape (C, M, N)."""
        if self._only_city is not None:
            return self._only_city.distance_to_landing[None]
        if self._homes is None:
            self._homes = np.zeros((self.num_envs, *self.scenario.shape), dtype=np.int32)
        for i in np.flatnonzero(self._homes_keys != self._cities.keys).tolist():
            self._homes[i] = self.city_at(i).distance_to_landing
        self._homes_keys[:] = self._cities.keys
        return self._homes

    def _parse(self, i: int, options: Mapping[str, Any]) -> Columns:
        """Return the episode just started in slot ``i`` as columns, changed as ``options`` say."""
        scenario, columns = self.scenario, self._columns(np.array([i]))
        uavs = read_uavs(options, scenario, int(self.state.uavs[i]))
        columns["uavs"][0] = uavs
        if "start" in options:
            columns["start"][0, :uavs] = read_start(options["start"], scenario, self.city_at(i), uavs)
        if "budget" in options:
            columns["budget"][0, :uavs] = read_budget(options["budget"], scenario, uavs)
        if self.mission.option in options:
            columns.update(self.mission.parse(options[self.mission.option], self.city_at(i)))
        return columns

    def _check_fit(self, split: SplitName, frozen: Columns) -> None:
        """Refuse frozen episodes that do not fit the scenario, because it was edited after they were frozen."""
        low, high = self.scenario.budget
        budget, uavs = frozen["budget"], frozen["start"].size // 2 // len(frozen["budget"])
        fits = ("uavs" in frozen) == self.scenario.team and uavs >= self.scenario.max_uavs
        fits = fits and budget.min() >= low and budget.max() <= high
        cities = city_keys(self.scenario, frozen["key"])
        for key in np.unique(cities):
            there = {name: column[cities == key] for name, column in frozen.items()}
            fits = fits and self._fit_in_city(there, self._only_city or city_at(self.scenario, key))
        if not fits or not self._draws(frozen):
            raise ScenarioError(
                f"{self.scenario.path}: splits.{split}.file: its episodes do not fit the scenario, which has changed "
                "since they were frozen: choose a new id, remove the [splits] that name files and [cities.frozen], if there is "
                "one, and run uavbench freeze; or, if nobody has seen a result yet, uavbench freeze --replace"
            )
        self._fitting.add(split)

    def _fit_in_city(self, frozen: Columns, city: City) -> bool:
        """Return whether frozen episodes can take place in ``city``."""
        start = frozen["start"].reshape(-1, 2)
        on_map = (start >= 0).all() and (start < np.array(city.shape)).all()
        return bool(on_map and city.landing[start[:, 0], start[:, 1]].all()) and self.mission.fits(frozen, city)

    def _draws(self, frozen: Columns) -> bool:
        """Return whether the scenario draws the same first frozen episodes from their keys.

        Without this check, frozen episodes would still fit a scenario whose range of budgets was made wider. Shipped scenarios
        are not checked: their files stay valid even if a generator changes.
        """
        if scenario_paths().get(self.scenario.id) == self.scenario.path:
            return True
        keys = frozen["key"][:_REDRAWN]
        again = Simulator(self.scenario, len(keys))
        again.sample(np.arange(len(keys)), keys)
        drawn = again.columns()
        return drawn.keys() == frozen.keys() and all(
            column.shape == frozen[name][: len(keys)].shape
            and np.allclose(column, frozen[name][: len(keys)], rtol=1e-9, atol=0)
            for name, column in drawn.items()
        )

    def _columns(self, index: NDArray[np.int64]) -> Columns:
        """Return the episodes just started in the slots ``index`` as columns of a table."""
        state = self.state
        return {
            "key": state.key[index],
            "uavs": state.uavs[index],
            "start": state.position[index],
            "budget": state.initial_budget[index],
            **self.mission.columns(state, index),
        }

    def _restore(self, index: NDArray[np.int64], columns: Columns) -> None:
        """Start the episodes that the rows of ``columns`` describe in the slots ``index``."""
        state = self.state
        min_uavs, max_uavs = self.scenario.uavs or (1, 1)
        self._cities.enter(index, np.asarray(columns["key"], dtype=np.uint64))
        state.key[index] = columns["key"]
        # `Scenario.with_uavs` may ask for more or fewer than the frozen episode has.
        state.uavs[index] = np.clip(columns.get("uavs", 1), min_uavs, max_uavs)
        state.position[index] = state.previous[index] = columns["start"].reshape(len(index), -1, 2)[:, :max_uavs]
        state.budget[index] = state.initial_budget[index] = columns["budget"].reshape(len(index), -1)[:, :max_uavs]
        state.blocked[index] = 0
        state.landed[index] = state.done[index] = np.arange(max_uavs) >= state.uavs[index, None]
        state.noise[index] = True
        state.reward[index] = 0.0
        self.mission.restore(state, index, columns)
