"""The observation: the centred map, its local crop and its global average (paper eqs. 5 to 15).

Layers, in this order: landing, no_fly, building, target; in teams also the other active UAVs (0/1), and their budgets at
their cells; and those that are the mission's own. The centred map of an M×N map is (2M − 1)×(2N − 1), the UAV's cell in the
middle, padded with 1 in no_fly and building and with 0 in the others.
The static layers of any position are crops of two tables made once, of a size proportional to the map's; only the other
layers are computed per step.

Of U UAVs in each of B slots, UAV u of slot i has the observation i · U + u of B · U.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.city import City, city_of
from uavbench.kernel import kernel
from uavbench.scenario import Scenario
from uavbench.state import State

LAYERS = ("landing", "no_fly", "building", "target")
TEAM_LAYERS = (*LAYERS, "uavs", "budgets")
_FIRST_OF_TEAM = len(LAYERS)
_PADDING = (0.0, 1.0, 1.0)  # of the static layers; that of the others is 0

#: One observation or a batch of them: ``local``, ``global`` and ``budget``, float32.
Observation = dict[str, NDArray[np.float32]]


class _Tables(NamedTuple):
    """The static layers, ready to be cropped.

    ``crops[c, layer, r:r+l]`` is the local map at (r, c), in one piece of memory. ``means[r % g, c % g, layer]`` holds the
    g×g means at all positions of that phase, so that from [r // g, c // g] on it is the global map at (r, c).
    """

    crops: NDArray[np.float32]
    means: NDArray[np.float32]


class Observer:
    """Turns states of a scenario's episodes into observations.

    Parameters
    ----------
    scenario : Scenario
        Its map, its local size l (0 for no local map) and global scale g, and whether it is a team's.

    Attributes
    ----------
    layers : tuple of str
        The C layers' names: 4, in teams 6, and those that are the mission's own.
    local_shape, global_shape : (int, int, int)
        Shapes of the two maps, channel first: (C, l, l) and (C, ⌊(2M−1)/g⌋, ⌊(2N−1)/g⌋).
    """

    def __init__(self, scenario: Scenario) -> None:
        rows, cols = scenario.shape
        self._local_size, self._scale = scenario.observation.local_size, scenario.observation.global_scale
        self._team, self._shared = scenario.team, TEAM_LAYERS if scenario.team else LAYERS
        self.layers = (*self._shared, *scenario.mission.layers)
        self.local_shape = (len(self.layers), self._local_size, self._local_size)
        self.global_shape = (len(self.layers), (2 * rows - 1) // self._scale, (2 * cols - 1) // self._scale)
        self._tables = _tables(city_of(scenario), self._local_size, self._scale, self.global_shape)

    def empty(self, number: int) -> Observation:
        """Return uninitialised arrays for ``number`` observations; no ``local`` when the local size is 0."""
        arrays = {
            "local": np.empty((number, *self.local_shape), dtype=np.float32),
            "global": np.empty((number, *self.global_shape), dtype=np.float32),
            "budget": np.empty((number, 1), dtype=np.float32),
        }
        if not self._local_size:
            del arrays["local"]
        return arrays

    def write(self, state: State, index: NDArray[np.int64], out: Observation) -> None:
        """Write the observations ``index`` of ``state`` (i · U + u for UAV u of slot i) into the same places of ``out``."""
        if self._local_size:
            _write_local(state.position, state.target, index, self._tables.crops, out["local"])
        _write_global(
            state.position,
            state.target,
            state.row_targets,
            state.budget,
            index,
            self._tables.means,
            self._scale,
            out["global"],
            out["budget"],
        )
        half, (rows, cols) = self._local_size // 2, state.target.shape[1:]
        maps = [("local", half, half, 1)] if self._local_size else []
        for name, up, left, scale in (*maps, ("global", rows - 1, cols - 1, self._scale)):
            if self._team:
                _write_team(state.position, state.budget, state.done, index, up, left, scale, out[name])
            if len(self.layers) > len(self._shared):
                _write_own(state.position, state.layers, index, up, left, scale, len(self._shared), out[name])


def _tables(city: City, local_size: int, scale: int, global_shape: tuple[int, int, int]) -> _Tables:
    """Make the tables of a city."""
    rows, cols = city.shape
    layers = (city.landing, city.no_fly, city.building)
    half = max(local_size - 1, 0) // 2
    crops = np.empty((cols, len(layers), rows + 2 * half, local_size), dtype=np.float32)
    high, wide = (rows - 1) // scale + global_shape[1], (cols - 1) // scale + global_shape[2]
    means = np.empty((scale, scale, len(layers), high, wide), dtype=np.float32)
    # Behind the map as much padding as the last block of the last phase needs.
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
    return _Tables(crops, means)


@kernel
def _write_local(
    position: NDArray[np.int32],
    target: NDArray[np.float32],
    index: NDArray[np.int64],
    crops: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write the local maps."""
    size = out.shape[2]
    rows, cols = target.shape[1:]
    static, uavs = crops.shape[1], position.shape[1]
    for n in index:
        i, u = n // uavs, n % uavs
        r, c = position[i, u, 0], position[i, u, 1]
        for k in range(static):
            _copy(crops[c, k, r : r + size].reshape(-1), out[n, k].reshape(-1))
        out[n, static] = 0.0
        top, left = r - size // 2, c - size // 2
        first, last = max(0, -left), min(size, cols - left)
        for y in range(max(0, -top), min(size, rows - top)):
            _copy(target[i, top + y, left + first : left + last], out[n, static, y, first:last])


@kernel
def _write_global(
    position: NDArray[np.int32],
    target: NDArray[np.float32],
    row_targets: NDArray[np.int32],
    budget: NDArray[np.int32],
    index: NDArray[np.int64],
    means: NDArray[np.float32],
    scale: int,
    out: NDArray[np.float32],
    out_budget: NDArray[np.float32],
) -> None:
    """Write the global maps, static layers from the table, targets summed block by block; and budgets."""
    high, wide = out.shape[2:]
    rows, cols = target.shape[1:]
    static, uavs = means.shape[2], position.shape[1]
    sums = np.empty(cols + 2 * scale, dtype=np.float32)
    for n in index:
        i, u = n // uavs, n % uavs
        out_budget[n, 0] = budget[i, u]
        r, c = position[i, u, 0], position[i, u, 1]
        phase, down, right = means[r % scale, c % scale], r // scale, c // scale
        for k in range(static):
            for y in range(high):
                _copy(phase[k, down + y, right : right + wide], out[n, k, y])
        layer = out[n, static]
        layer[:] = 0.0
        # The map begins at (top, left) of the centred map; block column `before` is the first that meets it, and its
        # first `lead` cells lie before it.
        top, left = rows - 1 - r, cols - 1 - c
        before, lead = left // scale, left % scale
        blocks = min(wide - before, (lead + cols + scale - 1) // scale)
        for y in range(top // scale, high):
            first, last = max(0, y * scale - top), min(rows, (y + 1) * scale - top)
            if first >= last:
                break
            if row_targets[i, first:last].sum() == 0:
                continue
            sums[:] = 0.0
            columns = sums[lead : lead + cols]
            for row in range(first, last):
                if row_targets[i, row]:
                    _add(target[i, row], columns)
            _sum_blocks(sums, scale, layer[y, before : before + blocks])


@kernel
def _write_team(
    position: NDArray[np.int32],
    budget: NDArray[np.int32],
    done: NDArray[np.bool_],
    index: NDArray[np.int64],
    up: int,
    left: int,
    scale: int,
    out: NDArray[np.float32],
) -> None:
    """Write the two layers of teams in a map: the other active UAVs, and their budgets at their cells.

    The map begins ``up`` and ``left`` cells from the UAV, and one cell of it is the mean of ``scale``×``scale``.
    """
    uavs = position.shape[1]
    area = np.float32(scale * scale)
    place = np.empty((uavs, 2), dtype=np.int64)
    for n in index:
        i, u = n // uavs, n % uavs
        others = out[n, _FIRST_OF_TEAM : _FIRST_OF_TEAM + 2]
        _clear(others.reshape(-1))
        for w in range(uavs):
            place[w, 0] = (position[i, w, 0] - position[i, u, 0] + up) // scale  # rounded down: negative off the map
            place[w, 1] = (position[i, w, 1] - position[i, u, 1] + left) // scale
        for w in range(uavs):
            y, x = place[w]
            if w == u or done[i, w] or not (0 <= y < others.shape[1] and 0 <= x < others.shape[2]):
                continue
            number = actions = 0  # of all that share the cell: a mean is rounded once
            for v in range(uavs):
                if v != u and not done[i, v] and place[v, 0] == y and place[v, 1] == x:
                    number += 1
                    actions += budget[i, v]
            others[0, y, x] = np.float32(number) / area
            others[1, y, x] = np.float32(actions) / area


@kernel
def _write_own(
    position: NDArray[np.int32],
    layers: NDArray[np.float32],
    index: NDArray[np.int64],
    up: int,
    left: int,
    scale: int,
    first: int,
    out: NDArray[np.float32],
) -> None:
    """Write the mission's own layers of a map, from layer ``first`` on; the rest as for ``_write_team``."""
    uavs, (rows, cols) = position.shape[1], layers.shape[2:]
    high, wide = out.shape[2:]
    for n in index:
        i, u = n // uavs, n % uavs
        _clear(out[n, first:].reshape(-1))
        for k in range(layers.shape[1]):
            layer = out[n, first + k]
            for r in range(rows):
                y = (r - position[i, u, 0] + up) // scale  # rounded down: negative off the map
                for c in range(cols):
                    x = (c - position[i, u, 1] + left) // scale
                    if 0 <= y < high and 0 <= x < wide:
                        layer[y, x] += layers[i, k, r, c]
            for y in range(high):
                for x in range(wide):
                    layer[y, x] /= np.float32(scale * scale)


@kernel
def _clear(values: NDArray[np.float32]) -> None:
    """Set all values to 0."""
    for x in range(len(values)):
        values[x] = 0.0


@kernel
def _copy(source: NDArray[np.float32], target: NDArray[np.float32]) -> None:
    """Copy a row; a plain loop over slices is what LLVM vectorises best."""
    for x in range(len(source)):
        target[x] = source[x]


@kernel
def _add(source: NDArray[np.float32], target: NDArray[np.float32]) -> None:
    """Add a row to another."""
    for x in range(len(source)):
        target[x] += source[x]


@kernel
def _sum_blocks(sums: NDArray[np.float32], scale: int, means: NDArray[np.float32]) -> None:
    """Turn the column sums of a row of blocks into the blocks' means."""
    area = np.float32(scale * scale)
    if scale == 3:  # the paper's two scales are written out: only so does LLVM vectorise them
        for x in range(len(means)):
            means[x] = (sums[3 * x] + sums[3 * x + 1] + sums[3 * x + 2]) / area
    elif scale == 5:
        for x in range(len(means)):
            means[x] = (sums[5 * x] + sums[5 * x + 1] + sums[5 * x + 2] + sums[5 * x + 3] + sums[5 * x + 4]) / area
    else:
        for x in range(len(means)):
            total = np.float32(0.0)
            for col in range(x * scale, (x + 1) * scale):
                total += sums[col]
            means[x] = total / area
