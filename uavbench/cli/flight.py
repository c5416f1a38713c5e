"""``uavbench mission``, ``fly`` and ``plan``: flights for autopilots, with physics, and of a person's own."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from uavbench.cli.shared import ResultFolder, ScenarioFile, fail, flown


def mission(
    folder: ResultFolder,
    episode: Annotated[int, typer.Option(min=0, help="The number of the episode.")] = 0,
    format_: Annotated[
        Literal["plan", "waypoints", "geojson", "kml"],
        typer.Option("--format", help="plan: QGroundControl. waypoints: Mission Planner and MAVProxy. geojson, kml: maps."),
    ] = "plan",
    out: Annotated[
        Path | None, typer.Option(help="The file; by default <scenario>-<agent>-<episode>. A team has a file for each UAV.")
    ] = None,
    origin: Annotated[
        str | None, typer.Option(metavar="LAT,LON", help="Where the middle of the map is, for a map that is no real place.")
    ] = None,
    speed: Annotated[float, typer.Option(help="m/s.")] = 5.0,
    altitude: Annotated[
        float | None, typer.Option(help="m above the place of take-off; by default what the scenario says, or 10.")
    ] = None,
    altitude_step: Annotated[float, typer.Option(help="How much higher each further UAV of a team flies, m.")] = 0.0,
    camera_distance: Annotated[
        float | None, typer.Option(help="In coverage: metres between two pictures; by default the side of a cell.")
    ] = None,
    unsafe: Annotated[
        bool, typer.Option("--unsafe", help="Write a flight that crashed, too, with a warning in the file.")
    ] = False,
    scenario: ScenarioFile = None,
) -> None:
    """Write an episode of a result as a mission, which ground stations load and autopilots fly.

    Needs the extra cities: pip install 'uavbench[cities]'.
    """
    from uavbench import UavbenchError
    from uavbench.flight.ground import altitude_of, read_origin
    from uavbench.flight.mission import Settings
    from uavbench.flight.mission_files import write_missions
    from uavbench.flight.route import recorded_flight

    try:
        place = None if origin is None else read_origin(origin)
        flight = recorded_flight(flown(folder), episode, scenario)
        height = altitude_of(flight.scenario) if altitude is None else altitude
        settings = Settings(speed, height, altitude_step, camera_distance)
        paths = write_missions(flight, format_, settings=settings, origin=place, out=out, unsafe=unsafe)
    except UavbenchError as error:
        raise fail(error) from None
    except OSError as error:
        raise fail(f"--out: cannot write {error.filename or out}: {error.strerror}") from None
    for path in paths:
        typer.echo(path)


def fly(
    folder: ResultFolder,
    episode: Annotated[int, typer.Option(min=0, help="The number of the episode.")] = 0,
    speed: Annotated[float, typer.Option(help="m/s.")] = 3.0,
    wind: Annotated[float, typer.Option(help="The mean wind in m/s; with wind there are gusts.")] = 0.0,
    acceleration: Annotated[float, typer.Option(help="The largest acceleration that is asked for, m/s².")] = 2.0,
    tolerance: Annotated[float, typer.Option(help="How far from a corner the quadrotor may pass, m.")] = 1.0,
    out: Annotated[Path | None, typer.Option(help="A figure from above: a .png, .svg or .pdf file.")] = None,
    film: Annotated[Path | None, typer.Option(help="A film from above: an .mp4 or .gif file.")] = None,
    scenario: ScenarioFile = None,
) -> None:
    """Fly an episode of a result with a simulated quadrotor, and tell whether it survives.

    The exit status is 1 if it hits something or enters a no-fly zone. Needs the extra flight: pip install 'uavbench[flight]'.
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.cli.display import flown_table
    from uavbench.cli.progress import working
    from uavbench.flight.flown import Conditions
    from uavbench.flight.flown import fly as fly_flight
    from uavbench.flight.route import recorded_flight
    from uavbench.pictures.film import check_film, save_film
    from uavbench.pictures.flown import flown_scenes, save_flown
    from uavbench.pictures.plot import check_plot

    console = Console(stderr=True)
    try:
        if out is not None:
            check_plot(out)
        if film is not None:
            check_film(film, 16.0)
        result = flown(folder)
        flight = recorded_flight(result, episode, scenario)
        with working(console, "flying", len(flight.routes)) as advance:
            found = fly_flight(flight, Conditions(speed, wind, acceleration, tolerance), advance)
        Console().print(flown_table(found))
        if out is not None:
            save_flown(result, found, out, scenario)
            typer.echo(out)
        if film is not None:
            scenes = flown_scenes(result, found, scenario)
            with working(console, "filming", len(scenes)) as advance:
                save_film(scenes, film, 16.0, advance)
            typer.echo(film)
    except UavbenchError as error:
        raise fail(error) from None
    if not found.safe:
        raise typer.Exit(1)


