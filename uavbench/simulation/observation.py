"""The observation: the centred map, its local crop and its global average (paper eqs. 5 to 15).

Layers, in this order: landing, no_fly, building, target; in teams also the other active UAVs (0/1), and their budgets at
their cells; then the mission's own layers. The centred map of an M×N map has the size (2M − 1)×(2N − 1), with the UAV's cell
in the middle; it is padded with 1 in no_fly and building, and with 0 in the other layers.
The static layers (the first three) are read from the city's maps (`uavbench.simulation.city_maps`): the local map is a crop of
them, and the global map is a part of their counts in blocks.

With U UAVs in each of B slots there are B · U observations; UAV u of slot i has the observation i · U + u.
"""

from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from uavbench.simulation.city_maps import fits, margin_within, new_maps
from uavbench.simulation.pooling import block_sum
from uavbench.simulation.rows import BITS, copy_block, divide_block, fill_range, split_block
from uavbench.simulation.state import State
from uavbench.world.kernel import kernel, parallel_kernel, share
from uavbench.world.scenario import Scenario

LAYERS = ("landing", "no_fly", "building", "target")
TEAM_LAYERS = (*LAYERS, "uavs", "budgets")

#: One observation or a batch of them: ``local``, ``global`` and ``budget``, float32.
Observation = dict[str, NDArray[np.float32]]


