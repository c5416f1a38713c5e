"""The observation: the centred map, its local crop and its global average (paper eqs. 5 to 15).

Layers, in this order: landing, no_fly, building, target. The centred map of an M×N map is (2M − 1)×(2N − 1), the UAV's cell
in the middle, padded with [0, 1, 1, 0]. The static layers of any position are crops of two tables made once, of a size
proportional to the map's; only the target layer is computed per step.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.city import City
from uavbench.kernel import kernel
from uavbench.parameters import ObservationSizes
from uavbench.state import State

LAYERS = ("landing", "no_fly", "building", "target")
_PADDING = (0.0, 1.0, 1.0)  # of the static layers; the target layer's is 0

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
    """Turns states of one city into observations.

    Parameters
    ----------
    city : City
        The city.
    sizes : ObservationSizes
        Local size l (0 for no local map) and global scale g.

    Attributes
    ----------
    local_shape, global_shape : (int, int, int)
        Shapes of the two maps, channel first: (4, l, l) and (4, ⌊(2M−1)/g⌋, ⌊(2N−1)/g⌋).
    """

    def __init__(self, city: City, sizes: ObservationSizes) -> None:
        rows, cols = city.shape
        self._local_size, self._scale = sizes.local_size, sizes.global_scale
        self.local_shape = (len(LAYERS), self._local_size, self._local_size)
        self.global_shape = (len(LAYERS), (2 * rows - 1) // self._scale, (2 * cols - 1) // self._scale)
        self._tables = _tables(city, self._local_size, self._scale, self.global_shape)

    def empty(self, num_envs: int) -> Observation:
        """Return uninitialised arrays for ``num_envs`` observations; no ``local`` when the local size is 0."""
        arrays = {
            "local": np.empty((num_envs, *self.local_shape), dtype=np.float32),
            "global": np.empty((num_envs, *self.global_shape), dtype=np.float32),
            "budget": np.empty((num_envs, 1), dtype=np.float32),
        }
        if not self._local_size:
            del arrays["local"]
        return arrays

    def write(self, state: State, index: NDArray[np.int64], out: Observation) -> None:
        """Write the observations of the slots ``index`` of ``state`` into the same places of ``out``."""
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


def _tables(city: City, local_size: int, scale: int, global_shape: tuple[int, int, int]) -> _Tables:
    """Make the tables of a city."""
    rows, cols = city.shape
    layers = (city.landing, city.no_fly, city.building)
    half = max(local_size - 1, 0) // 2
    crops = np.empty((cols, len(layers), rows + 2 * half, local_size), dtype=np.float32)
    high, wide = (rows - 1) // scale + global_shape[1], (cols - 1) // scale + global_shape[2]
    means = np.empty((scale, scale, len(layers), high, wide), dtype=np.float32)
    margin = ((rows - 1, 2 * rows + scale * 2), (cols - 1, 2 * cols + scale * 2))
    for k, (layer, pad) in enumerate(zip(layers, _PADDING, strict=True)):
        padded = np.pad(layer.astype(np.float32), half, constant_values=pad)
        for c in range(cols):
            crops[c, k] = padded[:, c : c + local_size]
        padded = np.pad(layer.astype(np.int64), margin, constant_values=int(pad))
        for y in range(scale):
            for x in range(scale):
                blocks = padded[y : y + high * scale, x : x + wide * scale].reshape(high, scale, wide, scale)
                means[y, x, k] = blocks.sum(axis=(1, 3)) / scale**2
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
    static = crops.shape[1]
    for i in index:
        r, c = position[i, 0], position[i, 1]
        for k in range(static):
            _copy(crops[c, k, r : r + size].reshape(-1), out[i, k].reshape(-1))
        out[i, static] = 0.0
        top, left = r - size // 2, c - size // 2
        first, last = max(0, -left), min(size, cols - left)
        for y in range(max(0, -top), min(size, rows - top)):
            _copy(target[i, top + y, left + first : left + last], out[i, static, y, first:last])


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
    static = means.shape[2]
    sums = np.empty(cols + 2 * scale, dtype=np.float32)
    for i in index:
        out_budget[i, 0] = budget[i]
        r, c = position[i, 0], position[i, 1]
        phase, down, right = means[r % scale, c % scale], r // scale, c // scale
        for k in range(static):
            for y in range(high):
                _copy(phase[k, down + y, right : right + wide], out[i, k, y])
        layer = out[i, static]
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
