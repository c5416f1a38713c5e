"""``uavbench plot``, ``film``, ``play`` and ``report``: pictures of results, and episodes to play."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavbench.cli.shared import ResultFolder, ScenarioFile, fail, flown

if TYPE_CHECKING:
    from uavbench.evaluation.results import Result

_Episode = Annotated[int, typer.Option(min=0, help="The number of the episode.")]


def plot(
    folder: ResultFolder,
    episode: _Episode = 0,
    out: Annotated[
        Path | None, typer.Option(help="A .png, .svg or .pdf file; by default <scenario>-<agent>-<episode>.png.")
    ] = None,
    scenario: ScenarioFile = None,
) -> None:
    """Draw an episode of a result in the style of the paper's figure 2.

    The title says how much of the movement budget was used, and the CR.
    """
    from uavbench import UavbenchError
    from uavbench.pictures.plot import check_plot, save_plot
    from uavbench.pictures.watch import recorded_scenes

    try:
        result = flown(folder)
        path = out or Path(f"{result.summary['scenario']}-{result.summary['agent']}-{episode}.png")
        check_plot(path)
        save_plot(recorded_scenes(result, episode, scenario)[-1], path)
    except UavbenchError as error:
        raise fail(error) from None
    typer.echo(path)


def film(
    folder: ResultFolder,
    episode: _Episode = 0,
    out: Annotated[Path | None, typer.Option(help="An .mp4 or .gif file; by default <scenario>-<agent>-<episode>.mp4.")] = None,
    fps: Annotated[float, typer.Option(min=0.1, max=120, help="Steps shown per second.")] = 8.0,
    scenario: ScenarioFile = None,
) -> None:
    """Make a film of an episode of a result.

    MP4 needs the extra "film"; GIF does not.
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.cli.progress import working
    from uavbench.pictures.film import check_film, save_film
    from uavbench.pictures.watch import recorded_scenes

    try:
        result = flown(folder)
        path = out or Path(f"{result.summary['scenario']}-{result.summary['agent']}-{episode}.mp4")
        check_film(path, fps)
        scenes = recorded_scenes(result, episode, scenario)
        with working(Console(stderr=True), "filming", len(scenes)) as advance:
            save_film(scenes, path, fps, advance)
    except UavbenchError as error:
        raise fail(error) from None
    typer.echo(path)


def play(
    scenario: Annotated[str, typer.Argument(help="An id, or the path of a .toml file.")] = "Manhattan32-CPP-v0",
    episode: _Episode = 0,
    split: Annotated[str, typer.Option(help="train, validation or test.")] = "train",
) -> None:
    """Fly episodes yourself with the arrow keys, and see your score. Needs the extra "human".

    Space hovers, return lands, r restarts the episode, n takes the next one, q quits.
    """
    from uavbench import UavbenchError, load_scenario
    from uavbench.pictures.play import play as fly
    from uavbench.world.episode import check_number, check_split

    try:
        loaded = load_scenario(scenario)
        checked = check_split(split)
        check_number(loaded, checked, episode)
        fly(loaded, checked, episode, lambda record: typer.echo(_score(record.episode, record.landed, record.cr, record.cral)))
    except (UavbenchError, ValueError, ImportError) as error:
        raise fail(error) from None


def _score(episode: int, landed: bool, cr: float, cral: float) -> str:
    return f"episode {episode}: {'landed' if landed else 'crashed'}, CR {100 * cr:.1f} %, CRAL {100 * cral:.1f} %"


def report(
    folders: Annotated[
        list[Path] | None, typer.Argument(help="Folders that evaluate wrote on one scenario and split, or submissions.")
    ] = None,
    out: Annotated[Path, typer.Option(help="The folder to write.")] = Path("report"),
    group: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=RESULT,RESULT,…",
            help="One entry for a method trained with several seeds, a folder for each seed; repeatable.",
        ),
    ] = None,
    against: Annotated[
        str | None, typer.Option(help="The agent or group that the others are compared with; by default the first.")
    ] = None,
    scenario: ScenarioFile = None,
) -> None:
    """Write tables and figures that compare results.

    If results have different numbers of episodes, only the episodes that all of them have are compared.

    Writes the comparison as Markdown, LaTeX and CSV, and figures as PNG and PDF: CRAL and failures to land against the budget,
    CR against targets or devices, and performance profiles; with many cities also CRAL against properties of the cities.
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.cli.progress import working
    from uavbench.pictures.report import write_report

    try:
        groups = _groups(group or [])
        with working(Console(stderr=True), "writing") as advance:
            names = write_report([flown(folder) for folder in folders or []], out, advance, scenario, groups, against)
    except UavbenchError as error:
        raise fail(error) from None
    typer.echo(f"wrote {out}: {', '.join(names)}")


def _groups(given: list[str]) -> "dict[str, list[Result]]":
    """Return the results of each ``--group``, by the group's name.

    Raises
    ------
    ResultError
        When a group is not NAME=RESULT,RESULT,…, a name is given twice, or a result cannot be used.
    """
    from uavbench.evaluation.results import ResultError

    groups: dict[str, list[Result]] = {}
    for text in given:
        name, _, folders = text.partition("=")
        if not name.strip() or not name.isprintable() or not all(folders.split(",")):
            raise ResultError(f"--group {text!r}: write NAME=RESULT,RESULT,…, a folder for each seed")
        if name in groups:
            raise ResultError(f"--group {name}: given twice; choose another name")
        try:
            groups[name] = [flown(Path(folder)) for folder in folders.split(",")]
        except ResultError as error:
            raise ResultError(f"--group {name}: {error}") from None
    return groups
