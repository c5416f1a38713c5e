"""Advice for learners: what each action is worth to a UAV in any state, by the best flights that are found.

A `Teacher` keeps a plan for each episode, whatever the learner does. When a UAV has left its plan, it returns to it by a
shortest path, and a short search improves the plan for what is left. An action is worth what is covered or collected by the
best flight that begins with it and then returns to the plan. So actions that are equally good have equal worths, while a plan
alone would name one of them (Ross and Bagnell, "Reinforcement and imitation learning via interactive no-regret learning",
2014, learn from such worths).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.planning import coverage, harvesting
from uavbench.planning.distances import Distances, distances_of, is_large, moves
from uavbench.planning.flights import landing_numbers, pack
from uavbench.planning.paths import walk
from uavbench.planning.rates import RankedRates
from uavbench.planning.views import Views, enter, leave, views_of
from uavbench.simulation.simulator import Simulator
from uavbench.world.city import LAND, NUM_ACTIONS, City
from uavbench.world.kernel import kernel
from uavbench.world.scenario import Scenario

_BACK = 10  # the farthest cell of a plan to which a flight with another first action returns
#: The worth of an action that is not valid or not safe.
NEVER = -1e9


class Teacher:
    """Advises the UAVs of a simulator.

    Parameters
    ----------
    scenario : Scenario
        A CPP or DH scenario with maps of at most 64×64 cells.
    num_envs : int
        Number of slots.
    first, mending : int
        How many changes are tried for the first plan of an episode, and at every later step.
    heat : float
        Initial temperature of the later searches, in target cells or data units.

    Raises
    ------
    ValueError
        When the maps are too large.
    """

    def __init__(self, scenario: Scenario, num_envs: int, *, first: int, mending: int, heat: float = 0.3) -> None:
        if is_large(scenario.shape):
            raise ValueError(f"{scenario.id}: its maps are too large for a teacher, which plans on maps of up to 64×64 cells")
        self._scenario, self._first, self._mending, self._heat = scenario, first, mending, heat
        self._harvests = scenario.mission.kind == "harvesting"
        width = scenario.budget[1] + scenario.shape[0] + scenario.shape[1] + 2
        self._paths = np.zeros((num_envs, scenario.max_uavs, width), dtype=np.int32)
        self._lengths = np.zeros((num_envs, scenario.max_uavs), dtype=np.int64)
        self._cursors = np.zeros((num_envs, 1), dtype=np.uint64)
        self._rates: dict[int, tuple[NDArray[np.int32], RankedRates]] = {}

    def begin(self, simulator: Simulator, slots: Sequence[int]) -> None:
        """Plan the flights of the episodes that have just started in ``slots``."""
        state = simulator.state
        for i in slots:
            city = simulator.city_at(i)
            self._cursors[i] = state.key[i]
            there = int(state.uavs[i])
            starts = [(int(r), int(c)) for r, c in state.position[i, :there]]
            paths, lengths = pack(city, starts, state.budget[i, :there].tolist(), None, self._cursors[i])
            self._paths[i, :there, : paths.shape[1]], self._lengths[i, :there] = paths, lengths
            self._note_rates(simulator, i)
            self._search(simulator, i, city, self._first, self._hot)

    def _note_rates(self, simulator: Simulator, i: int) -> None:
        """Compute the expected rates of the devices of an episode, those that are empty included."""
        if self._harvests:
            devices = simulator.state.spots[i, : simulator.state.num_spots[i]].copy()
            rates = harvesting.rates_for(self._scenario, devices, simulator.city_at(i))
            assert isinstance(rates, RankedRates)
            self._rates[i] = devices, rates

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that changes, as fresh arrays by name."""
        return {"paths": self._paths.copy(), "lengths": self._lengths.copy(), "cursors": self._cursors.copy()}

    def resume(self, arrays: Mapping[str, NDArray[Any]], simulator: Simulator) -> None:
        """Continue from a `snapshot`, with a simulator that is as it was then."""
        self._paths[:], self._lengths[:], self._cursors[:] = (arrays[name] for name in ("paths", "lengths", "cursors"))
        for i in range(len(self._paths)):
            self._note_rates(simulator, i)

    def worths(self, simulator: Simulator, slots: Sequence[int]) -> NDArray[np.float64]:
        """Return what the actions are worth to the UAVs of running episodes, which move on from where they are now.

        Returns
        -------
        ndarray of float64, shape (K, U, 6)
            For each of the K ``slots``: what the whole team still covers (cells) or collects (data units) if the UAV begins
            with the action, less a small price for each move; −1e9 for actions that are not valid or not safe, and for UAVs
            that are done or cannot land any more. Validity and safety do not consider other UAVs.
        """
        worths = np.full((len(slots), self._scenario.max_uavs, NUM_ACTIONS), NEVER)
        for k, i in enumerate(slots):
            self._search(simulator, i, simulator.city_at(i), self._mending, self._heat, worths[k])
        return worths

    @property
    def _hot(self) -> float:
        return harvesting.HOT if self._harvests else coverage.HOT

    def _search(
        self, simulator: Simulator, i: int, city: City, changes: int, hot: float, worths: NDArray[np.float64] | None = None
    ) -> None:
        """Improve the plan of slot ``i`` from where its UAVs are, and write the worths of their actions, if they are wanted."""
        state = simulator.state
        away = city.distance_to_landing[state.position[i, :, 0], state.position[i, :, 1]]
        flying = np.flatnonzero(~state.done[i] & (away + 1 <= state.budget[i]))
        if not len(flying):
            return
        paths, lengths = self._paths[i, flying], self._lengths[i, flying]
        here = state.position[i, flying].astype(np.int64) @ np.array([city.shape[1], 1])
        longest = state.budget[i, flying].astype(np.int64) - 1
        distance, landing, cursor = distances_of(city), landing_numbers(city), self._cursors[i]
        _rejoin(paths, lengths, here, longest, distance, city.shape[1], landing, cursor)
        fixed = longest, distance, city.shape, landing
        found = np.full((len(flying), NUM_ACTIONS), NEVER)
        if self._harvests:
            devices, rates = self._rates[i]
            cells = devices.astype(np.int64) @ np.array([city.shape[1], 1])
            data = state.target[i].reshape(-1)[cells].astype(np.float64)
            harvesting.anneal(paths, lengths, *fixed, cells, rates, data, cursor, changes, hot, paths.shape[1], 0.0)
            if worths is not None:
                _harvesting_worths(paths, lengths, *fixed, city.no_fly, rates, data, cursor, found)
        else:
            views = views_of(self._scenario, state.target[i], city)
            targets = np.flatnonzero(state.target[i] > 0)
            coverage.anneal(paths, lengths, *fixed, views, targets, cursor, changes, hot, 0.0)
            if worths is not None:
                _coverage_worths(paths, lengths, *fixed, city.no_fly, views, len(targets), cursor, found)
        self._paths[i, flying], self._lengths[i, flying] = paths, lengths
        if worths is not None:
            worths[flying] = found


