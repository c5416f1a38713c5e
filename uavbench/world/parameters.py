"""The parameters of a scenario: rewards, observation sizes, and those of each mission.

This module does not import Numba: scenarios must be quick to read.
"""

import importlib
from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, field_validator

from uavbench.world.cells import CHARACTERS, FREE, NO_FLY

if TYPE_CHECKING:
    from uavbench.simulation.missions import Mission
    from uavbench.world.city_source import Cities
    from uavbench.world.scenario import Scenario


def _named(where: str) -> Any:
    """Return what ``"module:name"`` names. Parameters name the rules of a mission, because ``world`` may not import them."""
    module, _, name = where.partition(":")
    return getattr(importlib.import_module(module), name)


class Record(BaseModel):
    """A frozen record that refuses unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def ordered(bounds: tuple[float, float]) -> tuple[float, float]:
    """Refuse a range whose lower bound exceeds its upper bound."""
    if bounds[0] > bounds[1]:
        raise ValueError(f"the lower bound {bounds[0]} exceeds the upper bound {bounds[1]}: write [low, high]")
    return bounds


_MAX_SHAPES = 100
Count = Annotated[int, Field(ge=1, le=30_000, strict=True)]
_Devices = Annotated[int, Field(ge=1, le=100, strict=True)]
TeamSize = Annotated[int, Field(ge=1, le=16, strict=True)]
_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
_Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
_Fraction = Annotated[float, Field(ge=0, le=1, strict=True)]


class Rewards(Record):
    """The terms of the reward.

    Attributes
    ----------
    movement : float
        r_mov, for every action except a successful landing.
    safety : float
        r_sc, for every action with which the UAV stays in place without hovering or landing successfully.
    crash : float
        r_crash, when the budget is used up without a landing.
    collect : float
        r_c, per newly covered cell or per collected data unit.
    """

    movement: _Finite
    safety: _Finite
    crash: _Finite
    collect: _Finite


class ObservationSizes(Record):
    """The sizes of the global-local observation (paper eqs. 5 to 15): ``local_size`` l and ``global_scale`` g."""

    local_size: Annotated[int, Field(ge=0, strict=True)]
    global_scale: Annotated[int, Field(ge=1, strict=True)]

    @field_validator("local_size")
    @classmethod
    def _odd(cls, size: int) -> int:
        if size and size % 2 == 0:
            raise ValueError(f"{size} is even: the crop is centred on the UAV, so it must be odd (or 0 for none)")
        return size


class Words(NamedTuple):
    """The texts in the legends of a mission's pictures. An empty text leaves its entry out.

    Attributes
    ----------
    target, done : str
        For a cell of the target map that is not 0, and for one that was not 0 at the start and is 0 now.
    movement : str
        For an arrow.
    mark : str
        For a mark of `uavbench.simulation.missions.Mission.marks`. Pictures of a mission without marks colour the cells of
        the target map.
    shade : str
        For a cell that `uavbench.simulation.missions.Mission.shade` darkens.
    """

    target: str = "target"
    done: str = "target, done"
    movement: str = "movement"
    mark: str = ""
    shade: str = ""


Pooling = Literal["map", "counts", "spots"]


class MissionParameters(Record):
    """The parameters of a mission, and what can be told about it without compiling anything.

    A subclass adds its parameters and narrows ``kind`` to one ``Literal``.

    Attributes
    ----------
    kind : str
        The mission's name in scenario files.
    file : Path, optional
        The Python file that defines the mission; None for missions that come with the suite. A scenario's file names it
        relative to itself.
    sha256 : str, optional
        SHA-256 of that Python file with Unix line endings. It is part of the scenario's digest.
    words : Words
        What pictures say about the mission.
    counted : str
        What a report that counts the targets calls them; empty if it gives their share of all cells instead.
    pooling : {"map", "counts", "spots"}
        What the state keeps besides the target map, for faster observations: nothing; the numbers of targets in blocks of
        cells, if all targets are 1; or a list of the targets, if they are few. See `uavbench.simulation.pooling`.
    """

    kind: Any
    file: Path | None = None
    sha256: str | None = None
    words: ClassVar[Words] = Words()
    counted: ClassVar[str] = ""
    pooling: ClassVar[Pooling] = "map"

    @property
    def max_targets(self) -> int:
        """The largest number of cells of the target map that can differ from 0; used if ``pooling`` is ``"spots"``."""
        return 0

    @property
    @abstractmethod
    def largest_target(self) -> float:
        """The largest value of the target map."""

    @property
    def layers(self) -> dict[str, float]:
        """The names and largest values of the layers that the mission adds to the observation, besides the target map."""
        return {}

    @property
    @abstractmethod
    def exact(self) -> bool:
        """Whether transitions are the same to the last bit on every platform."""

    @property
    @abstractmethod
    def targets(self) -> str:
        """What the targets are, in a few words, for ``uavbench list``."""

    @abstractmethod
    def make(self, scenario: "Scenario", num_envs: int) -> "Mission":
        """Return the mission, with arrays for a batch of ``num_envs`` episodes."""

    def check_map(self, rows: tuple[str, ...]) -> None:
        """Raise a ValueError that names the wrong parameter if the parameters do not fit the map ``rows``."""

    def check_cities(self, cities: "Cities") -> None:  # noqa: ARG002  # other missions need it
        """Raise a ValueError if the mission cannot be flown in many cities, or its parameters do not fit each of them."""
        raise ValueError(f"mission.kind: {self.kind!r} is made for one map: name a map, and leave out the table [cities]")

    def viewer(self, shape: tuple[int, int]) -> dict[str, Any] | None:
        """Return what the leaderboard's page needs besides the parameters to fly the mission on a map of ``shape``."""

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Pickle a mission of a user's file as plain values: the process that reads them must import that file first."""
        if self.file is None:
            return super().__reduce_ex__(protocol)
        from uavbench.world.registry import read_mission

        return read_mission, (self.model_dump(),)