def plan(
    scenario: Annotated[str, typer.Argument(help="The .toml file of your city, as import writes it, or an id.")],
    targets: Annotated[
        Path,
        typer.Option(help="What to cover: areas in a .geojson file. What to collect: devices in a .csv file, lat,lon,data."),
    ],
    start: Annotated[
        str | None, typer.Option(metavar="LAT,LON", help="Where to start; by default the nearest landing zone.")
    ] = None,
    budget: Annotated[
        int | None, typer.Option(help="How many moves the UAV may take; by default as many as in the scenario.")
    ] = None,
    format_: Annotated[
        Literal["plan", "waypoints", "geojson", "kml"], typer.Option("--format", help="The format of the mission.")
    ] = "plan",
    out: Annotated[Path | None, typer.Option(help="The mission's file; by default named after the targets.")] = None,
    picture: Annotated[Path | None, typer.Option(help="A picture of the flight: a .png, .svg or .pdf file.")] = None,
    origin: Annotated[
        str | None, typer.Option(metavar="LAT,LON", help="Where the middle of the map is, for a map that is no real place.")
    ] = None,
    speed: Annotated[float, typer.Option(help="m/s.")] = 5.0,
    altitude: Annotated[float | None, typer.Option(help="m above the place of take-off.")] = None,
    agent: Annotated[str, typer.Option(help="Who plans: a built-in agent, or a file as for evaluate.")] = "planner",
    turn_cost: Annotated[
        float | None, typer.Option(help="How many moves a turn by 90° counts as; by default turns are free.")
    ] = None,
) -> None:
    """Plan one real flight over targets of your own, and write its mission.

    Needs the extra cities: pip install 'uavbench[cities]'.
    """
    from rich.console import Console

    from uavbench import UavbenchError, load_scenario
    from uavbench.cli.display import own_lines
    from uavbench.cli.progress import working
    from uavbench.flight.ground import Ground, altitude_of, read_origin
    from uavbench.flight.mission import Settings
    from uavbench.flight.mission_files import FORMATS, write_missions
    from uavbench.flight.own import plan_own
    from uavbench.pictures.plot import check_plot, save_plot
    from uavbench.pictures.watch import own_scene

    try:
        if picture is not None:
            check_plot(picture)
        loaded = load_scenario(scenario)
        place = None if origin is None else read_origin(origin)
        ground = Ground(loaded, place)
        begins = None if start is None else read_origin(start, "--start")
        with working(Console(stderr=True), "planning", 1) as advance:
            own = plan_own(loaded, targets, ground, agent=agent, start=begins, budget=budget, turn_cost=turn_cost)
            advance(own)
        settings = Settings(speed, altitude_of(loaded) if altitude is None else altitude)
        path = out or Path(f"{targets.stem}{FORMATS[format_][1]}")
        write_missions(own.flight, format_, settings=settings, origin=place, out=path)
        if picture is not None:
            save_plot(own_scene(own), picture)
    except UavbenchError as error:
        raise fail(error) from None
    except OSError as error:
        raise fail(f"--out: cannot write {error.filename or out}: {error.strerror}") from None
    for line in own_lines(own.flight, ground.cell, speed):
        typer.echo(line)
    for written in (path, picture):
        if written is not None:
            typer.echo(written)