@kernel
def _rejoin(
    paths: NDArray[np.int32],
    lengths: NDArray[np.int64],
    here: NDArray[np.int64],
    longest: NDArray[np.int64],
    distance: Distances,
    cols: int,
    landing: NDArray[np.int32],
    cursor: NDArray[np.uint64],
) -> None:
    """Let each path begin at the cell ``here`` of its UAV, and return to its early cells if the budget allows it.

    Where it does not, the path leads to the nearest landing cell.
    """
    new = np.empty(paths.shape[1], dtype=np.int32)
    for u in range(len(paths)):
        path, length = paths[u], lengths[u]
        best, least = -1, 2 * len(path)
        for k in range(length + 1):
            away = moves(distance, cols, here[u], path[k])
            if away >= 0 and away + length - k <= longest[u] and away + k < least:
                best, least = k, away + k
        if best < 0:
            best, length, path[0] = 0, 0, _nearest(distance, cols, here[u], landing)
        size = walk(distance, cols, here[u], path[best], True, cursor, new, 0)
        rest = length - best
        new[size : size + rest] = path[best + 1 : length + 1]
        path[0] = here[u]
        path[1 : size + rest + 1] = new[: size + rest]
        lengths[u] = size + rest


@kernel
def _nearest(distance: Distances, cols: int, here: int, cells: NDArray[np.int32]) -> int:
    """Return the nearest of some cells; the first of them where there is no path to any."""
    goal, least = cells[0], np.iinfo(np.int32).max
    for cell in cells:
        away = moves(distance, cols, here, cell)
        if 0 <= away < least:
            goal, least = cell, away
    return int(goal)


@kernel
def _next_cell(here: int, action: int, no_fly: NDArray[np.bool_]) -> int:
    """Return the cell to which a move or hovering leads; −1 if it is blocked."""
    rows, cols = no_fly.shape
    r = here // cols + (-1, 0, 1, 0, 0)[action]
    c = here % cols + (0, 1, 0, -1, 0)[action]
    if not (0 <= r < rows and 0 <= c < cols) or no_fly[r, c]:
        return -1
    return r * cols + c


