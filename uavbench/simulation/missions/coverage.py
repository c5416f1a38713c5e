"""Coverage path planning (CPP): fly so that the camera sees every target cell.

Source: Theile et al., ICAR 2021; the targets are those of uavSim.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from uavbench.simulation.city_maps import BUILDING_BIT, margin_of
from uavbench.simulation.missions import Mission
from uavbench.simulation.missions.camera import trees_of, view_from, views_from_all
from uavbench.simulation.missions.shapes import draw_shapes
from uavbench.simulation.pooling import count_targets, remove_target
from uavbench.simulation.state import State
from uavbench.world.city import City, city_of
from uavbench.world.episode import Columns
from uavbench.world.kernel import kernel, parallel_kernel, share
from uavbench.world.keyed import CONTENT, stream
from uavbench.world.parameters import Coverage
from uavbench.world.scenario import Scenario, ScenarioError
from uavbench.world.values import as_array, shown

_ATTEMPTS = 10_000  # redraws of the shapes before the scenario is refused; the paper's need about 3
_MIN_ATTEMPTS, _PAINTED = 100, 10**9  # on large maps fewer redraws: together they may paint about 10⁹ cells


class CoverageMission(Mission):
    """CPP for a batch of episodes. Its whole state is in the target maps.

    Attributes
    ----------
    views : ndarray of uint64, shape (M, N)
        What the camera sees from each cell, if the scenario has one map: see `camera_views`. Otherwise of shape (0, 0), and
        each view is computed when it is needed.
    """

    option = "targets"

    def __init__(self, scenario: Scenario, parameters: Coverage) -> None:
        self._name = str(scenario.path)
        self._parameters = parameters
        self._shape = scenario.shape
        self._margin = margin_of(scenario)
        self._collect_reward = scenario.rewards.collect
        self._reach = parameters.camera_size // 2
        self._trees = trees_of(self._reach, scenario.shape[1] + 2 * self._margin)
        self.views = camera_views(scenario) if scenario.cities is None else np.empty((0, 0), dtype=np.uint64)

    def sample(self, state: State, index: NDArray[np.int64]) -> None:
        """Draw random shapes until they cover the required fraction of all cells; targets are their cells outside buildings."""
        low, high = self._parameters.target_fraction
        min_shapes, max_shapes = self._parameters.shapes
        cells = self._shape[0] * self._shape[1]
        attempts = min(_ATTEMPTS, max(_MIN_ATTEMPTS, _PAINTED // (cells * max_shapes)))
        arrays = (state.key, state.target, state.counts, state.total, state.remaining, state.maps.city, state.maps.ground)
        drawn = (self._margin, min_shapes, max_shapes, low, high, attempts)
        if not (_sample_apart(self.threads, index, *arrays, *drawn) if self.threads > 1 else _sample(index, *arrays, *drawn)):
            raise ScenarioError(
                f"{self._name}: mission.target_fraction: {min_shapes} to {max_shapes} shapes did not cover {low} to {high} "
                f"of the cells (at least one outside buildings) in {attempts} attempts: widen it, or change mission.shapes"
            )

    def columns(self, state: State, index: NDArray[np.int64]) -> Columns:
        """Return the target maps as packed bits, shape (len(index), ⌈MN/8⌉)."""
        return {"targets": np.packbits(state.target[index].reshape(len(index), -1) > 0, axis=1)}

    def restore(self, state: State, index: NDArray[np.int64], columns: Columns) -> None:
        """Set target maps from packed bits."""
        rows, cols = self._shape
        bits = np.unpackbits(columns["targets"].astype(np.uint8), axis=1, count=rows * cols)
        state.target[index] = bits.reshape(-1, rows, cols)
        state.total[index] = state.remaining[index] = bits.sum(axis=1)
        for i in index.tolist():
            count_targets(state.target[i], state.counts[i])

    def fits(self, columns: Columns, city: City) -> bool:
        """Return whether frozen columns can belong to this scenario: a bit for every cell, and no target on a building."""
        if "targets" not in columns:
            return False
        cells = city.building.size
        targets = columns["targets"]
        if targets.shape[1] != (cells + 7) // 8:
            return False
        return not np.unpackbits(targets.astype(np.uint8), axis=1, count=cells)[:, city.building.reshape(-1)].any()

    def parse(self, value: Any, city: City) -> Columns:
        """Turn a mask of targets, shape (M, N), into columns."""
        mask = as_array(value)
        if mask is None:
            raise ValueError(f"targets: {shown(value)} is not a mask: rows of 0 and 1 (or False and True), all of one length")
        if mask.shape != city.shape:
            raise ValueError(f"targets: the mask has shape {mask.shape}, the map {city.shape}")
        if not np.isin(mask, (0, 1)).all():
            raise ValueError("targets: the mask holds values other than 0 and 1 (or False and True)")
        wrong = np.argwhere(mask.astype(bool) & city.building)
        if len(wrong):
            raise ValueError(f"targets: cell {tuple(wrong[0].tolist())} is a building; buildings cannot be targets")
        if not mask.any():
            raise ValueError("targets: the mask is empty; at least one cell must be a target")
        return {"targets": np.packbits(mask.astype(bool).reshape(1, -1), axis=1)}

    def collect(self, state: State, uav: int) -> None:
        """Cover what the camera of UAV ``uav`` sees in each slot, and add r_c per newly covered cell to its reward."""
        arrays: tuple[Any, ...] = (uav, state.position, state.done, state.target, state.counts, state.remaining, state.reward)
        camera = (self._reach, self._collect_reward)
        if len(self.views):
            known: tuple[Any, ...] = (*arrays, self.views, *camera)
            _collect_apart(self.threads, *known) if self.threads > 1 else _collect(0, len(state.done), *known)
        else:
            looked: tuple[Any, ...] = (*arrays, state.maps.city, state.maps.ground, self._margin, *self._trees, *camera)
            _look_apart(self.threads, *looked) if self.threads > 1 else _look_and_collect(0, len(state.done), *looked)


def camera_views(scenario: Scenario, city: City | None = None) -> NDArray[np.uint64]:
    """Return what the camera sees from each cell of a CPP scenario.

    Parameters
    ----------
    scenario : Scenario
        A CPP scenario.
    city : City, optional
        The city; by default the scenario's only one. In a scenario with many cities, give it: agents read ``state.city``.

    Returns
    -------
    ndarray of uint64, shape (M, N), read-only
        Bit (i · s + j) of a cell is 1 if row i, column j of the s×s square around the cell is on the map, not a building,
        and visible from the cell; s is the camera's size.

    Raises
    ------
    ValueError
        When the scenario has many cities and ``city`` is not given.
    """
    assert isinstance(scenario.mission, Coverage)
    return _views(city_of(scenario) if city is None else city, scenario.mission.camera_size // 2)


def camera_gain(scenario: Scenario, target: NDArray[np.float32], city: City | None = None) -> NDArray[np.int32]:
    """Return how many targets the camera would newly cover from each cell of a CPP scenario: see `camera_views`.

    Parameters
    ----------
    scenario : Scenario
        A CPP scenario.
    target : ndarray of float32, shape (M, N)
        The target map: cells above 0 are still to be covered.
    city : City, optional
        The city; by default the scenario's only one. In a scenario with many cities, give it: agents read ``state.city``.

    Returns
    -------
    ndarray of int32, shape (M, N)
        The number of targets.

    Raises
    ------
    ValueError
        When the scenario has many cities and ``city`` is not given.
    """
    assert isinstance(scenario.mission, Coverage)
    return _gain(camera_views(scenario, city), scenario.mission.camera_size // 2, target)


@lru_cache(maxsize=32)
def _views(city: City, reach: int) -> NDArray[np.uint64]:
    views = views_from_all(city.building.view(np.uint8), reach, *trees_of(reach, city.shape[1]))
    views.flags.writeable = False
    return views


@kernel
def _sample(
    index: NDArray[np.int64],
    key: NDArray[np.uint64],
    target: NDArray[np.float32],
    counts: NDArray[Any],
    total: NDArray[np.float64],
    remaining: NDArray[np.float64],
    city: NDArray[np.int64],
    ground: NDArray[np.uint8],
    margin: int,
    min_shapes: int,
    max_shapes: int,
    low: float,
    high: float,
    attempts: int,
) -> bool:
    """Draw the targets of the slots ``index``; return False if the attempts of a slot were not enough."""
    cursor = np.empty(1, dtype=np.uint64)
    grid = np.empty(target.shape[1:], dtype=np.uint8)
    cells = grid.size
    for n in range(len(index)):
        i = int(index[n])
        cursor[0] = stream(key[i], CONTENT)
        left = 0
        for _ in range(attempts):
            painted, _placed = draw_shapes(cursor, min_shapes, max_shapes, grid)
            if low * cells <= painted <= high * cells:
                left = _keep(grid, ground[city[i]], margin, target[i])
                if left > 0:
                    break
        if left == 0:
            return False
        count_targets(target[i], counts[i])
        total[i] = remaining[i] = left
    return True


@parallel_kernel
def _sample_apart(threads: int, index: NDArray[np.int64], *rest: Any) -> bool:
    """Call `_sample` with several threads."""
    drawn = np.empty(threads, dtype=np.bool_)
    for part in prange(threads):
        first, last = share(len(index), part, threads)
        drawn[part] = _sample(index[first:last], *rest)
    return bool(drawn.all())


@kernel
def _keep(grid: NDArray[np.uint8], ground: NDArray[np.uint8], margin: int, target: NDArray[np.float32]) -> int:
    """Make targets of the painted cells that are not buildings; return their number."""
    left, (rows, cols), wide = 0, grid.shape, ground.shape[1]
    painted, below, kept = grid.reshape(-1), ground.reshape(-1), target.reshape(-1)  # slices would take longer than the rows
    cell, place = np.uint64(0), np.uint64(margin * wide + margin)
    for _ in range(rows):
        for c in range(np.uint64(cols)):
            keep = painted[cell + c] & np.uint8(below[place + c] & BUILDING_BIT == 0)
            kept[cell + c] = keep
            left += keep
        cell += np.uint64(cols)
        place += np.uint64(wide)
    return left


@kernel
def _collect(
    first: int,
    last: int,
    uav: int,
    position: NDArray[np.int32],
    done: NDArray[np.bool_],
    target: NDArray[np.float32],
    counts: NDArray[Any],
    remaining: NDArray[np.float64],
    reward: NDArray[np.float64],
    views: NDArray[np.uint64],
    reach: int,
    value: float,
) -> None:
    """Cover what UAV ``uav`` sees in those of the slots [``first``, ``last``) where it is active: the views are known."""
    for i in range(first, last):
        if not done[i, uav]:
            r, c = position[i, uav, 0], position[i, uav, 1]
            gain = _cover(i, r - reach, c - reach, views[r, c], 2 * reach + 1, target, counts)
            remaining[i] -= gain
            reward[i, uav] += value * gain


@kernel
def _look_and_collect(
    first: int,
    last: int,
    uav: int,
    position: NDArray[np.int32],
    done: NDArray[np.bool_],
    target: NDArray[np.float32],
    counts: NDArray[Any],
    remaining: NDArray[np.float64],
    reward: NDArray[np.float64],
    city: NDArray[np.int64],
    ground: NDArray[np.uint8],
    margin: int,
    first_nodes: NDArray[np.int32],
    onward: NDArray[np.int32],
    offsets: NDArray[np.int32],
    bits: NDArray[np.uint64],
    reach: int,
    value: float,
) -> None:
    """Do the same where each slot has a city of its own: a view is computed where a target is near.

    This is not one kernel with `_collect`, because to pass an array takes longer than to cover a cell.
    """
    (far_row, far_col), (tall, wide) = (target.shape[1] - 1, target.shape[2] - 1), ground.shape[1:]
    maps = ground.reshape(-1)
    for i in range(first, last):
        r, c = position[i, uav, 0], position[i, uav, 1]
        if done[i, uav] or not _any_near(target[i], r, c, reach):
            continue
        cell = (city[i] * tall + r + margin) * wide + c + margin
        view = view_from(maps, BUILDING_BIT, cell, far_row, far_col, r, c, reach, first_nodes, onward, offsets, bits)
        gain = _cover(i, r - reach, c - reach, view, 2 * reach + 1, target, counts)
        remaining[i] -= gain
        reward[i, uav] += value * gain


@kernel
def _cover(i: int, top: int, left: int, view: Any, side: int, target: NDArray[np.float32], counts: NDArray[Any]) -> int:
    """Remove the targets of slot ``i`` that are in a view, whose square begins at (top, left); return their number."""
    gain = 0
    for y in range(top, top + side):
        for x in range(left, left + side):
            if view & np.uint64(1) and target[i, y, x] > 0.0:  # the view first, because no cell off the map is in it
                target[i, y, x] = 0.0
                remove_target(counts[i], y, x)
                gain += 1
            view >>= np.uint64(1)
    return gain


@kernel
def _any_near(target: NDArray[np.float32], r: int, c: int, reach: int) -> bool:
    """Return whether the square around the cell (r, c) has a target: to look at it takes less time than to compute a view."""
    near = np.float32(0.0)
    for y in range(max(0, r - reach), min(len(target), r + reach + 1)):
        for x in range(max(0, c - reach), min(target.shape[1], c + reach + 1)):
            near = max(near, target[y, x])
    return bool(near > 0.0)


@parallel_kernel
def _collect_apart(threads: int, uav: int, position: NDArray[np.int32], *rest: Any) -> None:
    """Call `_collect` for all slots with several threads."""
    for part in prange(threads):
        first, last = share(len(position), part, threads)
        _collect(first, last, uav, position, *rest)


@parallel_kernel
def _look_apart(threads: int, uav: int, position: NDArray[np.int32], *rest: Any) -> None:
    """Call `_look_and_collect` for all slots with several threads."""
    for part in prange(threads):
        first, last = share(len(position), part, threads)
        _look_and_collect(first, last, uav, position, *rest)


@kernel
def _gain(views: NDArray[np.uint64], reach: int, target: NDArray[np.float32]) -> NDArray[np.int32]:
    """Count the targets that the camera sees from each cell. The outer loops are over the bits of a view: this vectorises."""
    rows, cols = views.shape
    gain = np.zeros((rows, cols), dtype=np.int32)
    bit = np.uint64(0)
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            first, last = max(0, -right), min(cols, cols - right)
            for r in range(max(0, -down), min(rows, rows - down)):
                view, sums = views[r, first:last], gain[r, first:last]
                seen = target[r + down, first + right : last + right]
                for c in range(last - first):
                    sums[c] += ((view[c] >> bit) & np.uint64(1)) if seen[c] > 0.0 else np.uint64(0)
            bit += np.uint64(1)
    return gain
