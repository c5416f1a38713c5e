"""Data harvesting (DH): fly so that radio links empty every IoT device.

Source: Theile et al., ICAR 2021; channel model: Bayerlein et al., GLOBECOM 2020.
"""

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from uavbench.simulation.city_maps import BUILDING_BIT, LANDING_BIT, margin_of
from uavbench.simulation.missions import Mission
from uavbench.simulation.missions.channel import Channel, channel_of, log_below, log_snr_of, square_of
from uavbench.simulation.state import State
from uavbench.world.city import City, city_of, mark_visible
from uavbench.world.episode import Columns
from uavbench.world.kernel import kernel, parallel_kernel, share
from uavbench.world.keyed import CONTENT, NOISE, element, next_integer, next_uniform, normal_above, normal_of, stream
from uavbench.world.parameters import Harvesting
from uavbench.world.scenario import Scenario
from uavbench.world.values import as_array, shown

_CACHED_SIGHTS = 4096

__all__ = ["Devices", "HarvestingMission", "channel_of", "log_snr_of"]  # agents may import the channel from here too


class Devices(NamedTuple):
    """The devices of a batch of B episodes, at most K in each, on an M×N map.

    Attributes
    ----------
    number : ndarray of int32, shape (B,)
        Number of devices.
    cell : ndarray of int32, shape (B, K, 2)
        Their cells (row, column).
    data : ndarray of float64, shape (B, K)
        Data left, in data units.
    sight : ndarray of uint8, shape (B, K, ⌈MN/8⌉)
        The cells with line of sight to each device, as packed bits (lowest bit first).
    """

    number: NDArray[np.int32]
    cell: NDArray[np.int32]
    data: NDArray[np.float64]
    sight: NDArray[np.uint8]


class Sights(NamedTuple):
    """A cache of lines of sight in one city: the views from at most 4096 cells, so that its size is linear in that of the map.

    A scenario with many cities has no cache: its arrays have no entries.

    Attributes
    ----------
    owner : ndarray of int64, shape (S,)
        The cell (its row-major index) whose view each entry holds; −1 for none.
    bits : ndarray of uint8, shape (S, ⌈MN/8⌉)
        The views, as packed bits (lowest bit first).
    """

    owner: NDArray[np.int64]
    bits: NDArray[np.uint8]


