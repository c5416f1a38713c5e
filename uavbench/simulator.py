"""The simulator: a batch of episodes, reset from keys and stepped by the rules of the world.

Source: the paper's eqs. (1) and (2), with uavSim settling what they leave open. A step is: move, pay the budget, end or
not, and, where the UAV flies on, let the mission cover or collect. On a terminal step nothing is covered.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavbench.city import HOVER, LAND, NUM_ACTIONS, OFFSETS, City, city_of
from uavbench.episode import Columns, check_number, episode_keys, frozen_columns
from uavbench.kernel import kernel
from uavbench.keyed import START, next_integer, stream
from uavbench.missions import mission_of
from uavbench.scenario import SPLITS, Scenario, ScenarioError, SplitName
from uavbench.state import State, new_state

_CUSTOM = -1


class Simulator:
    """A batch of episodes of one scenario.

    Parameters
    ----------
    scenario : Scenario
        What is simulated.
    num_envs : int
        Size B of the batch: the number of slots, each of which holds one episode at a time.

    Attributes
    ----------
    city : City
        The static world.
    state : State
        The state of all slots; `step` and the resets change it in place.
    mission : Mission
        The mission, with the arrays that are its own.
    """

    #: Name of the split of an episode set by hand; its number is −1.
    CUSTOM = "custom"

    def __init__(self, scenario: Scenario, num_envs: int) -> None:
        self.scenario = scenario
        self.num_envs = num_envs
        self.city: City = city_of(scenario)
        self.state: State = new_state(num_envs, self.city.shape)
        self.mission = mission_of(scenario, self.city, num_envs)
        self._splits = np.full(num_envs, _CUSTOM, dtype=np.int64)
        self._numbers = np.full(num_envs, -1, dtype=np.int64)
        self._fitting: set[str] = set()  # splits whose frozen episodes were found to be this scenario's
        rewards = scenario.rewards
        self._rewards = (rewards.movement, rewards.safety, rewards.crash)

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
            When the split has no episode of such a number. Nothing is changed then.
        """
        slots = np.asarray(index, dtype=np.int64)
        wanted = np.asarray(numbers, dtype=np.int64)
        for number in (wanted.min(), wanted.max()):
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
        """Return split and number of the episode in slot ``i``; ``("custom", -1)`` when it was set by hand."""
        split = int(self._splits[i])
        return (SPLITS[split] if split >= 0 else self.CUSTOM), int(self._numbers[i])

    def sample(self, index: NDArray[np.int64], keys: NDArray[np.uint64]) -> None:
        """Draw the episodes of ``keys`` in the slots ``index``, frozen or not."""
        self.state.key[index] = keys
        _start(self.state, index, self.city.landing_cells, *self.scenario.budget)
        self.mission.sample(self.state, index)

    def columns(self) -> Columns:
        """Return the episodes of all slots as they started, as columns of a table: what a frozen file holds."""
        columns = self._columns(np.arange(self.num_envs))
        return {name: column.astype(np.int16) if column.dtype == np.int32 else column for name, column in columns.items()}

    def customise(self, i: int, options: Mapping[str, Any]) -> None:
        """Set by hand what ``options`` names in the episode just started in slot ``i``; the rest stays as drawn.

        Parameters
        ----------
        i : int
            The slot.
        options : mapping
            ``start`` (row, column), ``budget``, ``targets`` (CPP: a mask, shape (M, N)) or ``devices`` (DH: rows of row,
            column, data), ``noise`` (DH: False switches shadow fading off).

        Raises
        ------
        ValueError
            When a value does not fit the scenario. Nothing is changed then.
        """
        chosen: Columns = {}
        if "start" in options:
            chosen["start"] = self._parse_start(options["start"])
        if "budget" in options:
            chosen["budget"] = self._parse_budget(options["budget"])
        if self.mission.option in options:
            chosen.update(self.mission.parse(options[self.mission.option]))
        noise = options.get("noise", True)
        if not isinstance(noise, bool | np.bool_):
            raise ValueError(f"noise: {noise!r} is not True or False")
        if chosen:
            self._restore(np.array([i]), {**self._columns(np.array([i])), **chosen})
            self._splits[i], self._numbers[i] = _CUSTOM, -1
        self.state.noise[i] = noise

    def step(self, actions: ArrayLike) -> None:
        """Fly one action in every slot; in a slot whose episode has ended nothing happens, for a reward of 0.

        Parameters
        ----------
        actions : array_like of int, shape (B,)
            0 north, 1 east, 2 south, 3 west, 4 hover, 5 land.

        Raises
        ------
        ValueError
            When an action is out of range or the shape is wrong. Nothing is changed then.
        """
        chosen = np.asarray(actions)
        if chosen.shape != (self.num_envs,) or chosen.dtype.kind not in "iu":
            raise ValueError(f"actions: {chosen.dtype} of shape {chosen.shape}, expected integers, ({self.num_envs},)")
        wrong = _move(self.state, chosen.astype(np.int64), self.city.landing, self.city.no_fly, *self._rewards)
        if wrong >= 0:
            raise ValueError(f"actions: {chosen[wrong]} is not an action from 0 to {NUM_ACTIONS - 1}")
        self.mission.collect(self.state)

    def outcomes(self, index: ArrayLike) -> dict[str, NDArray[Any]]:
        """Return the metrics of the episodes in the slots ``index``, each of shape (K,).

        Returns
        -------
        dict
            ``landed`` (bool), ``cr`` and ``cral`` (float64, in [0, 1]), ``blocked`` (int64).
        """
        slots, state = np.asarray(index, dtype=np.int64), self.state
        landed, total = state.landed[slots], state.total[slots]
        cr = (total - state.remaining[slots]) / total
        return {"landed": landed, "cr": cr, "cral": cr * landed, "blocked": state.blocked[slots].astype(np.int64)}

    def action_mask(self) -> NDArray[np.int8]:
        """Return which actions have their effect in each slot, shape (B, 6), freshly allocated."""
        return self.city.action_mask[self.state.position[:, 0], self.state.position[:, 1]]

    def _check_fit(self, split: SplitName, frozen: Columns) -> None:
        """Refuse frozen episodes of another map or other parameters: somebody has edited the scenario since."""
        low, high = self.scenario.budget
        start, budget = frozen["start"], frozen["budget"]
        on_map = (start >= 0).all() and (start < np.array(self.city.shape)).all()
        fits = on_map and self.city.landing[start[:, 0], start[:, 1]].all()
        if not fits or budget.min() < low or budget.max() > high or not self.mission.fits(frozen):
            raise ScenarioError(
                f"{self.scenario.path}: splits.{split}.file: its episodes do not fit the scenario, which has changed since "
                "they were frozen: freeze it again"
            )
        self._fitting.add(split)

    def _columns(self, index: NDArray[np.int64]) -> Columns:
        """Return the episodes in the slots ``index`` as they are now, as columns of a table."""
        state = self.state
        return {
            "key": state.key[index],
            "start": state.position[index],
            "budget": state.budget[index],
            **self.mission.columns(state, index),
        }

    def _restore(self, index: NDArray[np.int64], columns: Columns) -> None:
        """Start the episodes of the rows of ``columns`` in the slots ``index``."""
        state = self.state
        state.key[index] = columns["key"]
        state.position[index] = state.previous[index] = columns["start"]
        state.budget[index] = state.initial_budget[index] = columns["budget"]
        state.blocked[index] = 0
        state.landed[index] = state.done[index] = False
        state.noise[index] = True
        state.reward[index] = 0.0
        self.mission.restore(state, index, columns)

    def _parse_start(self, value: Any) -> NDArray[np.int32]:
        try:
            cell = np.asarray(value)
        except ValueError:
            raise ValueError(f"start: {value!r} is not a cell [row, column] of two integers") from None
        if cell.shape != (2,) or cell.dtype.kind not in "iu":
            raise ValueError(f"start: {value!r} is not a cell [row, column] of two integers")
        r, c = cell.tolist()
        rows, cols = self.city.shape
        if not (0 <= r < rows and 0 <= c < cols):
            raise ValueError(f"start: ({r}, {c}) is off the {rows}×{cols} map")
        if not self.city.landing[r, c]:
            raise ValueError(f"start: ({r}, {c}) is outside the landing zones; episodes start in one")
        return cell.astype(np.int32).reshape(1, 2)

    def _parse_budget(self, value: Any) -> NDArray[np.int32]:
        most = self.scenario.budget[1]
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 1 <= value <= most:
            raise ValueError(f"budget: {value!r} is not an integer from 1 to {most}, the scenario's largest")
        return np.array([value], dtype=np.int32)


