"""The observation: the centred map, its local crop and its global average (paper eqs. 5 to 15).

Layers, in this order: landing, no_fly, building, target; in teams also the other active UAVs (0/1), and their budgets at
their cells; then the mission's own layers. The centred map of an M×N map has the size (2M − 1)×(2N − 1), with the UAV's cell
in the middle; it is padded with 1 in no_fly and building, and with 0 in the other layers.
The static layers (the first three) at any position are crops of two tables that are made once for each city. The size of the
tables is proportional to the size of the map. Only the other layers are computed in each step.

With U UAVs in each of B slots there are B · U observations; UAV u of slot i has the observation i · U + u.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from uavbench.simulation.pooling import block_sum
from uavbench.simulation.rows import copy_row
from uavbench.simulation.state import State
from uavbench.world.city import City, city_of
from uavbench.world.kernel import kernel, parallel_kernel, share
from uavbench.world.scenario import Scenario

LAYERS = ("landing", "no_fly", "building", "target")
TEAM_LAYERS = (*LAYERS, "uavs", "budgets")
_PADDING = (0.0, 1.0, 1.0)  # of the static layers; the padding of the others is 0

#: One observation or a batch of them: ``local``, ``global`` and ``budget``, float32.
Observation = dict[str, NDArray[np.float32]]


class _Tables(NamedTuple):
    """The static layers, ready to be cropped.

    ``crops[c, layer, r:r+l]`` is the local map at (r, c), contiguous in memory. ``means[r % g, c % g, layer]`` holds the g×g
    means for all cells with the same r % g and c % g (the same phase); its part that begins at [r // g, c // g] is the global
    map at (r, c).
    """

    crops: NDArray[np.float32]
    means: NDArray[np.float32]


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
        self._tables = _tables(city_of(scenario), self._local_size, self._scale, self.global_shape)
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
        return (
            state.position,
            state.budget,
            state.done,
            state.target,
            state.counts,
            state.spots,
            state.num_spots,
            state.layers,
            *self._tables,
            self._team,
        )


@lru_cache(maxsize=32)
def _tables(city: City, local_size: int, scale: int, global_shape: tuple[int, int, int]) -> _Tables:
    """Make the tables of a city."""
    rows, cols = city.shape
    layers = (city.landing, city.no_fly, city.building)
    half = max(local_size - 1, 0) // 2
    crops = np.empty((cols, len(layers), rows + 2 * half, local_size), dtype=np.float32)
    high, wide = (rows - 1) // scale + global_shape[1], (cols - 1) // scale + global_shape[2]
    means = np.empty((scale, scale, len(layers), high, wide), dtype=np.float32)
    # After the map there must be as much padding as the last block of the last phase needs.
    margin = tuple((n - 1, max(0, (blocks + 1) * scale - 2 * n)) for n, blocks in ((rows, high), (cols, wide)))
    for k, (layer, pad) in enumerate(zip(layers, _PADDING, strict=True)):
        padded = np.pad(layer.astype(np.float32), half, constant_values=pad)
        for c in range(cols):
            crops[c, k] = padded[:, c : c + local_size]
        padded = np.pad(layer.astype(np.int32), margin, constant_values=int(pad))
        sums = np.pad(padded, ((1, 0), (1, 0))).cumsum(axis=0, dtype=np.int32).cumsum(axis=1, dtype=np.int32)
        blocks = sums[scale:, scale:] - sums[:-scale, scale:] - sums[scale:, :-scale] + sums[:-scale, :-scale]
        for y in range(scale):
            for x in range(scale):
                means[y, x, k] = blocks[y::scale, x::scale][:high, :wide] / scale**2
    crops.flags.writeable = means.flags.writeable = False
    return _Tables(crops, means)


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
    crops: NDArray[np.float32],
    means: NDArray[np.float32],
    team: bool,
) -> None:
    """Write observations. This is a single kernel, because to call a kernel takes as long as to write an observation."""
    (rows, cols), uavs, half = target.shape[1:], position.shape[1], out_local.shape[2] // 2
    static, scale = means.shape[2], means.shape[0]
    own = static + (3 if team else 1)  # the first of the mission's own layers
    side, area, block = out_local.shape[2], out_local.shape[2] ** 2, out_global.shape[2] * out_global.shape[3]
    local_flat, global_flat = out_local.reshape(len(out_local), -1), out_global.reshape(len(out_global), -1)
    crops_flat = crops.reshape(crops.shape[0] * static, -1)  # reshaped only once: this takes as long as to copy a row
    for n in index:
        i, u = n // uavs, n % uavs
        r, c = position[i, u, 0], position[i, u, 1]
        out_budget[n, 0] = budget[i, u]
        if out_local.shape[0]:
            for k in range(static):  # each layer is contiguous in the table
                copy_row(crops_flat[c * static + k, r * side : r * side + area], local_flat[n, k * area : (k + 1) * area])
            _clear(local_flat[n, static * area :])
            if spots.shape[1]:
                _crop_spots(target[i], spots[i, : num_spots[i]], r - half, c - half, out_local[n, static])
            else:
                _crop(target[i], r - half, c - half, out_local[n, static])
            if team:
                _write_team(position[i], budget[i], done[i], u, half, half, 1, out_local[n, static + 1 : own])
            for k in range(layers.shape[1]):
                _crop(layers[i, k], r - half, c - half, out_local[n, own + k])
        _average_static(means, r, c, out_global[n])
        _clear(global_flat[n, static * block :])
        top, left = rows - 1 - r, cols - 1 - c  # of the map in the centred map
        if spots.shape[1]:
            _average_spots(target[i], spots[i, : num_spots[i]], top, left, scale, out_global[n, static])
        elif counts.shape[1] == scale:
            _average_counts(counts[i], top, left, out_global[n, static])
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
def _crop(layer: NDArray[np.float32], top: int, left: int, out: NDArray[np.float32]) -> None:
    """Write the crop of a map that begins at the map's cell (top, left) (paper eq. 10)."""
    (rows, cols), size = layer.shape, out.shape[0]
    first, last = max(0, -left), min(size, cols - left)
    for y in range(max(0, -top), min(size, rows - top)):
        copy_row(layer[top + y, left + first : left + last], out[y, first:last])


@kernel
def _crop_spots(target: NDArray[np.float32], spots: NDArray[np.int32], top: int, left: int, out: NDArray[np.float32]) -> None:
    """Write the crop of a map that can differ from 0 only in the cells ``spots``."""
    size = out.shape[0]
    for j in range(len(spots)):
        y, x = spots[j, 0] - top, spots[j, 1] - left
        if 0 <= y < size and 0 <= x < size:
            out[y, x] = target[spots[j, 0], spots[j, 1]]


@kernel
def _average_static(means: NDArray[np.float32], r: int, c: int, out: NDArray[np.float32]) -> None:
    """Write the static layers of a global map (paper eq. 13): a part of the table ``means`` for the phase of (r, c)."""
    (high, wide), scale = out.shape[1:], means.shape[0]
    phase, down, right = means[r % scale, c % scale], r // scale, c // scale
    for k in range(means.shape[2]):
        for y in range(high):
            copy_row(phase[k, down + y, right : right + wide], out[k, y])


@kernel
def _average_counts(counts: NDArray[Any], top: int, left: int, out: NDArray[np.float32]) -> None:
    """Write the g×g means of a target map with values 0 and 1, from the counts of targets in the blocks of this phase."""
    (high, wide), scale = out.shape, counts.shape[0]
    area = np.float32(scale * scale)
    above, before, p, q = top // scale, left // scale, top % scale, left % scale
    last = min(wide, before + counts.shape[3])
    for y in range(min(high - above, counts.shape[1])):
        _divide(counts[p, y, q], area, out[above + y, before:last])


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


@kernel
def _clear(values: NDArray[np.float32]) -> None:
    """Set all values to 0; LLVM turns a plain loop over a row into a memset."""
    for x in range(len(values)):
        values[x] = 0.0


@kernel
def _divide(source: NDArray[Any], area: np.float32, target: NDArray[np.float32]) -> None:
    """Divide a row by ``area``; LLVM vectorises a plain loop over slices best."""
    for x in range(len(target)):
        target[x] = np.float32(source[x]) / area