class HarvestingMission(Mission):
    """DH for a batch of episodes."""

    option = "devices"

    def __init__(self, scenario: Scenario, parameters: Harvesting, num_envs: int) -> None:
        self._parameters = parameters
        self._margin = margin_of(scenario)
        self._collect_reward = scenario.rewards.collect
        self._channel = channel_of(parameters, scenario.shape)
        self._sights = _sights_of(city_of(scenario)) if scenario.cities is None else _new_sights(scenario.shape, 0)
        self._many = scenario.cities is not None
        # What is read from the map of a city is kept with the map's number, −1 at first: slots in one city share it.
        self._places = np.full(2, -1), np.empty((scenario.shape[0] * scenario.shape[1], 2), dtype=np.int32)
        self._building = np.full(1, -1), np.empty(scenario.shape, dtype=np.bool_)
        max_devices = parameters.devices[1]
        self._served_last = np.full((num_envs, scenario.max_uavs), -1)  # by each UAV: probably it serves the same device next
        self.devices = Devices(
            number=np.zeros(num_envs, dtype=np.int32),
            cell=np.zeros((num_envs, max_devices, 2), dtype=np.int32),
            data=np.zeros((num_envs, max_devices), dtype=np.float64),
            sight=np.zeros((num_envs, max_devices, self._sights.bits.shape[1]), dtype=np.uint8),
        )

    def sample(self, state: State, index: NDArray[np.int64]) -> None:
        """Draw devices: their number, distinct cells outside buildings and landing zones, and their data."""
        low, high = self._parameters.data
        min_devices, max_devices = self._parameters.devices
        d = self.devices
        if self._many:  # the map of a slot may be that of another city now
            self._places[0][0] = -1
        maps = (state.maps.city, state.maps.ground, self._margin, *self._places)
        _sample(index, state.key, d.number, d.cell, d.data, *maps, min_devices, max_devices, low, high)
        self._place(state, index)

    def columns(self, state: State, index: NDArray[np.int64]) -> Columns:
        """Return the devices: ``device_count``, ``device_cell`` and ``device_data``, as in `Devices`."""
        d = self.devices
        return {
            "device_count": d.number[index].astype(np.uint8),
            "device_cell": d.cell[index].astype(np.int16),
            "device_data": d.data[index],
        }

    def restore(self, state: State, index: NDArray[np.int64], columns: Columns) -> None:
        """Set devices from columns."""
        self.devices.number[index] = columns["device_count"]
        self.devices.cell[index] = columns["device_cell"]
        self.devices.data[index] = columns["device_data"]
        self._place(state, index)

    def _place(self, state: State, index: NDArray[np.int64]) -> None:
        """Compute everything that follows from the devices of the slots ``index``."""
        arrays = (state.target, state.spots, state.num_spots, state.total, state.remaining)
        if self._many:
            self._building[0][0] = -1
        maps = (state.maps.city, state.maps.ground, self._margin, *self._building)
        _place(index, *arrays, *self.devices, *maps, self._sights)

    def fits(self, columns: Columns, city: City) -> bool:
        """Return whether frozen columns can belong to this scenario: all devices in allowed cells, with data in the range."""
        if not {"device_count", "device_cell", "device_data"} <= columns.keys():
            return False
        low, high = self._parameters.data
        (min_devices, max_devices), (rows, cols) = self._parameters.devices, city.shape
        there = np.arange(max_devices) < columns["device_count"][:, None]
        r, c = columns["device_cell"][..., 0], columns["device_cell"][..., 1]
        if r.shape != there.shape or columns["device_count"].min() < min_devices or r.max() >= rows or c.max() >= cols:
            return False
        free = ~(city.building | city.landing)
        data = columns["device_data"]
        return bool((free[r, c] & (data >= low) & (data <= high))[there].all())

    def parse(self, value: Any, city: City) -> Columns:
        """Turn rows (row, column, data), shape (K, 3), into columns."""
        table = as_array(value)
        if table is None:
            raise ValueError(f"devices: {shown(value)} is not a table of numbers; expected rows [row, column, data]")
        table = table.astype(np.float64)
        max_devices, largest = self._parameters.devices[1], self._parameters.data[1]
        if table.ndim != 2 or table.shape[1] != 3:
            raise ValueError(f"devices: shape {table.shape}, expected (number of devices, 3): rows [row, column, data]")
        if not 1 <= len(table) <= max_devices:
            raise ValueError(f"devices: {len(table)} devices, but the scenario has 1 to {max_devices}")
        rows, cols = city.shape
        for k, (r, c, data) in enumerate(table.tolist()):
            if not (0 <= r < rows and 0 <= c < cols and r.is_integer() and c.is_integer()):
                raise ValueError(f"devices: device {k} at ({r:g}, {c:g}) is not on a cell of the {rows}×{cols} map")
            for layer in ("building", "landing"):
                if getattr(city, layer)[int(r), int(c)]:
                    raise ValueError(f"devices: device {k} at ({r:g}, {c:g}) is in a {layer} cell")
            if not 0 < data <= largest:
                raise ValueError(f"devices: device {k} has {data:g} data units, must be above 0 and at most {largest:g}")
        if len(np.unique(table[:, :2], axis=0)) < len(table):
            raise ValueError("devices: two devices are on one cell")
        cell, data = np.zeros((1, max_devices, 2)), np.zeros((1, max_devices))
        cell[0, : len(table)], data[0, : len(table)] = table[:, :2], table[:, 2]
        return {"device_count": np.array([len(table)]), "device_cell": cell, "device_data": data}

    def collect(self, state: State, uav: int) -> None:
        """Serve devices in every communication step of UAV ``uav``'s last action, and add r_c per data unit to its reward."""
        arrays: tuple[Any, ...] = (
            state.key,
            uav,
            state.noise,
            state.previous,
            state.position,
            state.budget,
            state.initial_budget,
            state.done,
            state.target,
            state.remaining,
            state.reward,
            *self.devices,
            self._served_last,
            self._collect_reward,
        )
        if self.threads > 1:
            log_gain, exponents, fading, *others = self._channel
            _collect_apart(self.threads, log_gain, *exponents, *fading, *others, *arrays)
        else:
            _collect(0, len(state.done), self._channel, *arrays)

    def collect_at(self, state: State, uav: int, place: tuple[float, float]) -> None:
        """Serve a device in one communication step from a place between cells; its noise is that of its step alone."""
        here: NDArray[Any] = np.full((1, state.done.shape[1], 2), place, dtype=np.float64)
        channel, served = self._channel._replace(steps=1), self._served_last[:1]
        arrays = (state.key, uav, state.noise, here, here, state.budget, state.initial_budget, state.done, state.target)
        _collect(0, 1, channel, *arrays, state.remaining, state.reward, *self.devices, served, self._collect_reward)

    def view(self, i: int) -> Mapping[str, NDArray[Any]]:
        """Return ``device_cell``, shape (K, 2), and ``device_data``, the data left at each device, shape (K,)."""
        d, k = self.devices, self.devices.number[i]
        return {"device_cell": d.cell[i, :k], "device_data": d.data[i, :k]}

    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """Return the devices, as in `Devices`."""
        return self.devices._asdict()

    def marks(self, i: int) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return the devices' cells, and the data left at each device."""
        d, k = self.devices, self.devices.number[i]
        return d.cell[i, :k], d.data[i, :k]

    def shade(self, i: int, city: City) -> NDArray[np.float32]:
        """Return for each cell the share of devices without line of sight to it; 0 for buildings."""
        cells: list[list[int]] = self.marks(i)[0].tolist()
        unseen = sum((~city.visible(cell)).astype(np.float32) for cell in cells)
        return np.where(city.building, 0.0, unseen / max(len(cells), 1)).astype(np.float32)


