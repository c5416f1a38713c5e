"""Writing the missions of a recorded flight, a file for each UAV."""

import math
from collections.abc import Callable
from pathlib import Path

from uavbench.errors import one_line
from uavbench.flight.geojson_file import geojson_text
from uavbench.flight.ground import Ground
from uavbench.flight.kml_file import kml_text
from uavbench.flight.mission import Mission, Settings
from uavbench.flight.plan_file import plan_text
from uavbench.flight.route import Flight, FlightError
from uavbench.flight.waypoints_file import waypoints_text
from uavbench.geodata.libraries import GeodataError
from uavbench.world.files import write_together

#: What writes a format, and the ending of its files.
FORMATS: dict[str, tuple[Callable[[Mission], str], str]] = {
    "plan": (plan_text, ".plan"),
    "waypoints": (waypoints_text, ".waypoints"),
    "geojson": (geojson_text, ".geojson"),
    "kml": (kml_text, ".kml"),
}
_LIMITS = {
    "speed": (0.1, 50.0, "m/s"),
    "altitude": (0.5, 1000.0, "m"),
    "altitude_step": (0.0, 100.0, "m"),
    "camera_distance": (0.1, 1000.0, "m"),
}


def write_missions(
    flight: Flight,
    format_: str,
    *,
    settings: Settings | None = None,
    origin: tuple[float, float] | None = None,
    out: Path | None = None,
    unsafe: bool = False,
) -> list[Path]:
    """Write the missions of a flight, all of them or none.

    Parameters
    ----------
    flight : Flight
    format_ : str
        One of `FORMATS`.
    settings : Settings, optional
    origin : (float, float), optional
        Latitude and longitude of the middle of the map; a scenario of a real place has its own.
    out : Path, optional
        The file, by default ``<scenario>-<agent>-<episode>`` with the format's ending. In a team, ``-uav1`` and so on is added
        to the name.
    unsafe : bool
        Whether to write a flight in which a UAV crashed, with a warning in the file.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    FlightError
        When the format is unknown, a setting is out of range, the flight crashed, the place on earth is unknown, or a library
        is missing.
    OSError
        When a file cannot be written.
    """
    if format_ not in FORMATS:
        raise FlightError(f"--format {one_line(format_)}: choose one of {', '.join(FORMATS)}")
    settings = settings or Settings()
    for name, (least, most, unit) in _LIMITS.items():
        value = getattr(settings, name)
        if value is not None and not (math.isfinite(value) and least <= value <= most):
            raise FlightError(f"--{name.replace('_', '-')} {value:g}: it must be from {least:g} to {most:g} {unit}")
    if not flight.landed and not unsafe:
        raise FlightError(
            f"episode {flight.episode}: a UAV did not land within its budget: fly another episode, or write it with --unsafe"
        )
    text, ending = FORMATS[format_]
    path = out or Path(f"{flight.scenario.id}-{flight.agent}-{flight.episode}{ending}")
    try:
        ground = Ground(flight.scenario, origin)
        missions = [Mission(flight, uav, ground, settings) for uav in range(len(flight.routes))]
        contents = {_named(path, uav, len(missions)): text(mission).encode() for uav, mission in enumerate(missions)}
    except GeodataError as error:
        raise FlightError(str(error)) from None
    write_together(contents)
    return list(contents)


def _named(path: Path, uav: int, uavs: int) -> Path:
    """Return the path of the file of a UAV."""
    return path if uavs == 1 else path.with_name(f"{path.stem}-uav{uav + 1}{path.suffix}")
