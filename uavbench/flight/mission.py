"""A mission: what an autopilot is told to do, as commands of MAVLink (https://mavlink.io/en/messages/common.html)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavbench.flight.ground import Ground
from uavbench.flight.route import Flight, Route

#: Commands of MAVLink (MAV_CMD).
WAYPOINT, LOITER_TIME, LAND, TAKE_OFF, CHANGE_SPEED, TRIGGER_CAMERA = 16, 19, 21, 22, 178, 206
#: Frames of MAVLink (MAV_FRAME): a command without a place, and an altitude above the place of take-off.
NO_PLACE, ABOVE_HOME = 2, 3
_GROUND_SPEED, _SAME_THROTTLE = 1, -1


@dataclass(frozen=True)
class Settings:
    """How a mission is flown.

    Attributes
    ----------
    speed : float
        In m/s.
    altitude : float
        Above the place of take-off, in m.
    altitude_step : float
        How much higher each UAV of a team flies than the one before it, in m.
    camera_distance : float, optional
        In coverage, a picture is taken each time that so many metres have been flown; by default, a cell.
    """

    speed: float = 5.0
    altitude: float = 10.0
    altitude_step: float = 0.0
    camera_distance: float | None = None


@dataclass(frozen=True)
class Item:
    """A command of a mission.

    Attributes
    ----------
    command, frame : int
        Of MAVLink.
    params : (float, float, float, float)
    place : (float, float, float)
        Latitude, longitude and altitude; 0 where a command has no place.
    """

    command: int
    frame: int
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Mission:
    """What one UAV is told to do, and what the formats of missions need besides.

    Attributes
    ----------
    flight : Flight
    uav : int
        Its number in the team.
    ground : Ground
    settings : Settings
    """

    flight: Flight
    uav: int
    ground: Ground
    settings: Settings

    @property
    def route(self) -> Route:
        """The way of the UAV."""
        return self.flight.routes[self.uav]

    @property
    def altitude(self) -> float:
        """The UAV's altitude above the place of take-off, in m."""
        return self.settings.altitude + self.uav * self.settings.altitude_step

    @property
    def distance(self) -> float:
        """How far the UAV flies over ground, in m."""
        return self.route.moves * self.ground.cell

    @property
    def seconds(self) -> float:
        """How long that takes at the speed of the settings, waiting included, without take-off and landing."""
        return (self.route.moves + sum(stop.wait for stop in self.route.stops)) * self.ground.cell / self.settings.speed

    @property
    def title(self) -> str:
        """What is flown, in a line."""
        flight = self.flight
        uav = f", UAV {self.uav + 1} of {len(flight.routes)}" if len(flight.routes) > 1 else ""
        return f"{flight.scenario.id}, episode {flight.episode}, flown by {flight.agent}{uav}"

    @property
    def warning(self) -> str:
        """Why this should not be flown; empty if it may."""
        if self.flight.landed:
            return ""
        return "UNSAFE: in this episode a UAV did not land within its budget: it crashed where its route ends"

    def items(self) -> list[Item]:
        """Return the commands: take off, fly the route, land."""
        seconds = self.ground.cell / self.settings.speed  # of a step
        start, *others = self.route.stops
        items = [
            Item(TAKE_OFF, ABOVE_HOME, place=self._place(start.cell)),
            Item(CHANGE_SPEED, NO_PLACE, (_GROUND_SPEED, self.settings.speed, _SAME_THROTTLE, 0.0)),
        ]
        takes_pictures = hasattr(self.flight.scenario.mission, "camera_size")
        if takes_pictures:
            apart = self.settings.camera_distance or self.ground.cell
            items.append(Item(TRIGGER_CAMERA, NO_PLACE, (apart, 0.0, 1.0, 0.0)))
        for stop in (start, *others) if start.wait else others:
            hold = (stop.wait * seconds, 0.0, 0.0, 0.0)
            items.append(Item(LOITER_TIME if stop.wait else WAYPOINT, ABOVE_HOME, hold, self._place(stop.cell)))
        if takes_pictures:
            items.append(Item(TRIGGER_CAMERA, NO_PLACE))
        lat, lon, _ = self._place(self.route.stops[-1].cell)
        items.append(Item(LAND, ABOVE_HOME, place=(lat, lon, 0.0)))
        return items

    def home(self) -> tuple[float, float]:
        """Return latitude and longitude of the start."""
        return self.ground.degrees(*self.route.stops[0].cell)

    def _place(self, cell: tuple[int, int]) -> tuple[float, float, float]:
        lat, lon = self.ground.degrees(*cell)
        return lat, lon, self.altitude

    @property
    def marks(self) -> bool:
        """Whether targets are marks, such as devices, and not areas of cells."""
        return bool(self.flight.scenario.mission.words.mark)

    def done(self) -> NDArray[np.bool_]:
        """Return the cells whose targets the flight covers, or whose device it empties, shape (M, N)."""
        return (self.flight.target > 0) & (self.flight.left <= 0)

    def missed(self) -> NDArray[np.bool_]:
        """Return the cells whose targets the flight does not cover, or whose device keeps data, shape (M, N)."""
        return self.flight.left > 0