@kernel
def _sample(
    index: NDArray[np.int64],
    key: NDArray[np.uint64],
    number: NDArray[np.int32],
    cell: NDArray[np.int32],
    data: NDArray[np.float64],
    city: NDArray[np.int64],
    ground: NDArray[np.uint8],
    margin: int,
    listed: NDArray[np.int64],
    places: NDArray[np.int32],
    min_devices: int,
    max_devices: int,
    low: float,
    high: float,
) -> None:
    """Draw the devices of the slots ``index``."""
    cursor = np.empty(1, dtype=np.uint64)
    for n in range(len(index)):
        i = int(index[n])
        if city[i] != listed[0]:
            listed[0], listed[1] = city[i], _fill_places(ground[city[i]], margin, places)
        cursor[0] = stream(key[i], CONTENT)
        cell[i] = 0
        data[i] = 0.0
        number[i] = min_devices + next_integer(cursor, max_devices - min_devices + 1)
        for k in range(number[i]):
            r, c, taken = 0, 0, True
            while taken:
                r, c = places[next_integer(cursor, listed[1])]
                taken = False
                for j in range(k):
                    taken = taken or (cell[i, j, 0] == r and cell[i, j, 1] == c)
            cell[i, k, 0], cell[i, k, 1] = r, c
            data[i, k] = next_uniform(cursor, low, high)


@kernel
def _fill_places(ground: NDArray[np.uint8], margin: int, places: NDArray[np.int32]) -> int:
    """Write the cells of one map where devices may be to ``places``, in row-major order; return their number."""
    number = 0
    for r in range(ground.shape[0] - 2 * margin):
        for c in range(ground.shape[1] - 2 * margin):
            places[number, 0], places[number, 1] = r, c
            number += ground[r + margin, c + margin] & (LANDING_BIT | BUILDING_BIT) == 0
    return number


@lru_cache(maxsize=32)
def _sights_of(city: City) -> Sights:
    """Return the cache of a city, which is empty at first; all simulators of the city share it."""
    return _new_sights(city.shape, min(city.building.size, _CACHED_SIGHTS))


def _new_sights(shape: tuple[int, int], entries: int) -> Sights:
    """Return an empty cache for maps of ``shape``."""
    packed = (shape[0] * shape[1] + 7) // 8
    return Sights(np.full(entries, -1, dtype=np.int64), np.zeros((entries, packed), dtype=np.uint8))


@kernel
def _write_sight(
    sights: Sights, building: NDArray[np.bool_], r: int, c: int, seen: NDArray[np.bool_], out: NDArray[np.uint8]
) -> None:
    """Write the packed view from (r, c), which is computed if the cache does not hold it; ``seen`` is scratch space."""
    cell = r * building.shape[1] + c
    place = cell % len(sights.owner) if len(sights.owner) else -1
    if place >= 0 and sights.owner[place] == cell:
        out[:] = sights.bits[place]
        return
    seen[:] = False
    mark_visible(building, r, c, seen)
    out[:] = 0
    for k, visible in enumerate(seen.reshape(-1)):
        out[k >> 3] |= visible << (k & 7)
    if place >= 0:
        sights.bits[place] = out
        sights.owner[place] = cell


@kernel
def _place(
    index: NDArray[np.int64],
    target: NDArray[np.float32],
    spots: NDArray[np.int32],
    num_spots: NDArray[np.int32],
    total: NDArray[np.float64],
    remaining: NDArray[np.float64],
    number: NDArray[np.int32],
    cell: NDArray[np.int32],
    data: NDArray[np.float64],
    sight: NDArray[np.uint8],
    city: NDArray[np.int64],
    ground: NDArray[np.uint8],
    margin: int,
    copied: NDArray[np.int64],
    building: NDArray[np.bool_],
    sights: Sights,
) -> None:
    """Compute the target map, the lines of sight and the sums of the slots ``index`` from their devices."""
    rows, cols = target.shape[1:]
    seen = np.empty((rows, cols), dtype=np.bool_)
    for i in index:
        if city[i] != copied[0]:
            copied[0] = city[i]
            building[:] = ground[city[i], margin : margin + rows, margin : margin + cols] & BUILDING_BIT > 0
        for j in range(num_spots[i]):
            target[i, spots[i, j, 0], spots[i, j, 1]] = 0.0
        spots[i] = cell[i]
        num_spots[i] = number[i]
        total[i] = 0.0
        for k in range(number[i]):
            r, c = cell[i, k]
            target[i, r, c] = data[i, k]
            total[i] += data[i, k]
            _write_sight(sights, building, r, c, seen, sight[i, k])
        remaining[i] = total[i]


