"""The map that somebody wants to look at: a scenario's only one, or that of one of its cities."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uavbench.errors import UavbenchError, one_line
from uavbench.world.cells import cells_of
from uavbench.world.files import write_atomic
from uavbench.world.maps import map_picture
from uavbench.world.scenario import SPLITS, Scenario, SplitName
from uavbench.world.values import shown


class CityError(UavbenchError):
    """A picture of a city cannot be saved; the message says why."""


def shown_city(scenario: Scenario, split: str, number: int) -> NDArray[np.uint8]:
    """Return city ``number`` of ``split`` as codes of cells, shape (M, N); the only map is city 0 of each split.

    Raises
    ------
    ValueError
        When there is no such split, or it has no such city.
    """
    named: SplitName | None = next((name for name in SPLITS if name == split), None)
    if named is None:
        raise CityError(f"split: {shown(split)} is not one of {', '.join(SPLITS)}")
    if scenario.cities is None:
        if number:
            raise ValueError(f"city: {number} is out of range; {scenario.id} has one map, city 0")
        return cells_of(scenario.rows)
    from uavbench.world.cities import cells_of_cities, city_key

    return cells_of_cities(scenario, np.array([city_key(scenario, named, number)]))[0]


def save_city_picture(cells: NDArray[np.uint8], path: Path) -> None:
    """Save a map, given as codes of cells, as a PNG picture: see `uavbench.world.maps.map_picture`.

    Raises
    ------
    CityError
        When the file has another ending, or cannot be written.
    """
    if path.suffix.lower() != ".png":
        raise CityError(f"{one_line(path)}: a map is saved as a PNG picture: choose a name that ends in .png")
    try:
        write_atomic(path, map_picture(cells))
    except OSError as error:
        raise CityError(f"{one_line(path)}: cannot write it: {error.strerror}") from None
