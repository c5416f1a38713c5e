"""Pilot: remembers what it saw, infers where it is and what the blurred map hides, and plans on that.

It decides by the observation alone, as the paper's agent does, and uses more than that one did: the scenario's map, which tells
where it is; the rules, by which it searches over whole flights as `planner` does; and memory. The global map shows means over
g×g cells, and as the UAV moves they are means over other cells: together with what was near they tell, after a few moves, most
cells apart.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from planner import Agent as Planner

from uavbench.city import City, city_of
from uavbench.kernel import kernel
from uavbench.observation import Observer
from uavbench.planning.harvesting import expected_rates
from uavbench.state import new_state

_TINY = 1e-3  # of a data unit: what float32 means may be wrong by
_SWEEPS = 30


@dataclass
class Believed:
    """What `planner` asks of a state, as far as it is known."""

    uav: int
    city: City
    position: tuple[int, int]
    budget: int
    target: Any
    device_cell: Any = None
    device_data: Any = None


class Agent:
    """Believes, plans, and plans again as it learns more.

    Attributes
    ----------
    changes, searches : int
        Of the first plan, as for `planner`.
    mending_changes : int
        Tried whenever the belief has changed.
    """

    track = "observation"

    def __init__(self, scenario, weights: Path | None = None):
        if scenario.team:
            raise ValueError(f"pilot flies one UAV; {scenario.id} is for teams")
        self._scenario, self._city = scenario, city_of(scenario)
        self._place = _places(scenario, self._city)
        self._planner = Planner(scenario)

    def reset(self, info):
        """Forget the last episode."""
        self._planner.reset(info)
        self._belief = (_Cells if self._scenario.mission.kind == "coverage" else _Devices)(self._scenario, self._city)

    def act(self, observation, info):
        """Return the next action of the flight that is best for all that is known."""
        here = self._place[observation["global"][:3].tobytes()]
        changed = self._belief.learn(here, observation)
        state = Believed(0, self._city, here, int(observation["budget"][0]), **self._belief.targets())
        if changed:
            self._belief.prepare(self._planner, self._scenario, state)
        return self._planner.act_team([observation], [{**info, "state": state}])[0]


class _Windows:
    """Where the parts of an observation lie on the map."""

    def __init__(self, scenario, city):
        self.rows, self.cols = city.shape
        self.scale, self.half = scenario.observation.global_scale, scenario.observation.local_size // 2

    def near(self, here):
        """Return the slices of the map, and of the local map, that show the same cells."""
        found = []
        for at, size in zip(here, (self.rows, self.cols), strict=True):
            low, high = max(0, at - self.half), min(size, at + self.half + 1)
            found.append((slice(low, high), slice(low - at + self.half, high - at + self.half)))
        return (found[0][0], found[1][0]), (found[0][1], found[1][1])

    def first(self, here):
        """Return the cell of the map, maybe beyond its edge, where the first block of the global map begins."""
        return here[0] - self.rows + 1, here[1] - self.cols + 1


class _Cells:
    """CPP: which cells are targets. A target changes only near the UAV, so what was seen of the rest remains true.

    Attributes
    ----------
    first, now : ndarray of float32, shape (M, N)
        Targets at the start and now, 1 or 0 where ``known``.
    """

    def __init__(self, scenario, city):
        self._windows = _Windows(scenario, city)
        self.known = city.building.copy()
        self.first, self.now = np.zeros(city.shape, np.float32), np.zeros(city.shape, np.float32)
        self._likely = np.where(city.building, 0.0, 0.5).astype(np.float32)
        self._sums = {}  # by where blocks begin: how many cells of each were targets at the start

    def learn(self, here, observation):
        """Take in what is seen; return whether the belief has changed."""
        windows, before = self._windows, self.targets()["target"]
        inside, shown = windows.near(here)
        seen = observation["local"][3][shown]
        fresh = ~self.known[inside]
        expected = np.where(fresh, before[inside], seen)
        self.first[inside] = np.where(fresh, seen, self.first[inside])
        self.now[inside] = seen
        self.known[inside] = True
        first, scale = windows.first(here), windows.scale
        phase = first[0] % scale, first[1] % scale
        if phase not in self._sums:
            sums = np.rint(observation["global"][3] * scale * scale)
            self._sums[phase] = first, sums + _block_sums(self.first - self.now, *first, scale, *sums.shape)
            likely = self._likely.copy()
            for _ in range(_SWEEPS):
                for begin, whole in self._sums.values():
                    _fit(likely, self.known, self.first, *begin, scale, whole)
            self._likely = likely
        after = self.targets()["target"]
        return bool((expected != seen).any() or (after != before)[~self.known].any())

    def targets(self):
        """Return the target map as far as it is known, else as it is likely."""
        return {"target": np.where(self.known, self.now, self._likely > 0.5).astype(np.float32)}

    def prepare(self, planner, scenario, state):
        """Let the planner mend its flight."""
        if planner._flights:
            planner._mend([state])


class _Devices:
    """DH: where there are data. What a block is known to hold none of, holds none for ever."""

    def __init__(self, scenario, city):
        self._windows = _Windows(scenario, city)
        self._possible = ~(city.building | city.landing)
        self._data = np.zeros(city.shape, np.float64)

    def learn(self, here, observation):
        """Take in what is seen; return whether the devices are no more those that were believed in."""
        windows, before = self._windows, self._data > 0.0
        inside, shown = windows.near(here)
        self._data = np.zeros_like(self._data)
        self._data[inside] = observation["local"][3][shown]
        near = np.zeros(self._data.shape, dtype=bool)
        near[inside] = True
        self._possible[inside] = self._data[inside] > 0.0
        first, scale = windows.first(here), windows.scale
        sums = observation["global"][3].astype(np.float64) * scale * scale
        rest = sums - _block_sums(self._data, *first, scale, *sums.shape)
        for i, j in np.ndindex(*sums.shape):
            r, c = first[0] + i * scale, first[1] + j * scale
            block = slice(max(r, 0), max(r + scale, 0)), slice(max(c, 0), max(c + scale, 0))
            if rest[i, j] <= _TINY:
                self._possible[block] &= near[block]
                continue
            cells = np.argwhere(self._possible[block] & ~near[block])
            if len(cells):
                centre = (np.abs(cells - cells.mean(axis=0)).sum(axis=1) - 99 * before[block][tuple(cells.T)]).argmin()
                self._data[block][tuple(cells[centre])] = rest[i, j]
        return bool(((self._data > 0.0) != before).any())

    def targets(self):
        """Return the target map and the devices that are believed in."""
        cells = np.argwhere(self._data > 0.0).astype(np.int32)
        return {"target": self._data, "device_cell": cells, "device_data": self._data[cells[:, 0], cells[:, 1]]}

    def prepare(self, planner, scenario, state):
        """Let the planner know of the rates of other devices."""
        planner._rates = expected_rates(scenario, state.device_cell)


def _places(scenario, city):
    """Return the cell by the static layers of the global map: no two cells look alike."""
    cells = np.argwhere(~city.no_fly)
    observer, state = Observer(scenario), new_state(len(cells), 1, scenario.shape)
    state.position[:, 0] = cells
    shown = observer.empty(len(cells))
    observer.write(state, np.arange(len(cells)), shown)
    return {view[:3].tobytes(): tuple(cell) for view, cell in zip(shown["global"], cells.tolist(), strict=True)}


@kernel
def _block_sums(values, top, left, scale, high, wide):
    """Return the sums of blocks of which the first begins at (top, left), shape (high, wide)."""
    sums = np.zeros((high, wide))
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            i, j = (r - top) // scale, (c - left) // scale
            if i < high and j < wide:
                sums[i, j] += values[r, c]
    return sums


@kernel
def _fit(likely, known, first, top, left, scale, sums):
    """Scale what is ``likely`` where nothing is known so that every block has its sum (Gordon, Bender, Herman 1970)."""
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
