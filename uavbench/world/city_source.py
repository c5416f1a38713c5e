"""Where the cities of a scenario come from, if it has more than one map: the table ``[cities]`` of a scenario.

This module does not import Numba: scenarios must be quick to read. `uavbench.world.cities` draws the cities.
"""

from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from uavbench.world.cells import CHARACTERS, FREE, LANDING, NO_FLY
from uavbench.world.generators import GENERATORS, LARGEST_SIDE, SMALLEST_SIDE, check_demands
from uavbench.world.generators.parameters import CityParameters
from uavbench.world.maps import check_map
from uavbench.world.parameters import Count, Record

_Side = Annotated[int, Field(ge=SMALLEST_SIDE, le=LARGEST_SIDE, strict=True)]
_Maps = Annotated[tuple[tuple[str, ...], ...], Field(min_length=1)]


class FrozenCities(Record):
    """A file of cities: its name, relative to the scenario's file, and its SHA-256."""

    file: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class MapFiles(Record):
    """The map files of each split, relative to the scenario's file."""

    train: tuple[str, ...]
    validation: tuple[str, ...]
    test: tuple[str, ...]


class SplitMaps(Record):
    """The maps of each split, as rows of text."""

    train: _Maps
    validation: _Maps
    test: _Maps

    @field_validator("train", "validation", "test")
    @classmethod
    def _flyable(cls, maps: tuple[tuple[str, ...], ...]) -> tuple[tuple[str, ...], ...]:
        for number, rows in enumerate(maps):
            try:
                check_map(rows)
            except ValueError as error:
                raise ValueError(f"map {number}: {error}") from None
        return maps

    @model_validator(mode="after")
    def _alike(self) -> "SplitMaps":
        shapes = {(len(rows), len(rows[0])) for rows in (*self.train, *self.validation, *self.test)}
        if len(shapes) > 1:
            raise ValueError(f"its maps have the shapes {sorted(shapes)}: all maps of a scenario must have the same shape")
        known: dict[tuple[str, ...], str] = {}
        for split in ("train", "validation", "test"):
            for number, rows in enumerate(getattr(self, split)):
                here = f"map {number} of {split}"
                if rows in known:
                    raise ValueError(f"{here} is the same as {known[rows]}: a city may be in one split only, and only once")
                known[rows] = here
        return self


class Cities(Record):
    """A source of many cities of one shape. An episode's key decides in which city the episode takes place.

    The cities come from a generator, or from files of maps for each split. The cities of the splits are disjoint.

    Attributes
    ----------
    generator : str, optional
        The generator with its version, for example ``"mixed-v0"``: see `uavbench.world.generators`.
    shape : (int, int), optional
        Rows and columns of a generated city.
    validation, test : int, optional
        How many generated cities these splits have. Episode n of the split takes place in city n modulo this number.
    train : int, optional
        How many generated cities the train split has; without it, nearly every train episode has a city of its own.
    reach : int, optional
        In a generated city, at least 95 % of the cells that can be flown are within so many moves of a landing cell. Half
        the largest budget is a good value. By default it is the sum of rows and columns.
    landing_cells, places : int
        How many landing cells a generated city has at least, and how many cells for devices.
    parameters : CityParameters
        The parameters of the generator.
    frozen : FrozenCities, optional
        A file of the generated validation and test cities, so that a change of the generator cannot change them:
        `uavbench freeze` writes it.
    files : MapFiles, optional
        Files of maps for each split, instead of a generator.
    maps : SplitMaps, optional
        The content of ``files``.
    """

    generator: str | None = None
    shape: tuple[_Side, _Side] | None = None
    validation: Count | None = None
    test: Count | None = None
    train: Count | None = None
    reach: Count | None = None
    landing_cells: Count = 4
    places: Count = 10
    parameters: CityParameters = CityParameters()
    frozen: FrozenCities | None = None
    files: MapFiles | None = None
    maps: SplitMaps | None = None

    @field_validator("generator")
    @classmethod
    def _known(cls, generator: str | None) -> str | None:
        if generator is not None and generator not in GENERATORS:
            raise ValueError(f"{generator!r} is not one of {', '.join(GENERATORS)}")
        return generator

    @model_validator(mode="after")
    def _one_source(self) -> "Cities":
        if (self.generator is None) == (self.maps is None):
            raise ValueError("cities come from a generator or from files: give one of them")
        needed = {"shape": self.shape, "validation": self.validation, "test": self.test}
        if self.maps is not None:
            own: dict[str, Any] = {**needed, "train": self.train, "reach": self.reach, "frozen": self.frozen}
            given = [name for name, value in own.items() if value is not None]
            if given:
                raise ValueError(f"{given[0]} belongs to a generator; the files give the maps and how many there are")
        else:
            missing = [name for name, value in needed.items() if value is None]
            if missing:
                raise ValueError(f"{missing[0]} is missing: a generator needs shape, validation and test")
            check_demands(self.map_shape, self.moves_to_land, self.landing_cells, self.places)
        return self

    @property
    def map_shape(self) -> tuple[int, int]:
        """Rows and columns of the maps."""
        if self.maps is not None:
            return len(self.maps.train[0]), len(self.maps.train[0][0])
        assert self.shape is not None
        return self.shape

    @property
    def number_of_test_cities(self) -> int:
        """How many cities the test split has."""
        return len(self.maps.test) if self.maps is not None else self.test or 0

    @property
    def moves_to_land(self) -> int:
        """Within how many moves of a landing cell at least 95 % of the cells are that can be flown: see ``reach``."""
        return self.reach or sum(self.map_shape)

    @property
    def least_landing_cells(self) -> int:
        """How many landing cells every city has at least."""
        return self._least(self.landing_cells, LANDING)

    @property
    def least_places(self) -> int:
        """How many cells for devices every city has at least: free cells and no-fly zones."""
        return self._least(self.places, FREE, NO_FLY)

    def _least(self, promised: int, *codes: int) -> int:
        """Return the least number of cells with ``codes`` in the maps of files; in generated cities what is ``promised``."""
        if self.maps is None:
            return promised
        maps = (*self.maps.train, *self.maps.validation, *self.maps.test)
        return min(sum("".join(rows).count(CHARACTERS[code]) for code in codes) for rows in maps)
