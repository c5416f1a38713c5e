"""The cities of a scenario: which one an episode has, and drawing them.

A scenario with one map has one city. Otherwise the key of an episode gives the key of its city, so that nothing else need be
stored. The two highest bits of a city's key name the split, as in the keys of episodes: the cities of the splits are disjoint.
"""

import hashlib
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import CHARACTERS, cells_of
from uavbench.world.city import City
from uavbench.world.city_source import Cities
from uavbench.world.episode import Columns, episode_keys
from uavbench.world.files import ARRAYS_BYTES, FileError, read_bounded, unpack_arrays
from uavbench.world.generators import CityDrawer
from uavbench.world.kernel import kernel
from uavbench.world.keyed import CITY, stream
from uavbench.world.resources import scenario_paths
from uavbench.world.scenario import SPLITS, Scenario, ScenarioError, SplitName

#: The splits whose generated cities may be frozen in a file.
FROZEN: tuple[SplitName, ...] = ("validation", "test")
_REDRAWN = 4  # frozen cities of each split that are drawn again, to check that they belong to the scenario as it is now
_NUMBER = np.uint64(2**62 - 1)  # the bits of a key that are not the split's


def city_keys(scenario: Scenario, keys: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return the keys of the cities of the episodes ``keys``, shape (K,); 0 for all if the scenario has one map.

    Validation and test episode n takes place in city n modulo the number of cities. In the train split, and in episodes that
    belong to no split, the city is drawn from the episode's key.
    """
    found = np.zeros(len(keys), dtype=np.uint64)
    if scenario.cities is not None:
        _write_city_keys(keys, city_counts(scenario.cities), found)
    return found


def city_counts(source: Cities) -> NDArray[np.uint64]:
    """Return how many cities each split has, in the order of `SPLITS`, and how many there are for episodes of no split.

    0 means that there is no limit.
    """
    counts = [city_count(source, split) for split in SPLITS]
    # Episodes of no split take place in cities of their own, or in the test split's maps.
    return np.array([*counts, counts[-1] if source.maps is not None else 0], dtype=np.uint64)


def city_count(source: Cities, split: SplitName) -> int:
    """Return how many cities a split has; 0 if the number is not limited."""
    if source.maps is not None:
        return len(getattr(source.maps, split))
    return getattr(source, split) or 0


def city_numbers(scenario: Scenario, split: SplitName, numbers: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """Return the number of the city of each of the episodes ``numbers`` of ``split``; None if the scenario has one map.

    Episodes with the same number of the city are in the same city: they are not independent.
    """
    if scenario.cities is None:
        return None
    return (city_keys(scenario, episode_keys(split, numbers)) & _NUMBER).astype(np.int64)


def city_key(scenario: Scenario, split: SplitName, number: int) -> np.uint64:
    """Return the key of city ``number`` of ``split``.

    Raises
    ------
    ValueError
        When the scenario has one map, or the split has no such city.
    """
    source = scenario.cities
    if source is None:
        raise ValueError(f"city: {scenario.id} has one map")
    count = city_count(source, split) or int(_NUMBER) + 1
    if not 0 <= number < count:
        raise ValueError(f"city: {number} is out of range; {scenario.id} has {split} cities 0 to {count - 1}")
    return episode_keys(split, np.array([number], dtype=np.int64))[0]


def cells_of_cities(scenario: Scenario, keys: NDArray[np.uint64]) -> NDArray[np.uint8]:
    """Return the maps of the cities ``keys`` as codes of cells, shape (K, M, N).

    Raises
    ------
    ScenarioError
        When the file of frozen cities is missing or damaged.
    """
    if scenario.cities is None:
        return np.broadcast_to(cells_of(scenario.rows), (len(keys), *scenario.shape))
    splits = (keys >> np.uint64(62)).astype(np.int64)
    if scenario.cities.maps is None and not splits.any():
        return draw_city_cells(scenario.cities, keys)  # the usual case in a training
    cells = np.empty((len(keys), *scenario.shape), dtype=np.uint8)
    for place in np.unique(splits).tolist():
        index = np.flatnonzero(splits == place)
        known = _known_cities(scenario, place)
        if known is None:
            cells[index] = draw_city_cells(scenario.cities, keys[index])
        else:
            cells[index] = known[(keys[index] & _NUMBER).astype(np.int64)]
    return cells


def draw_city_cells(source: Cities, keys: NDArray[np.uint64]) -> NDArray[np.uint8]:
    """Return the cities ``keys`` as the generator of the source draws them now, whether or not they are frozen."""
    cells = np.empty((len(keys), *source.map_shape), dtype=np.uint8)
    drawer_of(source).draw(np.ascontiguousarray(keys), cells)
    return cells


def drawer_of(source: Cities) -> CityDrawer:
    """Return what draws the cities of a source with a generator."""
    assert source.generator is not None
    return CityDrawer(source.generator, source.parameters, source.moves_to_land, source.landing_cells, source.places)


def city_at(scenario: Scenario, key: np.uint64) -> City:
    """Return the city with this key; the last ones are kept."""
    return _city_at(_Source(scenario), int(key))


class _Source:
    """A scenario as the key of a cache: equal digests mean equal cities."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario

    def __hash__(self) -> int:
        return hash(self.scenario.digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Source) and other.scenario.digest == self.scenario.digest


@lru_cache(maxsize=256)
def _city_at(source: _Source, key: int) -> City:
    return City(cells_of_cities(source.scenario, np.array([key], dtype=np.uint64))[0])


def _known_cities(scenario: Scenario, place: int) -> NDArray[np.uint8] | None:
    """Return the maps of the split at ``place``, shape (cities, M, N), if they are read from files; else None."""
    source = scenario.cities
    assert source is not None
    split = SPLITS[min(place, len(SPLITS) - 1)]
    if source.maps is not None:
        return _maps_of_files(getattr(source.maps, split))
    frozen = source.frozen
    if frozen is None or split not in FROZEN or place >= len(SPLITS):
        return None
    assert source.validation is not None
    assert source.test is not None
    numbers = (source.validation, source.test)
    path = scenario.path.parent / frozen.file
    cities = _frozen_cities(scenario.path, path, frozen.sha256, numbers, source.map_shape)
    _check_drawn(_Source(scenario))
    return cities[split]


@lru_cache(maxsize=32)
def _check_drawn(source: _Source) -> None:
    """Refuse frozen cities that the generator does not draw, because the scenario was edited after they were frozen.

    Shipped scenarios are not checked: their cities stay valid even if a generator changes.
    """
    scenario = source.scenario
    cities = scenario.cities
    if scenario_paths().get(scenario.id) == scenario.path or cities is None or cities.frozen is None:
        return
    assert cities.validation is not None
    assert cities.test is not None
    path = scenario.path.parent / cities.frozen.file
    known = _frozen_cities(scenario.path, path, cities.frozen.sha256, (cities.validation, cities.test), cities.map_shape)
    for split in FROZEN:
        first = known[split][:_REDRAWN]
        if not np.array_equal(first, draw_city_cells(cities, episode_keys(split, np.arange(len(first))))):
            raise ScenarioError(
                f"{scenario.path}: cities.frozen.file: {path} holds other cities than the generator draws by [cities], which "
                "has changed since they were frozen: choose a new id, remove [cities.frozen] and the "
                "[splits] that name files, and run uavbench freeze"
            )


@lru_cache(maxsize=32)
def _maps_of_files(maps: tuple[tuple[str, ...], ...]) -> NDArray[np.uint8]:
    return np.stack([cells_of(rows) for rows in maps])


@lru_cache(maxsize=32)
def _frozen_cities(scenario: Path, path: Path, sha256: str, numbers: tuple[int, int], shape: tuple[int, int]) -> Columns:
    """Read a file of frozen cities, and refuse one that does not belong to this scenario."""
    where = f"{scenario}: cities.frozen.file"
    try:
        content = read_bounded(path, ARRAYS_BYTES)
        found = hashlib.sha256(content).hexdigest()
        if found != sha256:
            raise ScenarioError(f"{scenario}: cities.frozen.sha256: {path} has {found}: it is not the frozen file")
        cities = unpack_arrays(content)
    except FileError as error:
        raise ScenarioError(f"{where}: {error}") from None
    except ScenarioError:
        raise
    except ValueError as error:
        raise ScenarioError(f"{where}: {path}: {error}") from None
    expected: dict[str, int] = dict(zip(FROZEN, numbers, strict=True))
    fits = cities.keys() == expected.keys() and all(
        cities[name].dtype == np.uint8 and cities[name].shape == (number, *shape) and cities[name].max() < len(CHARACTERS)
        for name, number in expected.items()
    )
    if not fits:
        raise ScenarioError(f"{where}: {path} does not hold the cities that the scenario describes")
    for array in cities.values():
        array.flags.writeable = False
    return cities


@kernel
def city_key_of(key: np.uint64, counts: NDArray[np.uint64]) -> np.uint64:
    """Return the key of the city of one episode: see `city_keys`. ``counts`` are those of `city_counts`."""
    mask, split_bits, two = np.uint64(2**62 - 1), np.uint64(62), np.uint64(2)
    split = key >> split_bits
    number = key & mask
    if split == 0 or split == 3:
        number = stream(key, CITY) >> two
    if counts[split] > 0:
        number %= counts[split]
    return (split << split_bits) | number


@kernel
def _write_city_keys(keys: NDArray[np.uint64], counts: NDArray[np.uint64], found: NDArray[np.uint64]) -> None:
    """Write the keys of the cities of the episodes ``keys``."""
    for n in range(len(keys)):
        found[n] = city_key_of(keys[n], counts)