@kernel
def _collect(
    first: int,
    last: int,
    channel: Channel,
    key: NDArray[np.uint64],
    uav: int,
    noise: NDArray[np.bool_],
    previous: NDArray[np.int32],
    position: NDArray[np.int32],
    budget: NDArray[np.int32],
    initial_budget: NDArray[np.int32],
    done: NDArray[np.bool_],
    target: NDArray[np.float32],
    remaining: NDArray[np.float64],
    reward: NDArray[np.float64],
    number: NDArray[np.int32],
    cell: NDArray[np.int32],
    data: NDArray[np.float64],
    sight: NDArray[np.uint8],
    served_last: NDArray[np.int64],
    value: float,
) -> None:
    """Serve the device with the highest rate, in each communication step of UAV ``uav`` in the slots [``first``, ``last``).

    Most devices are excluded by an upper bound of their rate, which takes neither a logarithm nor a quantile. The device that
    was served last is tried first, because it excludes most of the others. The order does not change the result: no bound is
    below the rate, and of devices with equal rates the first one is served.
    """
    for i in range(first, last):
        if done[i, uav]:
            continue
        step = initial_budget[i, uav] - budget[i, uav]
        fading = stream(stream(key[i], NOISE), np.uint64(step))
        r0, c0 = previous[i, uav]
        r1, c1 = position[i, uav]
        gain, count, noisy, best = 0.0, number[i], noise[i], served_last[i, uav]
        for k in range(1, channel.steps + 1):
            r, c = r0 + k / channel.steps * (r1 - r0), c0 + k / channel.steps * (c1 - c0)
            here = np.uint64(_round(r) * target.shape[2] + _round(c))
            byte, bit = here >> np.uint64(3), np.uint8(here & np.uint64(7))
            guess, best, log_snr = best, -1, -math.inf
            for place in range(-1, count):
                j = place if place >= 0 else guess
                if j < 0 or j >= count or (place >= 0 and j == guess) or data[i, j] <= 0.0:
                    continue
                clear = int((sight[i, j, byte] >> bit) & 1)
                square = square_of(channel, cell[i, j, 0], cell[i, j, 1], r, c)
                bits = element(fading, (uav << 32) + (k << 16) + j)
                highest = channel.fading[clear] * normal_above(bits) if noisy else 0.0
                if channel.log_gain - channel.half_exponent[clear] * log_below(square) + highest < log_snr:
                    continue
                level = channel.log_gain - channel.half_exponent[clear] * math.log(square)  # the rate increases with it
                if noisy:
                    level += channel.fading[clear] * normal_of(bits)
                if level > log_snr or (level == log_snr and j < best):
                    best, log_snr = j, level
            if best >= 0:
                served = min(math.log2(1.0 + math.exp(log_snr)), data[i, best])
                data[i, best] -= served
                gain += served
                target[i, cell[i, best, 0], cell[i, best, 1]] = data[i, best]
        served_last[i, uav] = best
        left = 0.0
        for j in range(count):
            left += data[i, j]
        remaining[i] = left
        reward[i, uav] += value * gain


@parallel_kernel
def _collect_apart(
    threads: int,
    log_gain: float,
    exponent: float,
    exponent_los: float,
    fading: float,
    fading_los: float,
    cell_size: float,
    altitude: float,
    steps: int,
    key: NDArray[np.uint64],
    *rest: Any,
) -> None:
    """Call `_collect` for all slots with several threads. Numba can pass numbers and arrays to them, but no named tuple."""
    for part in prange(threads):
        channel = Channel(log_gain, (exponent, exponent_los), (fading, fading_los), cell_size, altitude, steps)
        first, last = share(len(key), part, threads)
        _collect(first, last, channel, key, *rest)


@kernel
def _round(x: float) -> int:
    """Round half to even, as Python does; ``x`` is not negative."""
    low = int(x)
    rest = x - low
    if rest > 0.5 or (rest == 0.5 and low % 2 == 1):
        return low + 1
    return low
