"""Data harvesting (DH): fly so that radio links empty every IoT device.

Source: Theile et al., ICAR 2021; channel model: Bayerlein et al., GLOBECOM 2020.
"""

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.city import City, look
from uavbench.episode import Columns
from uavbench.kernel import kernel
from uavbench.keyed import CONTENT, NOISE, next_integer, next_uniform, normal, stream
from uavbench.missions import Mission
from uavbench.parameters import Harvesting
from uavbench.scenario import Scenario
from uavbench.state import State
from uavbench.values import as_array, shown

_NEPERS_PER_DB = math.log(10.0) / 10.0
_CACHED_SIGHTS = 4096


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
        The cells in line of sight of each device, as packed bits (lowest bit first).
    """

    number: NDArray[np.int32]
    cell: NDArray[np.int32]
    data: NDArray[np.float64]
    sight: NDArray[np.uint8]


class Sights(NamedTuple):
    """A cache of lines of sight: at most 4096 cells' views of the map, so that its size is linear in the map's.

    Attributes
    ----------
    owner : ndarray of int64, shape (S,)
        The cell (its row-major index) whose view each place holds; −1 for none.
    bits : ndarray of uint8, shape (S, ⌈MN/8⌉)
        The views, as packed bits (lowest bit first).
    """

    owner: NDArray[np.int64]
    bits: NDArray[np.uint8]


class Channel(NamedTuple):
    """The channel's parameters, with logarithms taken where a kernel wants them.

    A pair is indexed by line of sight: 0 without, 1 with.
    """

    log_gain: float  # ln γ
    half_exponent: tuple[float, float]  # α/2, for d² instead of d
    fading: tuple[float, float]  # the standard deviation of ln 10^(η/10)
    cell_size: float
    altitude: float
    steps: int


class HarvestingMission(Mission):
    """DH for a batch of episodes."""

    option = "devices"

    def __init__(self, scenario: Scenario, parameters: Harvesting, city: City, num_envs: int) -> None:
        self._parameters = parameters
        self._city = city
        self._collect_reward = scenario.rewards.collect
        self._channel = channel_of(parameters, city.shape)
        self._sights = _sights_of(city)
        self._places = np.argwhere(~(city.building | city.landing)).astype(np.int32)
        most = parameters.devices[1]
        self.devices = Devices(
            number=np.zeros(num_envs, dtype=np.int32),
            cell=np.zeros((num_envs, most, 2), dtype=np.int32),
            data=np.zeros((num_envs, most), dtype=np.float64),
            sight=np.zeros((num_envs, most, self._sights.bits.shape[1]), dtype=np.uint8),
        )

    def sample(self, state: State, index: NDArray[np.int64]) -> None:
        """Draw devices: their number, distinct cells outside buildings and landing zones, and their data."""
        low, high = self._parameters.data
        fewest, most = self._parameters.devices
        _sample(state, self.devices, index, self._places, fewest, most, low, high)
        _place(state, self.devices, index, self._city.building, self._sights)

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
        _place(state, self.devices, index, self._city.building, self._sights)

    def fits(self, columns: Columns) -> bool:
        """Say whether frozen columns can be of this scenario: devices where they may be, with data in its range."""
        if not {"device_count", "device_cell", "device_data"} <= columns.keys():
            return False
        low, high = self._parameters.data
        (fewest, most), (rows, cols) = self._parameters.devices, self._city.shape
        there = np.arange(most) < columns["device_count"][:, None]
        r, c = columns["device_cell"][..., 0], columns["device_cell"][..., 1]
        if r.shape != there.shape or columns["device_count"].min() < fewest or r.max() >= rows or c.max() >= cols:
            return False
        free = ~(self._city.building | self._city.landing)
        data = columns["device_data"]
        return bool((free[r, c] & (data >= low) & (data <= high))[there].all())

    def parse(self, value: Any) -> Columns:
        """Turn rows (row, column, data), shape (K, 3), into columns."""
        table = as_array(value)
        if table is None:
            raise ValueError(f"devices: {shown(value)} is not a table of numbers; expected rows [row, column, data]")
        table = table.astype(np.float64)
        most, largest = self._parameters.devices[1], self._parameters.data[1]
        if table.ndim != 2 or table.shape[1] != 3:
            raise ValueError(f"devices: shape {table.shape}, expected (number of devices, 3): rows [row, column, data]")
        if not 1 <= len(table) <= most:
            raise ValueError(f"devices: {len(table)} of them, the scenario has 1 to {most}")
        rows, cols = self._city.shape
        for k, (r, c, data) in enumerate(table.tolist()):
            if not (0 <= r < rows and 0 <= c < cols and r.is_integer() and c.is_integer()):
                raise ValueError(f"devices: device {k} at ({r:g}, {c:g}) is not on a cell of the {rows}×{cols} map")
            for layer in ("building", "landing"):
                if getattr(self._city, layer)[int(r), int(c)]:
                    raise ValueError(f"devices: device {k} at ({r:g}, {c:g}) is in a {layer} cell")
            if not 0 < data <= largest:
                raise ValueError(f"devices: device {k} has {data:g} data units, must be above 0 and at most {largest:g}")
        if len(np.unique(table[:, :2], axis=0)) < len(table):
            raise ValueError("devices: two of them are on one cell")
        cell, data = np.zeros((1, most, 2)), np.zeros((1, most))
        cell[0, : len(table)], data[0, : len(table)] = table[:, :2], table[:, 2]
        return {"device_count": np.array([len(table)]), "device_cell": cell, "device_data": data}

    def collect(self, state: State, uav: int) -> None:
        """Serve devices in every communication step of the last move, and add r_c per data unit to the rewards."""
        _collect(
            uav,
            state.key,
            state.noise,
            state.previous,
            state.position,
            state.budget,
            state.initial_budget,
            state.done,
            state.target,
            state.row_targets,
            state.remaining,
            state.reward,
            *self.devices,
            self._channel,
            self._collect_reward,
        )

    def view(self, i: int) -> Mapping[str, NDArray[Any]]:
        """Return ``device_cell`` (K, 2) and ``device_data`` (K,) left."""
        d, k = self.devices, self.devices.number[i]
        return {"device_cell": d.cell[i, :k], "device_data": d.data[i, :k]}

    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """Return the devices, as in `Devices`."""
        return self.devices._asdict()

    def marks(self, i: int) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return the devices, with the data left at each."""
        d, k = self.devices, self.devices.number[i]
        return d.cell[i, :k], d.data[i, :k]

    def shade(self, i: int) -> NDArray[np.float32]:
        """Return the share of devices that a cell has no line of sight to; buildings have nothing to see."""
        cells: list[list[int]] = self.marks(i)[0].tolist()
        unseen = sum((~self._city.visible(cell)).astype(np.float32) for cell in cells)
        return np.where(self._city.building, 0.0, unseen / max(len(cells), 1)).astype(np.float32)


