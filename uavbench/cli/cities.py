"""``uavbench import``: a real city becomes a scenario."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from uavbench.cli.shared import command, fail, warn

if TYPE_CHECKING:
    from uavbench.geodata import ImportedCity


def import_city(
    source: Annotated[Path, typer.Argument(help="A file of OpenStreetMap, .osm or .osm.pbf, or a .geojson file.")],
    out: Annotated[Path, typer.Option(help="The .toml file to write; the map is written beside it, as .txt.")],
    cell: Annotated[float, typer.Option(help="Side of a cell in metres.")] = 10.0,
    altitude: Annotated[
        float, typer.Option(help="Flying altitude in metres: buildings that are not higher can be flown over.")
    ] = 25.0,
    shape: Annotated[str, typer.Option(metavar="ROWSxCOLUMNS", help="Size of the map in cells.")] = "50x50",
    centre: Annotated[
        str | None,
        typer.Option(metavar="LAT,LON", help="The map's centre in degrees; by default where buildings cover most ground."),
    ] = None,
    default_height: Annotated[
        float, typer.Option(help="Height in metres of buildings without height and levels in the file.")
    ] = 12.0,
    mission: Annotated[
        Literal["cpp", "dh"] | None,
        typer.Option(help="Coverage (cpp) or data harvesting (dh); by default the one that the id names, or else coverage."),
    ] = None,
    no_fly: Annotated[Path | None, typer.Option(help="A .geojson file, of which every polygon is a no-fly zone.")] = None,
    landing: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROW,COL,HEIGHT,WIDTH",
            help="A landing zone: first row and column, height and width, in cells; repeatable. By default two are chosen.",
        ),
    ] = None,
    scenario_id: Annotated[
        str | None, typer.Option("--id", help="The scenario's id; by default from --out: my_city.toml is MyCity-CPP-v0.")
    ] = None,
    licence: Annotated[
        str | None, typer.Option(help="The licence of the data; by default what the file states, or OpenStreetMap's.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that exist.")] = False,
) -> None:
    """Make a scenario from the buildings of a real place. Needs the extra "cities".

    A cell is a building if buildings cover at least half of it. Aerodromes and military areas become no-fly zones.
    """
    from uavbench import UavbenchError
    from uavbench.geodata import CityOptions, import_city

    rows, cols = _numbers("--shape", shape, "x", 2, "ROWSxCOLUMNS, as in 50x50")
    zones = [_numbers("--landing", zone, ",", 4, "ROW,COL,HEIGHT,WIDTH, as in 3,4,3,3") for zone in landing or ()]
    options = CityOptions(
        cell=cell,
        altitude=altitude,
        shape=(int(rows), int(cols)),
        centre=_centre(centre),
        default_height=default_height,
        mission=mission,
        no_fly=no_fly,
        landing=[(int(row), int(col), int(height), int(width)) for row, col, height, width in zones],
        scenario_id=scenario_id,
        licence=licence,
    )
    try:
        made = import_city(source, out, options, overwrite=force)
    except UavbenchError as error:
        raise fail(error) from None
    typer.echo(_summary(made, out))
    for line in made.warnings:
        warn(f"warning: {line}")


def _centre(text: str | None) -> tuple[float, float] | None:
    """Return the latitude and longitude in the value of ``--centre``."""
    if text is None:
        return None
    lat, lon = _numbers("--centre", text, ",", 2, "LAT,LON in degrees, as in 60.17,24.94", r"[-+−]?\d{1,3}(\.\d*)?")
    return lat, lon


def _numbers(option: str, text: str, mark: str, count: int, form: str, number: str = r"\d{1,9}") -> list[float]:
    """Return the numbers in the value of an option, which ``mark`` separates."""
    parts = [part.strip() for part in text.replace("×", "x").split(mark)]
    if len(parts) != count or not all(re.fullmatch(number, part, re.ASCII) for part in parts):
        raise fail(f"{option} {text}: write {form}")
    return [float(part.replace("−", "-")) for part in parts]


def _summary(made: "ImportedCity", out: Path) -> str:
    """Return what the command prints."""
    from uavbench.geodata.reasons import UNUSABLE, counted

    scenario, counts = made.scenario, made.buildings
    origin = scenario.provenance
    assert origin is not None
    (lat, lon), (rows, cols) = origin.centre, scenario.shape
    zones = [f"{height}×{width} cells from row {row}, column {col} on" for row, col, height, width in made.landing]
    lines = [
        f"{scenario.id}: {scenario.title}",
        f"map            {rows} rows × {cols} columns of cells of {origin.cell_size:g} m, "
        f"centred at latitude {lat:.5f} and longitude {lon:.5f}",
        f"buildings      {sum(counts.values()):,} of the {counted(made.in_file, ('building', 'buildings'))} in the file "
        "are on the map, at least in part",
        f"               the file gives the height of {counts.get('height', 0):,} of them, and the number of levels of "
        f"{counts.get('levels', 0):,}; {counts.get('default', 0):,} have the default height of {origin.default_height:g} m",
        f"               {counted(made.higher, ('building is', 'buildings are'))} higher than the flying altitude of "
        f"{origin.altitude:g} m and {'blocks' if made.higher == 1 else 'block'} flight",
        f"cells          {100 * made.share:.1f} % of the cells are buildings, and "
        f"{counted(made.no_fly, ('cell is', 'cells are'))} in no-fly zones",
        f"landing zones  {'; '.join(zones)}",
        f"licence        of the data: {origin.licence}",
    ]
    if made.closed:
        more = counted(made.closed, ("more cell is", "more cells are"))
        lines.insert(6, f"               {more} closed, because no UAV can get there")
    if made.skipped:
        lines.insert(5, f"               the file has {counted(made.skipped, UNUSABLE)}")
    follow = f"next:  {command('show', out)}\n       {command('evaluate', '--agent', 'greedy', '--scenario', out)}"
    return "\n".join([*lines, f"wrote {out} and its map {out.with_suffix('.txt').name}", follow])