class Coverage(MissionParameters):
    """The parameters of coverage path planning (CPP).

    Attributes
    ----------
    camera_size : int
        Side of the square that the camera sees, in cells; odd, at most 7.
    shapes : (int, int)
        Smallest and largest number of random shapes that make up the targets; at most 100.
    target_fraction : (float, float)
        Smallest and largest fraction of all cells that the shapes cover before buildings are removed.
    """

    kind: Literal["coverage"]
    camera_size: Literal[1, 3, 5, 7]
    shapes: tuple[Count, Count]
    target_fraction: tuple[_Fraction, _Fraction]

    words: ClassVar[Words] = Words(target="target to cover", done="covered target")
    pooling: ClassVar[Pooling] = "counts"

    _ranges = field_validator("shapes", "target_fraction")(ordered)

    @field_validator("shapes")
    @classmethod
    def _few(cls, shapes: tuple[int, int]) -> tuple[int, int]:
        if shapes[1] > _MAX_SHAPES:
            raise ValueError(f"{shapes[1]} exceeds {_MAX_SHAPES}: each shape takes time to draw, in every episode")
        return shapes

    @property
    def largest_target(self) -> float:
        """The largest value of the target map."""
        return 1.0

    @property
    def exact(self) -> bool:
        """Whether transitions are the same to the last bit on every platform."""
        return True

    @property
    def targets(self) -> str:
        """What the targets are, in a few words."""
        return f"{self.target_fraction[0]:.0%}–{self.target_fraction[1]:.0%} of cells"

    def make(self, scenario: "Scenario", num_envs: int) -> "Mission":  # noqa: ARG002  # other missions need it
        """Return the mission, whose only array is the target map."""
        return _named("uavbench.simulation.missions.coverage:CoverageMission")(scenario, self)

    def check_cities(self, cities: "Cities") -> None:
        """Accept any cities: each has a cell that is not a building."""


class PathLoss(Record):
    """A pair of channel parameters: with line of sight (``los``) and without (``nlos``)."""

    los: _Positive
    nlos: _Positive


class FadingVariance(Record):
    """The variance of the shadow fading, in dB²: with line of sight (``los``) and without (``nlos``)."""

    los: Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
    nlos: Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]


class Harvesting(MissionParameters):
    """The parameters of data harvesting (DH); channel after Bayerlein et al., GLOBECOM 2020.

    Attributes
    ----------
    devices : (int, int)
        Smallest and largest number of devices.
    data : (float, float)
        Smallest and largest amount of data of a device at the start, in data units.
    communication_steps : int
        Communication steps per move.
    cell_size, altitude : float
        Side of a cell and flying altitude, in metres.
    edge_snr : float
        s, the cell-edge signal-to-noise ratio, in dB.
    path_loss_exponent : PathLoss
        α with and without line of sight.
    fading_variance : FadingVariance
        σ² with and without line of sight, in dB².
    """

    kind: Literal["harvesting"]
    devices: tuple[_Devices, _Devices]
    data: tuple[_Positive, _Positive]
    communication_steps: Annotated[int, Field(ge=1, le=100, strict=True)]
    cell_size: _Positive
    altitude: _Positive
    edge_snr: _Finite
    path_loss_exponent: PathLoss
    fading_variance: FadingVariance

    words: ClassVar[Words] = Words(
        target="",
        done="",
        movement="movement (served device)",
        mark="device, with the data left",
        shade="darker: in sight of fewer devices",
    )
    counted: ClassVar[str] = "devices"
    pooling: ClassVar[Pooling] = "spots"

    _ranges = field_validator("devices", "data")(ordered)

    @property
    def max_targets(self) -> int:
        """The largest number of cells of the target map that can differ from 0."""
        return self.devices[1]

    @property
    def largest_target(self) -> float:
        """The largest value of the target map."""
        return self.data[1]

    @property
    def exact(self) -> bool:
        """Whether transitions are the same to the last bit on every platform. No: logarithms differ in the last digits."""
        return False

    @property
    def targets(self) -> str:
        """What the targets are, in a few words."""
        return f"{self.devices[0]}–{self.devices[1]} devices"

    def make(self, scenario: "Scenario", num_envs: int) -> "Mission":
        """Return the mission, with the devices of ``num_envs`` episodes."""
        return _named("uavbench.simulation.missions.harvesting:HarvestingMission")(scenario, self, num_envs)

    def check_cities(self, cities: "Cities") -> None:
        """Raise a ValueError if a city may have fewer cells for devices than the largest number of devices."""
        if cities.least_places < self.devices[1]:
            raise ValueError(
                f"cities.places: up to {self.devices[1]} devices need as many cells outside buildings and landing zones, "
                f"and a city may have only {cities.least_places}"
            )

    def check_map(self, rows: tuple[str, ...]) -> None:
        """Raise a ValueError if the map has fewer cells for devices than the largest number of devices."""
        places = sum(row.count(CHARACTERS[FREE]) + row.count(CHARACTERS[NO_FLY]) for row in rows)
        if places < self.devices[1]:
            raise ValueError(
                f"mission.devices: up to {self.devices[1]} devices need as many cells outside buildings "
                f"and landing zones, and the map has {places}"
            )

    def viewer(self, shape: tuple[int, int]) -> dict[str, Any]:
        """Return the parameters of the channel on a map of ``shape``."""
        return _named("uavbench.simulation.missions.channel:channel_of")(self, shape)._asdict()
