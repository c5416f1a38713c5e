"""Scenarios: everything that is fixed under one id. Loading, validation, digests.

Source: Theile et al., ICAR 2021; the values of the shipped scenarios are in ``scenarios/*.toml``.
"""

import difflib
import hashlib
import json
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, SupportsIndex, cast

from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, SerializeAsAny, ValidationError, field_validator, model_validator

from uavbench.errors import UavbenchError, one_line
from uavbench.world import resources
from uavbench.world.cells import CHARACTERS, LANDING
from uavbench.world.city_source import Cities, MapFiles
from uavbench.world.files import FileError, read_toml
from uavbench.world.maps import check_map, read_map, rows_of_array
from uavbench.world.parameters import (
    Count,
    MissionParameters,
    ObservationSizes,
    Record,
    Rewards,
    TeamSize,
    ordered,
)
from uavbench.world.provenance import Provenance
from uavbench.world.registry import read_mission
from uavbench.world.values import as_integer

SplitName = Literal["train", "validation", "test"]
SPLITS: tuple[SplitName, ...] = ("train", "validation", "test")


class ScenarioError(UavbenchError, ValueError):
    """A scenario that cannot be used; the message names the file, the field and the reason."""


class Split(Record):
    """A split of fixed size.

    Attributes
    ----------
    episodes : int
        Number of episodes.
    file : str, optional
        The file of frozen episodes, relative to the scenario's file; without it, episodes are drawn from their keys.
    sha256 : str, optional
        SHA-256 of that file.
    """

    episodes: Count
    file: str | None = None
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] | None = None

    @model_validator(mode="after")
    def _file_with_digest(self) -> "Split":
        if (self.file is None) != (self.sha256 is None):
            raise ValueError("file and sha256 go together: give both, or neither")
        return self


class Splits(Record):
    """The splits of fixed size; ``train`` has 2⁶² episodes and needs no entry."""

    validation: Split = Split(episodes=200)
    test: Split = Split(episodes=1000)


class _Budget(Record):
    """A range of budgets, to check it without a scenario."""

    budget: tuple[Count, Count]

    _range = field_validator("budget")(ordered)