@kernel
def _coverage_worths(
    paths: NDArray[np.int32],
    lengths: NDArray[np.int64],
    longest: NDArray[np.int64],
    distance: Distances,
    shape: tuple[int, int],
    landing: NDArray[np.int32],
    no_fly: NDArray[np.bool_],
    views: Views,
    targets: int,
    cursor: NDArray[np.uint64],
    worths: NDArray[np.float64],
) -> None:
    """Write the worths of all UAVs' actions, shape (U, 6), in CPP."""
    counts = np.zeros(max(1, targets), dtype=np.int32)
    new = np.empty(2 * paths.shape[1] + 2 * (shape[0] + shape[1]), dtype=np.int32)
    covered, cols = 0, shape[1]
    for u in range(len(paths)):
        covered += enter(paths[u], 1, lengths[u] + 1, -1, views, counts)
    for u in range(len(paths)):
        path, length = paths[u], lengths[u]
        others = coverage.LENGTH_PRICE * (lengths.sum() - length)
        alone = covered - leave(path, 1, length + 1, -1, views, counts)  # what the other UAVs cover
        if _is_in(path[0], landing):
            worths[u, LAND] = alone - others
        for action in range(LAND):  # home at once
            new[0] = _next_cell(path[0], action, no_fly)
            goal = _nearest(distance, cols, new[0], landing) if new[0] >= 0 else -1
            away = moves(distance, cols, new[0], goal) if goal >= 0 else -1
            if 0 <= away < longest[u]:
                size = walk(distance, cols, new[0], goal, True, cursor, new, 1)
                fresh = enter(new, 0, size, -1, views, counts)
                leave(new, 0, size, -1, views, counts)
                worths[u, action] = alone + fresh - coverage.LENGTH_PRICE * size - others
        enter(path, 1, length + 1, -1, views, counts)
        for action in range(LAND):
            new[0] = _next_cell(path[0], action, no_fly)
            if new[0] < 0:
                continue
            total, last = covered, min(length, _BACK)
            for k in range(last + 1):  # back to cell k of the plan, without those before it
                if k >= 1:
                    total -= leave(path, k, k + 1, path[k - 1] if k > 1 else -1, views, counts)
                away = moves(distance, cols, new[0], path[k])
                grown = 1 + away + length - k
                if away < 0 or grown > longest[u]:
                    continue
                size = walk(distance, cols, new[0], path[k], True, cursor, new, 1)
                fresh = enter(new, 0, size, -1, views, counts)
                leave(new, 0, size, -1, views, counts)
                worths[u, action] = max(worths[u, action], total + fresh - coverage.LENGTH_PRICE * grown - others)
            enter(path, 1, last + 1, -1, views, counts)


@kernel
def _harvesting_worths(
    paths: NDArray[np.int32],
    lengths: NDArray[np.int64],
    longest: NDArray[np.int64],
    distance: Distances,
    shape: tuple[int, int],
    landing: NDArray[np.int32],
    no_fly: NDArray[np.bool_],
    rates: RankedRates,
    data: NDArray[np.float64],
    cursor: NDArray[np.uint64],
    worths: NDArray[np.float64],
) -> None:
    """Write the worths of all UAVs' actions, shape (U, 6), in DH."""
    cols = shape[1]
    left, total = np.zeros((paths.shape[1], len(data))), np.zeros(paths.shape[1])
    left[0] = data
    trial = paths.copy()
    for u in range(len(paths)):
        path, length = paths[u], lengths[u]
        others = harvesting.LENGTH_PRICE * (lengths.sum() - length)
        for action in range(LAND):
            cell = _next_cell(path[0], action, no_fly)
            if cell < 0:
                continue
            for k in range(-1, min(length, _BACK) + 1):  # home at once, or back to cell k of the plan, without those between
                goal = path[k] if k >= 0 else _nearest(distance, cols, cell, landing)
                rest = length - k if k >= 0 else 0
                away = moves(distance, cols, cell, goal)
                grown = 1 + away + rest
                if away < 0 or grown > longest[u]:
                    continue
                trial[u, 1] = cell
                size = walk(distance, cols, cell, goal, True, cursor, trial[u], 2)
                trial[u, size : grown + 1] = path[length + 1 - rest : length + 1]
                lengths[u] = grown
                found = harvesting.simulate(trial, lengths, 1, cols, rates, left, total)
                worths[u, action] = max(worths[u, action], found - harvesting.LENGTH_PRICE * grown - others)
        if _is_in(path[0], landing):
            lengths[u] = 0
            worths[u, LAND] = harvesting.simulate(trial, lengths, 1, cols, rates, left, total) - others
        lengths[u] = length
        trial[u] = path


@kernel
def _is_in(cell: int, cells: NDArray[np.int32]) -> bool:
    """Return whether a cell is among others."""
    return bool((cells == cell).any())