def channel_of(parameters: Harvesting, shape: tuple[int, int]) -> Channel:
    """Return the channel on a map of ``shape``.

    γ = 10^(s/10) · (√2/2 · M · cell)^α_los with M the longer side: the signal-to-noise ratio is s at that distance in
    line of sight. The exponent with line of sight normalises both.
    """
    exponent, variance = parameters.path_loss_exponent, parameters.fading_variance
    edge = math.sqrt(2.0) / 2.0 * max(shape) * parameters.cell_size
    return Channel(
        log_gain=parameters.edge_snr * _NEPERS_PER_DB + exponent.los * math.log(edge),
        half_exponent=(exponent.nlos / 2.0, exponent.los / 2.0),
        fading=(math.sqrt(variance.nlos) * _NEPERS_PER_DB, math.sqrt(variance.los) * _NEPERS_PER_DB),
        cell_size=parameters.cell_size,
        altitude=parameters.altitude,
        steps=parameters.communication_steps,
    )


@kernel
def log_snr_of(channel: Channel, y: int, x: int, r: float, c: float, clear: int) -> float:
    """Return ln SNR, without fading, of a UAV at (r, c) to a device in cell (y, x), in line of sight if ``clear`` is 1.

    The logarithm, as it needs one logarithm where the ratio would need two powers.
    """
    down, right = (y - r) * channel.cell_size, (x - c) * channel.cell_size
    square = down * down + right * right + channel.altitude * channel.altitude
    return channel.log_gain - channel.half_exponent[clear] * math.log(square)


@kernel
def _sample(
    state: State,
    devices: Devices,
    index: NDArray[np.int64],
    places: NDArray[np.int32],
    fewest: int,
    most: int,
    low: float,
    high: float,
) -> None:
    """Draw the devices of the slots ``index``."""
    cursor = np.empty(1, dtype=np.uint64)
    for n in range(len(index)):
        i = int(index[n])
        cursor[0] = stream(state.key[i], CONTENT)
        devices.cell[i] = 0
        devices.data[i] = 0.0
        count = fewest + next_integer(cursor, most - fewest + 1)
        devices.number[i] = count
        for k in range(count):
            r, c, taken = 0, 0, True
            while taken:
                r, c = places[next_integer(cursor, len(places))]
                taken = False
                for j in range(k):
                    taken = taken or (devices.cell[i, j, 0] == r and devices.cell[i, j, 1] == c)
            devices.cell[i, k, 0], devices.cell[i, k, 1] = r, c
            devices.data[i, k] = next_uniform(cursor, low, high)