class Scenario(Record):
    """Everything fixed under one id.

    Attributes
    ----------
    id : str
        The name with its version at the end: ``Manhattan32-CPP-v0``.
    title : str
        A description of one line, for tables.
    map : str
        The map's file, relative to the scenario's file; see `rows`. Empty if the scenario has many cities.
    cities : Cities, optional
        Where the cities come from, if the scenario has many.
    budget : (int, int)
        Smallest and largest movement budget of an episode; in a team each UAV has its own.
    uavs : (int, int), optional
        Smallest and largest number of UAVs of an episode, at most 16. If given, the scenario is for a team, else for one UAV.
    rewards, observation, mission, splits, provenance
        See their classes.
    rows : tuple of str
        The map if there is only one, else empty. One character per cell: ``.`` free, ``L`` landing zone, ``N`` no-fly zone,
        ``#`` building, ``b`` low building.
    path : Path
        The file that the scenario was read from.
    """

    id: Annotated[str, Field(max_length=100, pattern=r"^[A-Za-z0-9]+(-[A-Za-z0-9]+)*-v[0-9]+$")]
    title: str
    map: str = ""
    cities: Cities | None = None
    budget: tuple[Count, Count]
    uavs: tuple[TeamSize, TeamSize] | None = None
    rewards: Rewards
    observation: ObservationSizes
    mission: SerializeAsAny[Annotated[MissionParameters, BeforeValidator(read_mission)]]
    splits: Splits = Splits()
    provenance: Provenance | None = None
    rows: tuple[str, ...] = ()
    path: Path

    _ranges = field_validator("budget")(ordered)

    @field_validator("uavs")
    @classmethod
    def _team(cls, bounds: tuple[int, int] | None) -> tuple[int, int] | None:
        if bounds is not None:
            ordered(bounds)
        return bounds

    @field_validator("rows")
    @classmethod
    def _map(cls, rows: tuple[str, ...]) -> tuple[str, ...]:
        if rows:  # a scenario with many cities has none
            check_map(rows)
        return rows

    @model_validator(mode="after")
    def _fits(self) -> "Scenario":
        if bool(self.rows) == (self.cities is not None):
            raise ValueError("map: is missing: name a map's file, or write a table [cities]; not both")
        _check_sizes(self.observation, self.shape)
        starts = self.cities.least_landing_cells if self.cities else sum(row.count(CHARACTERS[LANDING]) for row in self.rows)
        if starts < self.max_uavs:
            raise ValueError(f"uavs: up to {self.max_uavs} start in landing cells of their own, and the map has {starts}")
        if self.cities is None:
            self.mission.check_map(self.rows)
        else:
            self.mission.check_cities(self.cities)
        return self

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self.cities.map_shape if self.cities else (len(self.rows), len(self.rows[0]))

    @property
    def observation_bytes(self) -> int:
        """Size in bytes of the maps in the observation of one UAV, without layers that are the mission's own."""
        (rows, cols), sizes = self.shape, self.observation
        cells = sizes.local_size**2 + (2 * rows - 1) // sizes.global_scale * ((2 * cols - 1) // sizes.global_scale)
        return 4 * (6 if self.team else 4) * cells

    @property
    def team(self) -> bool:
        """Whether the scenario is for a team, whose UAVs see each other; an episode may still have only one UAV."""
        return self.uavs is not None

    @property
    def max_uavs(self) -> int:
        """The largest number of UAVs of an episode."""
        return self.uavs[1] if self.uavs else 1

    @cached_property
    def digest(self) -> str:
        """SHA-256 of everything that defines the scenario; the title and the names of files are not part of it."""
        parts = self.model_dump(mode="json", exclude={"title", "map", "path", "provenance"}, exclude_defaults=True)
        cities = parts.get("cities", {})
        cities.pop("files", None)  # the content of the maps remains in the digest
        for part in (parts["mission"], cities.get("frozen", {}), *parts.get("splits", {}).values()):
            part.pop("file", None)  # the SHA-256 of the file remains in the digest
        return hashlib.sha256(json.dumps(parts, sort_keys=True, separators=(",", ":")).encode()).hexdigest()

    @property
    def map_digest(self) -> str:
        """SHA-256 of the map; if there are many, of what decides which cities there are."""
        if self.cities is None:
            return hashlib.sha256("\n".join(self.rows).encode()).hexdigest()
        parts = self.cities.model_dump_json(exclude={"frozen", "files"})
        return hashlib.sha256(parts.encode()).hexdigest()

    def with_observation(self, local_size: int | None = None, global_scale: int | None = None) -> "Scenario":
        """Return the same scenario with another local size or global scale of the observation.

        Raises
        ------
        ValueError
            When the sizes do not fit the map.
        """
        sizes = {"local_size": local_size, "global_scale": global_scale}
        changed = {name: size for name, size in sizes.items() if size is not None}
        try:
            observation = ObservationSizes(**{**self.observation.model_dump(), **changed})
        except ValidationError as error:
            raise ValueError(_first(error)) from None
        _check_sizes(observation, self.shape)
        return self._changed(observation=observation)

    def with_rewards(self, **terms: float) -> "Scenario":
        """Return the same scenario with other terms of the reward.

        Parameters
        ----------
        **terms : float
            Any of ``movement``, ``safety``, ``crash`` and ``collect``: see `uavbench.world.parameters.Rewards`.

        Raises
        ------
        ValueError
            When there is no such term, or it is not a finite number.

        Examples
        --------
        >>> import uavbench
        >>> uavbench.load_scenario("Manhattan32-CPP-v0").with_rewards(crash=-50.0).rewards.crash
        -50.0
        """
        try:
            return self._changed(rewards=Rewards(**{**self.rewards.model_dump(), **terms}))
        except ValidationError as error:
            raise ValueError(f"rewards.{_first(error)}") from None

    def with_budget(self, low: int, high: int) -> "Scenario":
        """Return the same scenario with another range of movement budgets. Its episodes are drawn anew; none are frozen.

        Raises
        ------
        ValueError
            When the range is not 1 ≤ ``low`` ≤ ``high`` ≤ 30,000.

        Examples
        --------
        >>> import uavbench
        >>> uavbench.load_scenario("Manhattan32-CPP-v0").with_budget(20, 40).budget
        (20, 40)
        """
        try:
            checked = _Budget(budget=(low, high))
        except ValidationError as error:
            raise ValueError(_first(error)) from None
        drawn = {name: Split(episodes=split.episodes) for name, split in self.splits}
        return self._changed(budget=checked.budget, splits=Splits(**drawn))

    @classmethod
    def from_array(cls, cells: ArrayLike, like: "str | Path | Scenario" = "Manhattan32-CPP-v0", **changes: Any) -> "Scenario":
        """Return a scenario on a map of your own.

        Parameters
        ----------
        cells : array_like of str or int, shape (M, N), or M texts of N characters
            ``.`` free, ``L`` landing zone, ``N`` no-fly zone, ``#`` building, ``b`` low building, or the numbers 0 to 4 for
            them, in this order; both sides from 4 to 1,024.
        like : str, Path or Scenario
            The scenario from which everything else is taken: mission, budget, rewards, observation. Observation sizes that are
            too large for the map are reduced.
        **changes
            Fields of `Scenario` that differ, for example ``id="Harbour-CPP-v0"``, ``budget=(40, 90)``, ``uavs=(1, 3)``.

        Raises
        ------
        ScenarioError
            When the map or a field is not valid; the message names it.

        Examples
        --------
        >>> import uavbench
        >>> scenario = uavbench.Scenario.from_array(["LL...", ".....", "..##.", "....."], id="Tiny-CPP-v0", budget=(10, 20))
        >>> scenario.shape
        (4, 5)
        """
        origin = like if isinstance(like, Scenario) else load_scenario(like)
        try:
            rows = rows_of_array(cells)
        except ValueError as error:
            raise ScenarioError(f"from_array: map: {error}") from None
        largest = 2 * min(len(rows), len(rows[0]) if rows else 0) - 1
        sizes = {name: min(size, max(1, largest)) for name, size in origin.observation.model_dump().items()}
        own = {"id": "Custom-v0", "title": "", "map": "", "observation": sizes, "splits": Splits(), "path": Path()}
        own |= {"cities": None, "provenance": None}
        same = {name: getattr(origin, name) for name in cls.model_fields}
        try:
            return cls.model_validate({**same, **own, **changes, "rows": rows})
        except ValidationError as error:
            raise ScenarioError(f"from_array: {_first(error).replace('rows', 'map', 1)}") from None

    def with_uavs(self, number: SupportsIndex) -> "Scenario":
        """Return the same scenario with ``number`` UAVs in every episode: those that the episode draws first.

        Raises
        ------
        ValueError
            When the scenario is not for a team, or ``number`` is not from 1 to its largest number of UAVs.
        """
        if self.uavs is None:
            raise ValueError(f"num_uavs: {self.id} is for one UAV; the scenarios for teams have Team in their ids")
        uavs = as_integer(number) or 0
        if not 1 <= uavs <= self.max_uavs:
            raise ValueError(f"num_uavs: {number!r} is not an integer from 1 to {self.max_uavs}, the most of {self.id}")
        return self._changed(uavs=(uavs, uavs))

    def _changed(self, **changes: object) -> "Scenario":
        copy = self.model_copy(update=changes)
        vars(copy).pop("digest", None)  # the cached digest is that of the original
        return copy


