"""The maps of the cities in which the slots of a batch fly, in the form that the kernels of a step read.

If a scenario has one city, all slots share one map. If it has many, each slot has a map of its own, which is written when an
episode starts in another city. Each value takes one byte (two bytes where a block of the observation has more than 255 cells).
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.simulation.pooling import count_targets, new_counts
from uavbench.world.cells import BUILDING, LANDING, NO_FLY
from uavbench.world.cities import cells_of_cities, city_keys
from uavbench.world.city import City, city_of
from uavbench.world.kernel import kernel
from uavbench.world.scenario import Scenario

#: The static layers, in their order.
STATIC_LAYERS = ("landing", "no_fly", "building")
_NO_CITY = np.uint64(2**64 - 1)
_CELLS_AT_ONCE = 2**25  # cells of cities that are drawn together
_LEAST_MARGIN = 3  # the largest camera sees three cells beyond its UAV


class CityMaps(NamedTuple):
    """The maps of C cities, M×N cells each, for B slots. C is 1 if all slots have the same city, else B.

    Attributes
    ----------
    city : ndarray of int64, shape (B,)
        Which of the C maps each slot has.
    layers : ndarray of bool, shape (C, 3, M + 2p, N + 2p)
        The layers landing, no_fly and building, with a margin of p cells on each side, where no_fly and building are 1.
    blocks : ndarray of uint8, uint16 or uint32, shape (C, 3, g, H, g, W)
        The numbers of cells in the blocks of the global map where a layer is 1, as in `uavbench.simulation.pooling`; cells off
        the map count as in the margin.
    """

    city: NDArray[np.int64]
    layers: NDArray[np.bool_]
    blocks: NDArray[Any]


def margin_of(scenario: Scenario) -> int:
    """Return the width p of the margin around a map: enough for the local map, and for the view of the camera."""
    return max(scenario.observation.local_size // 2, _LEAST_MARGIN)


def margin_within(maps: CityMaps, rows: int) -> int:
    """Return the width p of the margin of maps that have ``rows`` rows without it."""
    return (maps.layers.shape[2] - rows) // 2


def fits(maps: CityMaps, scenario: Scenario) -> bool:
    """Return whether observations of the scenario's sizes can be written from the maps of a state.

    A state of another scenario with the same single map may be observed, too, with maps of its own.

    Raises
    ------
    ValueError
        When they cannot, and the scenario has many cities.
    """
    sizes = scenario.observation
    wide, same = margin_within(maps, scenario.shape[0]) >= sizes.local_size // 2, maps.blocks.shape[2] == sizes.global_scale
    if not (wide and same) and scenario.cities is not None:
        raise ValueError("observation: a state in many cities is observed only with the sizes of its simulator's scenario")
    return wide and same


def new_maps(scenario: Scenario, num_envs: int) -> CityMaps:
    """Return the maps of a batch: the scenario's only map, or room for a map in each slot."""
    margin, scale = margin_of(scenario), scenario.observation.global_scale
    if scenario.cities is None:
        return CityMaps(np.zeros(num_envs, dtype=np.int64), *_only_map(city_of(scenario), margin, scale))
    return CityMaps(np.arange(num_envs), *_room(num_envs, scenario.shape, margin, scale))


def _room(number: int, shape: tuple[int, int], margin: int, scale: int) -> tuple[NDArray[np.bool_], NDArray[Any]]:
    """Return the layers and blocks of ``number`` maps, to be written."""
    rows, cols = (side + 2 * margin for side in shape)
    layers = np.ones((number, len(STATIC_LAYERS), rows, cols), dtype=np.bool_)
    layers[:, 0] = False
    counts = new_counts(number * len(STATIC_LAYERS), shape, scale)
    return layers, counts.reshape(number, len(STATIC_LAYERS), *counts.shape[1:])


@lru_cache(maxsize=32)
def _only_map(city: City, margin: int, scale: int) -> tuple[NDArray[np.bool_], NDArray[Any]]:
    """Return the layers and blocks of one city, read-only; all simulators of the city share them."""
    layers, blocks = _room(1, city.shape, margin, scale)
    write_maps(np.zeros(1, dtype=np.int64), city.cells[None], layers, blocks)
    layers.flags.writeable = blocks.flags.writeable = False
    return layers, blocks


def no_cities(num_envs: int) -> NDArray[np.uint64]:
    """Return what `enter_cities` takes as ``held`` at first, when no slot holds a map."""
    return np.full(num_envs, _NO_CITY)


def enter_cities(
    scenario: Scenario, maps: CityMaps, held: NDArray[np.uint64], index: NDArray[np.int64], keys: NDArray[np.uint64]
) -> None:
    """Write the maps of the cities of the episodes ``keys`` into the slots ``index``, where they are not there already.

    ``held``, shape (B,), has the key of the city whose map each slot holds, and is changed. If the scenario has one map,
    nothing is done.
    """
    if scenario.cities is None:
        return
    cities = city_keys(scenario, keys)
    new = np.flatnonzero(cities != held[index])
    rows, cols = scenario.shape
    most = max(1, _CELLS_AT_ONCE // (rows * cols))
    for first in range(0, len(new), most):
        part = new[first : first + most]
        write_maps(index[part], cells_of_cities(scenario, cities[part]), maps.layers, maps.blocks)
        held[index[part]] = cities[part]


@kernel
def write_maps(index: NDArray[np.int64], cells: NDArray[np.uint8], layers: NDArray[np.bool_], blocks: NDArray[Any]) -> None:
    """Write the maps ``index`` from codes of cells, shape (K, M, N)."""
    rows, cols = cells.shape[1:]
    margin, area = (layers.shape[2] - rows) // 2, blocks.shape[2] ** 2
    ones = np.empty((rows, cols), dtype=np.bool_)
    for n in range(len(index)):
        m = index[n]
        for k in range(layers.shape[1]):
            for r in range(rows):
                inner, row, kinds = layers[m, k, margin + r, margin : margin + cols], ones[r], cells[n, r]
                for c in range(cols):
                    kind = kinds[c]
                    if k == 0:
                        value = kind == LANDING
                    elif k == 1:
                        value = (kind == NO_FLY) | (kind == BUILDING)
                    else:
                        value = kind >= BUILDING
                    inner[c] = value
                    row[c] = value ^ (k > 0)  # counted are the zeros of a layer with a margin of ones
            count_targets(ones, blocks[m, k])
            if k > 0:
                flat = blocks[m, k].reshape(-1)
                for b in range(len(flat)):
                    flat[b] = area - flat[b]


@kernel
def fill_landing_cells(layers: NDArray[np.bool_], margin: int, cells: NDArray[np.int32]) -> int:
    """Write the landing cells of one map, shape (3, M + 2p, N + 2p), to ``cells`` in row-major order; return their number."""
    number = 0
    for r in range(layers.shape[1] - 2 * margin):
        row = layers[0, margin + r]
        for c in range(layers.shape[2] - 2 * margin):
            if row[margin + c]:
                cells[number, 0], cells[number, 1] = r, c
                number += 1
    return number
