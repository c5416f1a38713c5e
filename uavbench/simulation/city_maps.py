"""The maps of the cities in which the slots of a batch fly, in the form that the kernels of a step read.

If a scenario has one city, all slots share one map. If it has many, each slot has a map of its own, which is written when an
episode starts in another city. A cell takes one byte, which has a bit for each static layer.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.simulation.pooling import new_counts, sum_blocks
from uavbench.simulation.rows import BITS
from uavbench.world.cells import BUILDING, LANDING, NO_FLY
from uavbench.world.cities import cells_of_cities, city_counts, city_key_of, drawer_of
from uavbench.world.city import City, city_of
from uavbench.world.kernel import kernel
from uavbench.world.scenario import Scenario

#: The bits of the static layers in the byte of a cell, in the order of the layers in the observation.
LANDING_BIT, NO_FLY_BIT, BUILDING_BIT = (1 << bit for bit in range(BITS))
_OUTSIDE = NO_FLY_BIT | BUILDING_BIT  # what the observation is padded with
_PLACE = 21  # bits for the count of one layer where three counts are in one number of 64 bits
_NO_CITY = np.uint64(2**64 - 1)
_CELLS_AT_ONCE = 2**25  # cells of cities that are drawn together
_LEAST_MARGIN = 3  # the largest camera sees three cells beyond its UAV


class CityMaps(NamedTuple):
    """The maps of C cities, M×N cells each, for B slots. C is 1 if all slots have the same city, else B.

    Attributes
    ----------
    city : ndarray of int64, shape (B,)
        Which of the C maps each slot has.
    ground : ndarray of uint8, shape (C, M + 2p, N + 2p)
        The cells, with a margin of p cells on each side. A cell has the bits `LANDING_BIT`, `NO_FLY_BIT` and `BUILDING_BIT`
        where those layers are 1; the margin has the last two.
    blocks : ndarray of uint8, uint16 or uint32, shape (C, g, g, 3, H, W)
        ``blocks[m, p, q, k, y, x]`` is the number of cells where layer k is 1 in the block of rows y · g − p to
        y · g − p + g − 1 and columns x · g − q to x · g − q + g − 1. Cells off the map count as in the margin.
    """

    city: NDArray[np.int64]
    ground: NDArray[np.uint8]
    blocks: NDArray[Any]


def margin_of(scenario: Scenario) -> int:
    """Return the width p of the margin around a map: enough for the local map, and for the view of the camera."""
    return max(scenario.observation.local_size // 2, _LEAST_MARGIN)


def margin_within(maps: CityMaps, rows: int) -> int:
    """Return the width p of the margin of maps that have ``rows`` rows without it."""
    return (maps.ground.shape[1] - rows) // 2


def fits(maps: CityMaps, scenario: Scenario) -> bool:
    """Return whether observations of the scenario's sizes can be written from the maps of a state.

    A state of another scenario with the same single map may be observed, too, with maps of its own.

    Raises
    ------
    ValueError
        When they cannot, and the scenario has many cities.
    """
    sizes = scenario.observation
    wide, same = margin_within(maps, scenario.shape[0]) >= sizes.local_size // 2, maps.blocks.shape[1] == sizes.global_scale
    if not (wide and same) and scenario.cities is not None:
        raise ValueError("observation: a state in many cities is observed only with the sizes of its simulator's scenario")
    return wide and same


def new_maps(scenario: Scenario, num_envs: int) -> CityMaps:
    """Return the maps of a batch: the scenario's only map, or room for a map in each slot."""
    margin, scale = margin_of(scenario), scenario.observation.global_scale
    if scenario.cities is None:
        return CityMaps(np.zeros(num_envs, dtype=np.int64), *_only_map(city_of(scenario), margin, scale))
    return CityMaps(np.arange(num_envs), *_room(num_envs, scenario.shape, margin, scale))


def _room(number: int, shape: tuple[int, int], margin: int, scale: int) -> tuple[NDArray[np.uint8], NDArray[Any]]:
    """Return the ground and the blocks of ``number`` maps, to be written."""
    rows, cols = (side + 2 * margin for side in shape)
    counts = new_counts(0, shape, scale)
    _, _, high, _, wide = counts.shape
    blocks = np.zeros((number, scale, scale, BITS, high, wide), dtype=counts.dtype)
    return np.full((number, rows, cols), _OUTSIDE, dtype=np.uint8), blocks


@lru_cache(maxsize=32)
def _only_map(city: City, margin: int, scale: int) -> tuple[NDArray[np.uint8], NDArray[Any]]:
    """Return the ground and the blocks of one city, read-only; all simulators of the city share them."""
    ground, blocks = _room(1, city.shape, margin, scale)
    write_maps(np.zeros(1, dtype=np.int64), city.cells[None], ground, blocks)
    ground.flags.writeable = blocks.flags.writeable = False
    return ground, blocks


