"""Data harvesting on large maps: annealing of one long flight, in which only devices near the UAV count.

The search of `uavbench.planning.harvesting` flies the rest of a flight again after each change. Here only the part is flown
again that a change affects: its own cells, and later cells near devices that now have other data left than before.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.planning.changes import propose
from uavbench.planning.distances import Distances
from uavbench.planning.rates import NearRates, action_of
from uavbench.planning.turns import turned
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_uniform

_LENGTH_PRICE = 0.02  # data units that a move costs in the search: shorter flights leave budget for other moves
_COLD = 0.03


class Record(NamedTuple):
    """What a flight collects. Action t leads from its cell t to its cell t + 1.

    Attributes
    ----------
    got : ndarray of float64, shape (T,)
        The data that each action collects.
    after : ndarray of float64, shape (T · width,)
        The data left after each action at the devices near the cell where it begins, in the order of `NearRates`.
    width : int
        The most devices near a cell.
    """

    got: NDArray[np.float64]
    after: NDArray[np.float64]
    width: int


class Trial(NamedTuple):
    """What would be collected after a change.

    Attributes
    ----------
    now : ndarray of float64, shape (K,)
        The data left at devices that have been met.
    met : ndarray of int64, shape (K,)
        The devices that have been met, or later those that differ from the flight before the change.
    is_met : ndarray of bool, shape (K,)
        Whether a device is one of these.
    action : ndarray of int64, shape (T,)
        The actions that collect something else than before, by their number after the change.
    record : Record
        What they collect, in the same order.
    """

    now: NDArray[np.float64]
    met: NDArray[np.int64]
    is_met: NDArray[np.bool_]
    action: NDArray[np.int64]
    record: Record


def new_record(rates: NearRates, longest: int) -> Record:
    """Return the record of a flight of at most ``longest`` actions that collects nothing."""
    width = max(1, int(np.diff(rates.begin).max()))
    return Record(np.zeros(longest), np.zeros(longest * width), width)


def new_trial(rates: NearRates, longest: int) -> Trial:
    """Return arrays for what changes would collect."""
    count = len(rates.cells)
    numbers = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.bool_), np.zeros(longest, dtype=np.int64)
    return Trial(np.zeros(count), *numbers, new_record(rates, longest))


@kernel
def anneal(
    path: NDArray[np.int32],
    length: int,
    longest: int,
    distance: Distances,
    shape: tuple[int, int],
    landing: NDArray[np.int32],
    rates: NearRates,
    data: NDArray[np.float64],
    cursor: NDArray[np.uint64],
    moves: int,
    hot: float,
    horizon: int,
    turn_cost: float,
    flown: Record,
    trial: Trial,
) -> int:
    """Anneal a flight in place (cells 0 to ``length``), and take what it collects out of ``data``; return its new length.

    Only changes that begin in the first ``horizon`` cells are tried.
    """
    cols = shape[1]
    aims = np.empty(len(rates.cells), dtype=np.int64)
    for j in range(len(aims)):
        aims[j] = rates.cells[j, 0] * cols + rates.cells[j, 1]
    served = np.zeros(len(aims), dtype=np.int32)  # always 0: flights should come near to all devices
    new = np.empty(2 * len(path) + 8 * shape[0] * shape[1], dtype=np.int32)
    value = _fly(path, length, rates, data.copy(), cols, flown) - _LENGTH_PRICE * length
    best, best_length, best_value = path.copy(), length, value
    temperature, cooling = hot, (_COLD / hot) ** (1.0 / max(1, moves))
    for _ in range(moves):
        temperature *= cooling
        first, after, size = propose(path, length, longest, distance, shape, landing, aims, served, True, horizon, cursor, new)
        price = turned(path, length, longest, first, after, size, new, cols, turn_cost) if size >= 0 else math.inf
        if price == math.inf:
            continue
        grown = length + size - (after - first - 1)
        gain, affected = _try(path, length, first, after, size, new, rates, data, cols, flown, trial)
        gain -= _LENGTH_PRICE * (grown - length + price)
        if gain < 0.0 and next_uniform(cursor, 0.0, 1.0) >= math.exp(gain / temperature):
            continue
        rest, onward = length + 1 - after, first + 1 + size
        _slide(path, after, onward, rest)
        _slide(flown.got, after, onward, rest - 1)
        _slide(flown.after, after * flown.width, onward * flown.width, (rest - 1) * flown.width)
        path[first + 1 : onward] = new[:size]
        for n in range(affected):
            t = trial.action[n]
            flown.got[t] = trial.record.got[n]
            for k in range(flown.width):
                flown.after[t * flown.width + k] = trial.record.after[n * flown.width + k]
        length = grown
        value += gain
        if value > best_value + 1e-9:
            best_value, best_length = value, length
            best[: length + 1] = path[: length + 1]
    path[:] = best
    _fly(path, best_length, rates, data, cols, flown)
    return best_length


@kernel
def _slide(array: NDArray[Any], begin: int, to: int, count: int) -> None:
    """Copy ``count`` entries of an array, from ``begin`` on, to ``to`` in the same array."""
    if to < begin:
        for k in range(count):
            array[to + k] = array[begin + k]
    elif to > begin:
        for k in range(count - 1, -1, -1):
            array[to + k] = array[begin + k]


@kernel
def _serve(here: int, there: int, rates: NearRates, now: NDArray[np.float64], cols: int) -> float:
    """Serve the devices near cell ``here`` during the action from there to cell ``there``; return the data collected."""
    action = action_of(here, there, cols)
    collected = 0.0
    for k in range(rates.rates.shape[2]):
        best, highest = -1, 0.0
        for n in range(rates.begin[here], rates.begin[here + 1]):
            if now[rates.devices[n]] > 0.0 and rates.rates[n, action, k] > highest:
                best, highest = rates.devices[n], rates.rates[n, action, k]
        if best >= 0:
            got = min(highest, now[best])
            now[best] -= got
            collected += got
    return collected


@kernel
def _fly(path: NDArray[np.int32], length: int, rates: NearRates, data: NDArray[np.float64], cols: int, flown: Record) -> float:
    """Fly a whole flight, record it, and take what it collects out of ``data``; return the data collected."""
    total = 0.0
    for t in range(length):
        flown.got[t] = _serve(path[t], path[t + 1], rates, data, cols)
        total += flown.got[t]
        _note(path[t], rates, data, flown, t)
    return total


@kernel
def _note(here: int, rates: NearRates, now: NDArray[np.float64], record: Record, index: int) -> None:
    """Record the data left at the devices near cell ``here``."""
    begin = rates.begin[here]
    for n in range(begin, rates.begin[here + 1]):
        record.after[index * record.width + n - begin] = now[rates.devices[n]]


@kernel
def _away(cell: int, device: int, rates: NearRates, cols: int) -> int:
    """Return how many moves it takes at least until a device is near; 0 or less if it is near the cell."""
    down, right = abs(cell // cols - rates.cells[device, 0]), abs(cell % cols - rates.cells[device, 1])
    return max(down, right) - rates.reach


@kernel
def _left(
    path: NDArray[np.int32],
    t: int,
    device: int,
    rates: NearRates,
    data: NDArray[np.float64],
    cols: int,
    flown: Record,
) -> float:
    """Return the data left at a device before action ``t`` of a recorded flight, which began with ``data``."""
    k = t - 1
    while k >= 0:
        here = path[k]
        away = _away(here, device, rates, cols)
        if away <= 0:
            begin = rates.begin[here]
            for n in range(begin, rates.begin[here + 1]):
                if rates.devices[n] == device:
                    return float(flown.after[k * flown.width + n - begin])
        k -= away  # the device was not near in any of the actions between
    return data[device]


@kernel
def _try(
    path: NDArray[np.int32],
    length: int,
    first: int,
    after: int,
    size: int,
    new: NDArray[np.int32],
    rates: NearRates,
    data: NDArray[np.float64],
    cols: int,
    flown: Record,
    trial: Trial,
) -> tuple[float, int]:
    """Try the change that `propose` returns; return how much more data are collected, and how many actions are affected.

    The affected actions are in ``trial``, as they are after the change.
    """
    gain, met, affected = 0.0, 0, 0
    for t in range(first, min(after, length)):  # the actions that fall away
        gain -= flown.got[t]
        met = _meet(path[t], path, first, met, rates, data, cols, flown, trial)
    actions = size + 1 if after <= length else size
    here = path[first]
    for k in range(actions):
        there = new[k] if k < size else path[after]
        met = _meet(here, path, first, met, rates, data, cols, flown, trial)
        trial.action[affected] = first + k
        trial.record.got[affected] = _serve(here, there, rates, trial.now, cols)
        gain += trial.record.got[affected]
        _note(here, rates, trial.now, trial.record, affected)
        affected += 1
        here = there
    different = 0  # from here on, only devices that differ from before are kept as met
    for n in range(met):
        j = trial.met[n]
        trial.is_met[j] = after < length and trial.now[j] != _left(path, after, j, rates, data, cols, flown)
        if trial.is_met[j]:
            trial.met[different] = j
            different += 1
    t = after
    while different > 0 and t < length:
        away = len(path)
        for n in range(different):
            away = min(away, _away(path[t], trial.met[n], rates, cols))
        if away > 0:  # none of them is near in the next actions, which therefore remain the same
            t += away
            continue
        here, begin, end = path[t], rates.begin[path[t]], rates.begin[path[t] + 1]
        for n in range(begin, end):
            if not trial.is_met[rates.devices[n]]:
                trial.now[rates.devices[n]] = _left(path, t, rates.devices[n], rates, data, cols, flown)
        trial.action[affected] = first + actions + t - after
        trial.record.got[affected] = _serve(here, path[t + 1], rates, trial.now, cols)
        gain += trial.record.got[affected] - flown.got[t]
        _note(here, rates, trial.now, trial.record, affected)
        affected += 1
        for n in range(begin, end):
            j = rates.devices[n]
            differs = trial.now[j] != flown.after[t * flown.width + n - begin]
            if differs and not trial.is_met[j]:
                trial.met[different] = j
                different += 1
            elif trial.is_met[j] and not differs:
                place = 0
                while trial.met[place] != j:
                    place += 1
                different -= 1
                trial.met[place] = trial.met[different]
            trial.is_met[j] = differs
        t += 1
    for n in range(different):
        trial.is_met[trial.met[n]] = False
    return gain, affected


@kernel
def _meet(
    here: int,
    path: NDArray[np.int32],
    first: int,
    met: int,
    rates: NearRates,
    data: NDArray[np.float64],
    cols: int,
    flown: Record,
    trial: Trial,
) -> int:
    """Add the devices near cell ``here`` to those met, with the data left before action ``first``; return their number."""
    for n in range(rates.begin[here], rates.begin[here + 1]):
        j = rates.devices[n]
        if not trial.is_met[j]:
            trial.is_met[j] = True
            trial.now[j] = _left(path, first, j, rates, data, cols, flown)
            trial.met[met] = j
            met += 1
    return met
