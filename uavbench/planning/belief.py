"""What observations tell about the map: where the UAV is, and what cells the means of the global map stand for.

The global map shows means of blocks of g×g cells, and when the UAV moves, the blocks contain other cells. Together with what
the local maps have shown, this determines the values of most cells after a few moves.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.simulation.observation import Observation, Observer
from uavbench.simulation.state import new_state
from uavbench.world.city import City, city_of
from uavbench.world.kernel import kernel
from uavbench.world.scenario import Scenario

Cell = tuple[int, int]

_TINY = 1e-3  # data units: sums below this are rounding errors of means in float32
_SWEEPS = 30
_EVEN = 0.5  # the probability of a target in a cell of which nothing is known


def places(scenario: Scenario) -> dict[bytes, Cell]:
    """Return the UAV's cell, keyed by the static layers of its global map as bytes: on the paper's maps these are unique."""
    cells = np.argwhere(~city_of(scenario).no_fly)
    observer, state = Observer(scenario), new_state(scenario, len(cells), 1)
    state.position[:, 0] = cells
    shown = observer.empty(len(cells))
    observer.write(state, np.arange(len(cells)), shown)
    return {static(view): (r, c) for view, (r, c) in zip(shown["global"], cells.tolist(), strict=True)}


def static(view: NDArray[np.float32]) -> bytes:
    """Return the static layers of a global map as bytes."""
    return view[:3].tobytes()


class _Windows:
    """Where the parts of an observation lie on the map."""

    def __init__(self, scenario: Scenario) -> None:
        self.shape = scenario.shape
        self.scale, self._half = scenario.observation.global_scale, scenario.observation.local_size // 2

    def near(self, here: Cell) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        """Return the slices of the map and of the local map at ``here`` that contain the same cells."""
        on_map: list[slice] = []
        on_local: list[slice] = []
        for at, size in zip(here, self.shape, strict=True):
            low, high = max(0, at - self._half), min(size, at + self._half + 1)
            on_map.append(slice(low, high))
            on_local.append(slice(low - at + self._half, high - at + self._half))
        return (on_map[0], on_map[1]), (on_local[0], on_local[1])

    def first(self, here: Cell) -> Cell:
        """Return the cell, possibly off the map, where the first block of the global map at ``here`` begins."""
        return here[0] - self.shape[0] + 1, here[1] - self.shape[1] + 1


class TargetBelief:
    """CPP: which cells are targets. Targets change only near the UAV, so what was seen of other cells remains true.

    Attributes
    ----------
    known : ndarray of bool, shape (M, N)
        Cells that a local map has shown, and buildings.
    first, now : ndarray of float32, shape (M, N)
        Targets at the start and now: 1 or 0 where ``known`` is true.
    likely : ndarray of float32, shape (M, N)
        For other cells, the estimated probability in [0, 1] that the cell is a target, from the sums of all blocks seen.
    """

    def __init__(self, scenario: Scenario) -> None:
        building = city_of(scenario).building
        self._windows = _Windows(scenario)
        self.known = building.copy()
        self.first: NDArray[np.float32] = np.zeros(building.shape, np.float32)
        self.now: NDArray[np.float32] = np.zeros(building.shape, np.float32)
        self.likely: NDArray[np.float32] = np.where(building, 0.0, _EVEN).astype(np.float32)
        # By offset of the blocks: the cell where the first begins, and the number of targets in each block at the start.
        self._sums: dict[Cell, tuple[Cell, NDArray[np.float64]]] = {}

    def learn(self, here: Cell, observation: Observation) -> bool:
        """Take in an observation; return whether it tells anything new about cells outside the local map."""
        windows = self._windows
        inside, shown = windows.near(here)
        seen, fresh = observation["local"][3][shown], ~self.known[inside]
        self.first[inside] = np.where(fresh, seen, self.first[inside])
        self.now[inside] = seen
        self.known[inside] = True
        first, scale = windows.first(here), windows.scale
        offset = first[0] % scale, first[1] % scale
        if offset in self._sums:
            return False
        sums = np.rint(observation["global"][3] * scale * scale)
        self._sums[offset] = first, sums + _block_sums(self.first - self.now, *first, scale, *sums.shape)
        likely = self.likely.copy()
        for _ in range(_SWEEPS):
            for begin, whole in self._sums.values():
                _fit(likely, self.known, self.first, *begin, scale, whole)
        self.likely = likely
        return True


class DeviceBelief:
    """DH: where data are left. A block that is known to hold no data never holds any again."""

    def __init__(self, scenario: Scenario) -> None:
        city: City = city_of(scenario)
        self._windows = _Windows(scenario)
        self._possible = ~(city.building | city.landing)
        self.data: NDArray[np.float64] = np.zeros(city.shape)

    def learn(self, here: Cell, observation: Observation) -> bool:
        """Take in an observation; return whether the believed cells of the devices have changed."""
        windows, before = self._windows, self.data > 0.0
        inside, shown = windows.near(here)
        self.data = np.zeros_like(self.data)
        self.data[inside] = observation["local"][3][shown]
        near = np.zeros(self.data.shape, dtype=bool)
        near[inside] = True
        self._possible[inside] = self.data[inside] > 0.0
        first, scale = windows.first(here), windows.scale
        sums = observation["global"][3].astype(np.float64) * scale * scale
        rest = sums - _block_sums(self.data, *first, scale, *sums.shape)
        for i, j in np.ndindex(*sums.shape):
            r, c = first[0] + i * scale, first[1] + j * scale
            block = slice(max(r, 0), max(r + scale, 0)), slice(max(c, 0), max(c + scale, 0))
            if rest[i, j] <= _TINY:
                self._possible[block] &= near[block]
                continue
            cells = np.argwhere(self._possible[block] & ~near[block])
            if len(cells):  # believe in one device: where one was believed to be before, or in the middle of the possible cells
                far = np.abs(cells - cells.mean(axis=0)).sum(axis=1) - 2 * scale * before[block][tuple(cells.T)]
                self.data[block][tuple(cells[far.argmin()])] = rest[i, j]
        return bool(((self.data > 0.0) != before).any())

    def devices(self) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return the devices' cells, shape (K, 2), and data, shape (K,)."""
        cells = np.argwhere(self.data > 0.0).astype(np.int32)
        return cells, self.data[cells[:, 0], cells[:, 1]]