def _check_sizes(observation: ObservationSizes, shape: tuple[int, int]) -> None:
    """Raise a ValueError if observation sizes exceed the centred map."""
    largest = 2 * min(shape) - 1
    for name, size in observation.model_dump().items():
        if size > largest:
            raise ValueError(f"observation.{name}: {size} exceeds {largest}, the shorter side of the centred map")


_TABLES = {"model_type", "model_attributes_type", "dict_type"}  # pydantic's types of errors for values that should be tables
_REASONS = {"extra_forbidden": "unknown key", "missing": "is missing", "tuple_type": "expected a pair [low, high]"}
_REASONS["too_short"] = "is empty"


def _first(error: ValidationError) -> str:
    """Return the first error as ``field: reason``, and how many more there are."""
    # Unknown keys first: a misspelt key also causes the error that a key is missing, which is less helpful.
    first = sorted(error.errors(), key=lambda each: each["type"] != "extra_forbidden")[0]
    place = ".".join(str(part) for part in first["loc"])
    reason = _REASONS.get(first["type"], first["msg"].removeprefix("Value error, "))
    if first["type"] in _TABLES:
        reason = f"{first['input']!r} is not a table: write [{place}], and its values below"
    elif first["type"] == "string_pattern_mismatch":
        reason = f"{first['input']!r} is not of the form expected" + (", as in MyCity-CPP-v0" if place == "id" else "")
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return (f"{place}: {reason}" if place else reason) + more