class CityWriter:
    """Writes the maps of the cities of episodes into the slots where they start.

    Parameters
    ----------
    scenario : Scenario
        It names the source of the cities.
    maps : CityMaps
        The maps of all slots, which are changed.

    Attributes
    ----------
    keys : ndarray of uint64, shape (B,)
        The key of the city whose map each slot holds; 2⁶⁴ − 1 before its first episode, and always if there is one map.
    """

    def __init__(self, scenario: Scenario, maps: CityMaps) -> None:
        self.keys = np.full(len(maps.city), _NO_CITY)
        self._scenario, self._maps = scenario, maps
        source = scenario.cities
        self._counts = city_counts(source) if source is not None else None
        self._drawer = drawer_of(source) if source is not None and source.generator is not None else None
        self._most = max(1, _CELLS_AT_ONCE // (scenario.shape[0] * scenario.shape[1]))

    def enter(self, index: NDArray[np.int64], keys: NDArray[np.uint64]) -> None:
        """Write the maps of the cities of the episodes ``keys`` into the slots ``index``, where they are not there already."""
        if self._counts is None:
            return
        entered, cities = np.empty(len(index), dtype=np.int64), np.empty(len(index), dtype=np.uint64)
        number, trained = _list_new(index, keys, self._counts, self.keys, entered, cities)
        for first in range(0, number, self._most):
            part = slice(first, min(number, first + self._most))
            slots, new = entered[part], cities[part]
            write_maps(slots, self._cells(new, trained), self._maps.ground, self._maps.blocks)
            self.keys[slots] = new  # only now, because to draw or to read the cities may fail

    def _cells(self, cities: NDArray[np.uint64], trained: bool) -> NDArray[np.uint8]:
        """Return the maps of cities as codes of cells; ``trained`` says whether all of them belong to the train split."""
        if self._drawer is None or not trained:
            return cells_of_cities(self._scenario, cities)
        cells = np.empty((len(cities), *self._scenario.shape), dtype=np.uint8)
        self._drawer.draw(cities, cells)
        return cells


@kernel
def _list_new(
    index: NDArray[np.int64],
    keys: NDArray[np.uint64],
    counts: NDArray[np.uint64],
    held: NDArray[np.uint64],
    slots: NDArray[np.int64],
    new: NDArray[np.uint64],
) -> tuple[int, bool]:
    """List the slots that do not hold the cities of the episodes ``keys`` yet, and the keys of these cities.

    Returns how many slots they are, and whether all of these cities belong to the train split.
    """
    number, trained = 0, True
    for n in range(len(index)):
        city = city_key_of(keys[n], counts)
        if city != held[index[n]]:
            slots[number], new[number] = index[n], city
            number += 1
            trained = trained and city >> np.uint64(62) == 0
    return number, trained


@kernel
def write_maps(index: NDArray[np.int64], cells: NDArray[np.uint8], ground: NDArray[np.uint8], blocks: NDArray[Any]) -> None:
    """Write the maps ``index`` from codes of cells, shape (K, M, N)."""
    rows, cols = cells.shape[1:]
    margin, (scale, _, _, high, wide) = (ground.shape[1] - rows) // 2, blocks.shape[1:]
    marks = np.empty((rows, cols), dtype=np.uint64)  # the layers side by side, so that all of them are counted at once
    sums = np.empty((high * scale, wide * scale), dtype=np.uint64)
    for n in range(len(index)):
        m = index[n]
        for r in range(rows):
            inner, kinds, row = ground[m, margin + r, margin : margin + cols], cells[n, r], marks[r]
            for c in range(cols):
                kind = kinds[c]  # without a table or a branch, so that the loop is vectorised
                lands, hides = np.uint8(kind == LANDING), np.uint8(kind >= BUILDING)
                closed = np.uint8(kind == NO_FLY) | np.uint8(kind == BUILDING)
                inner[c] = lands * LANDING_BIT + closed * NO_FLY_BIT + hides * BUILDING_BIT
                # Counted are the cells that differ from the margin.
                row[c] = np.uint64(lands) | np.uint64(1 - closed) << _PLACE | np.uint64(1 - hides) << 2 * _PLACE
        sums[:] = 0
        sum_blocks(marks, scale, sums)
        for top in range(len(sums)):
            y = top // scale
            _write_blocks(sums[top], y, scale, blocks[m, (y + 1) * scale - 1 - top])


@kernel
def _write_blocks(block: NDArray[np.uint64], y: int, scale: int, out: NDArray[Any]) -> None:
    """Write the counts of the blocks that begin in one row, for each phase q, to row ``y`` of ``out``, shape (g, 3, H, W)."""
    area, mask = np.uint64(scale * scale), np.uint64((1 << _PLACE) - 1)
    for q in range(scale):
        landing, no_fly, building, place = out[q, 0, y], out[q, 1, y], out[q, 2, y], np.uint64(scale - 1 - q)
        for x in range(len(landing)):
            number = block[place]
            landing[x] = number & mask
            no_fly[x] = area - ((number >> np.uint64(_PLACE)) & mask)
            building[x] = area - (number >> np.uint64(2 * _PLACE))
            place += np.uint64(scale)


@kernel
def fill_landing_cells(ground: NDArray[np.uint8], margin: int, cells: NDArray[np.int32]) -> int:
    """Write the landing cells of one map, shape (M + 2p, N + 2p), to ``cells`` in row-major order; return their number."""
    number = 0
    for r in range(ground.shape[0] - 2 * margin):
        row = ground[margin + r]
        for c in range(ground.shape[1] - 2 * margin):
            if row[margin + c] & LANDING_BIT:
                cells[number, 0], cells[number, 1] = r, c
                number += 1
    return number