@kernel
def _block_sums(values: NDArray[Any], top: int, left: int, scale: int, high: int, wide: int) -> NDArray[np.float64]:
    """Return the sums of the blocks, shape (high, wide); the first block begins at (top, left)."""
    sums = np.zeros((high, wide))
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            i, j = (r - top) // scale, (c - left) // scale
            if i < high and j < wide:
                sums[i, j] += values[r, c]
    return sums


@kernel
def _fit(
    likely: NDArray[np.float32],
    known: NDArray[np.bool_],
    first: NDArray[np.float32],
    top: int,
    left: int,
    scale: int,
    sums: NDArray[np.float64],
) -> None:
    """Scale ``likely`` in the cells that are not known, block by block, to the blocks' sums (Gordon, Bender, Herman 1970)."""
    rows, cols = likely.shape
    for i in range(sums.shape[0]):
        for j in range(sums.shape[1]):
            wanted, total = sums[i, j], 0.0
            r0, c0 = top + i * scale, left + j * scale
            for r in range(max(r0, 0), min(r0 + scale, rows)):
                for c in range(max(c0, 0), min(c0 + scale, cols)):
                    if known[r, c]:
                        wanted -= first[r, c]
                    else:
                        total += likely[r, c]
            if total <= 0.0:
                continue
            factor = max(wanted, 0.0) / total
            for r in range(max(r0, 0), min(r0 + scale, rows)):
                for c in range(max(c0, 0), min(c0 + scale, cols)):
                    if not known[r, c]:
                        likely[r, c] = min(1.0, likely[r, c] * factor)