@kernel
def _start(state: State, index: NDArray[np.int64], landing_cells: NDArray[np.int32], low: int, high: int) -> None:
    """Draw the start cells and budgets of the slots ``index``, and clear what an earlier episode left."""
    cursor = np.empty(1, dtype=np.uint64)
    for n in range(len(index)):
        i = int(index[n])
        cursor[0] = stream(state.key[i], START)
        cell = landing_cells[next_integer(cursor, len(landing_cells))]
        state.position[i] = cell
        state.previous[i] = cell
        state.budget[i] = state.initial_budget[i] = low + next_integer(cursor, high - low + 1)
        state.blocked[i] = 0
        state.landed[i] = state.done[i] = False
        state.noise[i] = True
        state.reward[i] = 0.0


@kernel
def _move(
    state: State,
    actions: NDArray[np.int64],
    landing: NDArray[np.bool_],
    no_fly: NDArray[np.bool_],
    movement: float,
    safety: float,
    crash: float,
) -> int:
    """Move every UAV that flies, pay its budget, and reward everything but the gain.

    Returns the first slot whose action is out of range, in which case nothing is moved, or −1.
    """
    for i in range(len(actions)):
        if actions[i] < 0 or actions[i] > LAND:
            return i
    rows, cols = no_fly.shape
    for i in range(len(state.done)):
        if state.done[i]:
            state.reward[i] = 0.0
            continue
        action = actions[i]
        r, c = state.position[i, 0], state.position[i, 1]
        state.previous[i, 0], state.previous[i, 1] = r, c
        stayed = True
        if action == LAND:
            state.landed[i] = landing[r, c]
        elif action != HOVER:
            y, x = r + OFFSETS[action, 0], c + OFFSETS[action, 1]
            if 0 <= y < rows and 0 <= x < cols and not no_fly[y, x]:
                state.position[i, 0], state.position[i, 1] = y, x
                stayed = False
            else:
                state.blocked[i] += 1
        state.budget[i] -= 1
        reward = 0.0
        if not state.landed[i]:
            reward += movement
            if stayed and action != HOVER:
                reward += safety
            if state.budget[i] == 0:
                reward += crash
        state.reward[i] = reward
        state.done[i] = state.landed[i] or state.budget[i] == 0
    return -1