class Observer:
    """Turns states of a scenario's episodes into observations.

    Parameters
    ----------
    scenario : Scenario
        It gives the map, the local size l (0 for no local map), the global scale g, and whether there are teams.

    Attributes
    ----------
    layers : tuple of str
        The names of the C layers: 4, or 6 in teams, and the mission's own.
    local_shape, global_shape : (int, int, int)
        Shapes of the two maps, channel first: (C, l, l) and (C, ⌊(2M−1)/g⌋, ⌊(2N−1)/g⌋).
    """

    def __init__(self, scenario: Scenario) -> None:
        rows, cols = scenario.shape
        self._local_size, self._scale = scenario.observation.local_size, scenario.observation.global_scale
        self._team = scenario.team
        self.layers = (*(TEAM_LAYERS if scenario.team else LAYERS), *scenario.mission.layers)
        self.local_shape = (len(self.layers), self._local_size, self._local_size)
        self.global_shape = (len(self.layers), (2 * rows - 1) // self._scale, (2 * cols - 1) // self._scale)
        maps = {"local": self.local_shape} if self._local_size else {}
        self._shapes = {**maps, "global": self.global_shape, "budget": (1,)}
        self._no_local = np.empty((0, *self.local_shape), dtype=np.float32)
        self._scenario = scenario
        self._state: State | None = None  # the last state that was observed
        self._read: tuple[Any, ...] = ()

    def empty(self, number: int) -> Observation:
        """Return uninitialised arrays for ``number`` observations; without ``local`` if the local size is 0."""
        return {name: np.empty((number, *shape), dtype=np.float32) for name, shape in self._shapes.items()}

    def write(self, state: State, index: NDArray[np.int64], out: Observation, threads: int = 1) -> None:
        """Write the observations ``index`` of ``state`` (i · U + u for UAV u of slot i) to the same indices of ``out``."""
        if state is not self._state:
            self._state, self._read = state, self._arrays(state)
        local = out["local"] if self._local_size else self._no_local
        if threads > 1:
            _write_apart(threads, index, local, out["global"], out["budget"], *self._read)
        else:
            _write(index, local, out["global"], out["budget"], *self._read)

    def _arrays(self, state: State) -> tuple[Any, ...]:
        """Return the arrays that `_write` reads. Once per state is enough: the arrays of a state are never reallocated."""
        maps = state.maps if fits(state.maps, self._scenario) else new_maps(self._scenario, len(state.done))
        return (
            state.position,
            state.budget,
            state.done,
            state.target,
            state.counts,
            state.spots,
            state.num_spots,
            state.layers,
            *maps,
            margin_within(maps, state.target.shape[1]),
            self._scale,
            self._team,
        )


@kernel
def _write(
    index: NDArray[np.int64],
    out_local: NDArray[np.float32],
    out_global: NDArray[np.float32],
    out_budget: NDArray[np.float32],
    position: NDArray[np.int32],
    budget: NDArray[np.int32],
    done: NDArray[np.bool_],
    target: NDArray[np.float32],
    counts: NDArray[Any],
    spots: NDArray[np.int32],
    num_spots: NDArray[np.int32],
    layers: NDArray[np.float32],
    city: NDArray[np.int64],
    ground: NDArray[np.uint8],
    blocks: NDArray[Any],
    margin: int,
    scale: int,
    team: bool,
) -> None:
    """Write observations. This is a single kernel, because to call a kernel takes as long as to write an observation."""
    (rows, cols), uavs, half = target.shape[1:], position.shape[1], out_local.shape[2] // 2
    static, (tall, broad) = BITS, ground.shape[1:]
    own = static + (3 if team else 1)  # the first of the mission's own layers
    side, area, block = out_local.shape[2], out_local.shape[2] ** 2, out_global.shape[2] * out_global.shape[3]
    # Arrays are flattened once: to flatten or to slice an array takes as long as to copy a row.
    local_flat, global_flat, target_flat = out_local.reshape(-1), out_global.reshape(-1), target.reshape(-1)
    ground_flat, blocks_flat = ground.reshape(-1), blocks.reshape(-1)
    counts_flat, sizes = counts.reshape(-1), (rows, cols)
    for n in index:
        i, u = n // uavs, n % uavs
        r, c = position[i, u, 0], position[i, u, 1]
        out_budget[n, 0] = budget[i, u]
        if out_local.shape[0]:
            start = n * out_local.shape[1] * area
            corner = (city[i] * tall + r + margin - half) * broad + c + margin - half
            split_block(ground_flat, corner, broad, local_flat, start, side, side)
            start += static * area
            fill_range(local_flat, start, (n + 1) * out_local.shape[1] * area, np.float32(0.0))
            if spots.shape[1]:
                _crop_spots(target[i], spots[i, : num_spots[i]], r - half, c - half, out_local[n, static])
            else:
                _crop(target_flat, i * rows * cols, sizes, r - half, c - half, local_flat, start, side)
            if team:
                _write_team(position[i], budget[i], done[i], u, half, half, 1, out_local[n, static + 1 : own])
            for k in range(layers.shape[1]):
                first = (i * layers.shape[1] + k) * rows * cols
                start = (n * out_local.shape[1] + own + k) * area
                _crop(layers.reshape(-1), first, sizes, r - half, c - half, local_flat, start, side)
        top, left = rows - 1 - r, cols - 1 - c  # of the map in the centred map
        start = n * out_global.shape[1] * block
        fill_range(global_flat, start, start + block, np.float32(0.0))  # landing: 0 off the map
        fill_range(global_flat, start + block, start + static * block, np.float32(1.0))
        start += static * block
        fill_range(global_flat, start, (n + 1) * out_global.shape[1] * block, np.float32(0.0))
        _average_blocks(blocks_flat, int(city[i]), blocks.shape[1:], top, left, out_global, n, global_flat)
        if spots.shape[1]:
            _average_spots(target[i], spots[i, : num_spots[i]], top, left, scale, out_global[n, static])
        elif counts.shape[1] == scale:
            _average_counts(counts_flat, i, counts.shape[1:], top, left, out_global, n, static, global_flat)
        else:
            _average(target[i], top, left, scale, out_global[n, static])
        if team:
            _write_team(position[i], budget[i], done[i], u, rows - 1, cols - 1, scale, out_global[n, static + 1 : own])
        for k in range(layers.shape[1]):
            _average(layers[i, k], top, left, scale, out_global[n, own + k])


@parallel_kernel
def _write_apart(threads: int, index: NDArray[np.int64], *rest: Any) -> None:
    """Call `_write` with several threads."""
    for part in prange(threads):
        first, last = share(len(index), part, threads)
        _write(index[first:last], *rest)


@kernel
def _crop(
    maps: NDArray[np.float32],
    first: int,
    sizes: tuple[int, int],
    top: int,
    left: int,
    out: NDArray[np.float32],
    start: int,
    side: int,
) -> None:
    """Write the crop that begins at the cell (top, left) of a map of the shape ``sizes`` (paper eq. 10).

    Both arrays are flattened: the map begins at ``first`` of ``maps``, the crop, side×side, at ``start`` of ``out``.
    """
    rows, cols = sizes
    y, x = max(0, -top), max(0, -left)
    shape = (min(side, rows - top) - y, min(side, cols - left) - x)
    copy_block(maps, first + (top + y) * cols + left + x, cols, out, start + y * side + x, side, shape)


@kernel
def _crop_spots(target: NDArray[np.float32], spots: NDArray[np.int32], top: int, left: int, out: NDArray[np.float32]) -> None:
    """Write the crop of a map that can differ from 0 only in the cells ``spots``."""
    size = out.shape[0]
    for j in range(len(spots)):
        y, x = spots[j, 0] - top, spots[j, 1] - left
        if 0 <= y < size and 0 <= x < size:
            out[y, x] = target[spots[j, 0], spots[j, 1]]


@kernel
def _average_counts(
    counts: NDArray[Any],
    m: int,
    sizes: tuple[int, int, int, int],
    top: int,
    left: int,
    out: NDArray[np.float32],
    n: int,
    layer: int,
    flat: NDArray[np.float32],
) -> None:
    """Write the g×g means of map ``m``, which begins at (top, left) of the centred map, from its counts (paper eq. 13).

    ``counts`` holds the counts of all maps, flattened; ``sizes`` is the shape of one map's. ``flat`` is ``out``, flattened.
    """
    scale, tall, _, broad = sizes
    high, wide = out.shape[2:]
    above, before, p, q = top // scale, left // scale, top % scale, left % scale
    shape = (min(high - above, tall), min(wide - before, broad))
    first = ((m * scale + p) * tall * scale + q) * broad
    start = ((n * out.shape[1] + layer) * high + above) * wide + before
    divide_block(counts, first, scale * broad, flat, start, wide, shape, np.float32(scale * scale))


@kernel
def _average_blocks(
    blocks: NDArray[Any],
    m: int,
    sizes: tuple[int, int, int, int, int],
    top: int,
    left: int,
    out: NDArray[np.float32],
    n: int,
    flat: NDArray[np.float32],
) -> None:
    """Write the g×g means of the static layers of map ``m``, which begins at (top, left) of the centred map (paper eq. 13).

    ``blocks`` holds the counts of all maps, flattened; ``sizes`` is the shape of one map's. ``flat`` is ``out``, flattened.
    """
    scale, _, static, tall, broad = sizes
    high, wide = out.shape[2:]
    above, before, p, q = top // scale, left // scale, top % scale, left % scale
    shape = (min(high - above, tall), min(wide - before, broad))
    first = ((m * scale + p) * scale + q) * static * tall * broad
    start = (n * out.shape[1] * high + above) * wide + before
    for _ in range(static):
        divide_block(blocks, first, broad, flat, start, wide, shape, np.float32(scale * scale))
        first += tall * broad
        start += high * wide


@kernel
def _average_spots(
    target: NDArray[np.float32], spots: NDArray[np.int32], top: int, left: int, scale: int, out: NDArray[np.float32]
) -> None:
    """Write the g×g means of a map that can differ from 0 only in the cells ``spots``."""
    high, wide = out.shape
    area = np.float32(scale * scale)
    for j in range(len(spots)):
        y, x = (spots[j, 0] + top) // scale, (spots[j, 1] + left) // scale
        value = target[spots[j, 0], spots[j, 1]]
        if value > 0.0 and y < high and x < wide:
            if out[y, x] > 0.0:  # the block has another target
                value = block_sum(target, y * scale - top, x * scale - left, scale)
            out[y, x] = value / area


@kernel
def _average(layer: NDArray[np.float32], top: int, left: int, scale: int, out: NDArray[np.float32]) -> None:
    """Write the g×g means of any map, which begins at the cell (top, left) of the centred map (paper eq. 13)."""
    (rows, cols), (high, wide) = layer.shape, out.shape
    area = np.float32(scale * scale)
    for y in range(top // scale, min(high, (top + rows - 1) // scale + 1)):
        for x in range(left // scale, min(wide, (left + cols - 1) // scale + 1)):
            out[y, x] = block_sum(layer, y * scale - top, x * scale - left, scale) / area


@kernel
def _write_team(
    position: NDArray[np.int32],
    budget: NDArray[np.int32],
    done: NDArray[np.bool_],
    u: int,
    up: int,
    left: int,
    scale: int,
    out: NDArray[np.float32],
) -> None:
    """Write the two layers of teams in a local or global map of UAV ``u``: the other active UAVs, and their budgets.

    The map begins ``up`` rows above and ``left`` columns left of the UAV; its values are means of ``scale``×``scale`` cells.
    """
    area = np.float32(scale * scale)
    for w in range(len(position)):
        y = (position[w, 0] - position[u, 0] + up) // scale  # rounded down: off the map it is negative
        x = (position[w, 1] - position[u, 1] + left) // scale
        if w == u or done[w] or not (0 <= y < out.shape[1] and 0 <= x < out.shape[2]):
            continue
        number = actions = 0  # sums over all UAVs in the block, so that each mean is rounded only once
        for v in range(len(position)):
            down, right = position[v, 0] - position[u, 0] + up, position[v, 1] - position[u, 1] + left
            if v != u and not done[v] and down // scale == y and right // scale == x:
                number += 1
                actions += budget[v]
        out[0, y, x] = np.float32(number) / area
        out[1, y, x] = np.float32(actions) / area