def _read_map(path: Path, scenario: Path, field: str = "map") -> tuple[str, ...]:
    """Read the rows of a map, which a field of the scenario names."""
    try:
        return read_map(path)
    except FileError as error:
        raise ScenarioError(f"{scenario}: {field}: {error}") from None
    except ValueError as error:
        raise ScenarioError(f"{path}: map: {error}") from None


def _read_city_maps(path: Path, cities: Any) -> None:
    """Read the maps that the table ``[cities]`` names, if it names any, into the table."""
    if not isinstance(cities, dict):
        return
    table = cast("dict[str, Any]", cities)
    if "maps" in table:
        raise ScenarioError(f"{path}: cities.maps: unknown key")
    try:
        files = MapFiles.model_validate(table.get("files")) if "files" in table else None
    except ValidationError as error:
        raise ScenarioError(f"{path}: cities.files.{_first(error)}") from None
    if files is not None:
        read = {
            split: [_read_map(path.parent / name, path, f"cities.files.{split}") for name in names] for split, names in files
        }
        table["maps"] = read


def _load(path: Path, run_code: bool = True) -> Scenario:
    """Load the TOML file ``path``, the map that it names, and the mission's Python file if it names one."""
    try:
        values = read_toml(path)
    except FileError as error:
        raise ScenarioError(str(error)) from None
    for name in ("rows", "path"):
        if name in values:
            raise ScenarioError(f"{path}: {name}: unknown key")
    _read_city_maps(path, values.get("cities"))
    if isinstance(values.get("map"), str):
        values["rows"] = _read_map(path.parent / values["map"], path)
    mission: Any = values.get("mission")
    if isinstance(mission, dict) and isinstance(mission.get("file"), str):  # pyright: ignore[reportUnknownMemberType]
        if not run_code:
            reason = "it is code, and runs only if you name the scenario yourself"
            raise ScenarioError(f"{path}: mission.file: {reason}: --scenario {path}")
        mission["file"] = path.parent / mission["file"]
    try:
        return Scenario(**values, path=path)
    except ValidationError as error:
        reason = _first(error).replace("cities.maps", "cities.files", 1)
        where = f"{path.parent / values['map']}" if reason.startswith("rows") else f"{path}"
        raise ScenarioError(f"{where}: {reason.replace('rows', 'map', 1) if where != str(path) else reason}") from None


def _absolute(path: Path) -> Path:
    """Return the absolute path of a scenario's file."""
    try:
        return path.expanduser().resolve()
    except (OSError, RuntimeError, ValueError) as error:  # a cycle of links, ~ with an unknown user, a NUL
        raise ScenarioError(f"{one_line(path)}: no file can have this name: {one_line(error)}") from None


def load_scenario(id_or_path: str | Path, run_code: bool = True) -> Scenario:
    """Load a shipped scenario by its id, or your own by the path of its TOML file.

    Parameters
    ----------
    id_or_path : str or Path
        ``"Manhattan32-CPP-v0"``, or a path that ends in ``.toml``.
    run_code : bool
        Whether a scenario may name a Python file that defines its mission; the file is then imported. Pass False if a
        stranger may have chosen the path.

    Raises
    ------
    ScenarioError
        When there is no such scenario, or it is not valid; the message names the file, the field and the reason.

    Examples
    --------
    >>> import uavbench
    >>> uavbench.load_scenario("Manhattan32-CPP-v0").budget
    (50, 150)
    """
    shipped = resources.scenario_paths()
    name = str(id_or_path).removeprefix("uavbench/")
    if name in shipped:
        path = shipped[name]
    elif str(id_or_path).endswith(".toml"):
        path = _absolute(Path(id_or_path))
    else:
        alike = {each.lower(): each for each in shipped}
        near = difflib.get_close_matches(name.lower(), alike, n=1, cutoff=0.4)
        hint = f"did you mean {alike[near[0]]}?" if near else f"known are {', '.join(shipped)};"
        raise ScenarioError(f"{id_or_path}: unknown scenario; {hint} your own is given by the path of its .toml file")
    scenario = _load(path, run_code)
    original = shipped.get(scenario.id, path)
    if original != path and _load(original).digest != scenario.digest:
        raise ScenarioError(f"{path}: id: {scenario.id} is a shipped scenario and means something else; choose another id")
    return scenario