@lru_cache(maxsize=32)
def _sights_of(city: City) -> Sights:
    """Return the empty cache of a city; its simulators share it."""
    cells = city.shape[0] * city.shape[1]
    places = min(cells, _CACHED_SIGHTS)
    return Sights(np.full(places, -1, dtype=np.int64), np.zeros((places, (cells + 7) // 8), dtype=np.uint8))


@kernel
def _sight(sights: Sights, building: NDArray[np.bool_], r: int, c: int, seen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the packed view from (r, c), from the cache or into it; ``seen`` is scratch space."""
    rows, cols = building.shape
    cell = r * cols + c
    place = cell % len(sights.owner)
    bits = sights.bits[place]
    if sights.owner[place] != cell:
        seen[:] = False
        look(building, r, c, rows + cols, seen)
        bits[:] = 0
        for k, visible in enumerate(seen.reshape(-1)):
            bits[k >> 3] |= visible << (k & 7)
        sights.owner[place] = cell
    return bits


@kernel
def _place(state: State, devices: Devices, index: NDArray[np.int64], building: NDArray[np.bool_], sights: Sights) -> None:
    """Make the target map, the lines of sight and the sums of the slots ``index`` from their devices."""
    seen = np.empty(building.shape, dtype=np.bool_)
    for n in range(len(index)):
        i = int(index[n])
        state.target[i] = 0.0
        state.row_targets[i] = 0
        state.total[i] = 0.0
        for k in range(devices.number[i]):
            r, c = devices.cell[i, k]
            state.target[i, r, c] = devices.data[i, k]
            state.row_targets[i, r] += 1
            state.total[i] += devices.data[i, k]
            devices.sight[i, k] = _sight(sights, building, r, c, seen)
        state.remaining[i] = state.total[i]


@kernel
def _collect(
    uav: int,
    key: NDArray[np.uint64],
    noise: NDArray[np.bool_],
    previous: NDArray[np.int32],
    position: NDArray[np.int32],
    budget: NDArray[np.int32],
    initial_budget: NDArray[np.int32],
    done: NDArray[np.bool_],
    target: NDArray[np.float32],
    row_targets: NDArray[np.int32],
    remaining: NDArray[np.float64],
    reward: NDArray[np.float64],
    number: NDArray[np.int32],
    cell: NDArray[np.int32],
    data: NDArray[np.float64],
    sight: NDArray[np.uint8],
    channel: Channel,
    value: float,
) -> None:
    """Serve, in each communication step of UAV ``uav`` of each slot, where it flies on, the device with the highest rate.

    Plain arrays, as in the simulator's ``_move``.
    """
    for i in range(len(done)):
        if done[i, uav]:
            continue
        step = initial_budget[i, uav] - budget[i, uav]
        fading = stream(stream(key[i], NOISE), np.uint64(step))
        r0, c0 = previous[i, uav]
        r1, c1 = position[i, uav]
        gain = 0.0
        for k in range(1, channel.steps + 1):
            r, c = r0 + k / channel.steps * (r1 - r0), c0 + k / channel.steps * (c1 - c0)
            here = np.uint64(_round(r) * target.shape[2] + _round(c))
            byte, bit = here >> np.uint64(3), np.uint8(here & np.uint64(7))
            best, log_snr = -1, -math.inf
            for j in range(number[i]):
                if data[i, j] <= 0.0:
                    continue
                y, x = cell[i, j]
                clear = int((sight[i, j, byte] >> bit) & 1)
                level = log_snr_of(channel, y, x, r, c, clear)  # it orders devices as the rate does
                if noise[i]:
                    level += channel.fading[clear] * normal(fading, (uav << 32) + (k << 16) + j)
                best = j if level > log_snr else best
                log_snr = level if level > log_snr else log_snr
            if best >= 0:
                served = min(math.log2(1.0 + math.exp(log_snr)), data[i, best])
                data[i, best] -= served
                gain += served
                y, x = cell[i, best]
                target[i, y, x] = data[i, best]
                if data[i, best] == 0.0:
                    row_targets[i, y] -= 1
        left = 0.0
        for j in range(number[i]):
            left += data[i, j]
        remaining[i] = left
        reward[i, uav] += value * gain


@kernel
def _round(x: float) -> int:
    """Round half to even, as Python does; ``x`` is not negative."""
    low = int(x)
    rest = x - low
    if rest > 0.5 or (rest == 0.5 and low % 2 == 1):
        return low + 1
    return low
