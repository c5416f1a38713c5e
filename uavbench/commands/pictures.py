"""``uavbench plot``, ``film``, ``play`` and ``report``: results to look at."""

from pathlib import Path
from typing import Annotated

import typer

from uavbench.commands.shared import ResultFolder, fail

_Episode = Annotated[int, typer.Option(min=0, help="Which episode.")]


def plot(
    folder: ResultFolder,
    episode: _Episode = 0,
    out: Annotated[
        Path | None, typer.Option(help="A .png, .svg or .pdf file; by default FOLDER's name in this folder.")
    ] = None,
) -> None:
    """Draw a flight of a result, as the paper's figure 2 does.

    The title says how many movements of the budget were made, and the CR.
    """
    from uavbench import ScenarioError
    from uavbench.plot import save_plot
    from uavbench.results import ResultError, load_result
    from uavbench.watch import recorded_scenes

    try:
        result = load_result(folder)
        path = out or Path(f"{result.summary['scenario']}-{result.summary['agent']}-{episode}.png")
        save_plot(recorded_scenes(result, episode)[-1], path, result.scenario)
    except (ResultError, ScenarioError) as error:
        raise fail(error) from None
    typer.echo(path)


def film(
    folder: ResultFolder,
    episode: _Episode = 0,
    out: Annotated[Path | None, typer.Option(help="An .mp4 or .gif file; by default FOLDER's name in this folder.")] = None,
    fps: Annotated[float, typer.Option(min=0.1, max=120, help="Steps shown a second.")] = 8.0,
) -> None:
    """Make a film of a flight of a result. Needs the extra film."""
    from rich.console import Console

    from uavbench import ScenarioError
    from uavbench.display import working
    from uavbench.film import save_film
    from uavbench.results import ResultError, load_result
    from uavbench.watch import recorded_scenes

    try:
        result = load_result(folder)
        path = out or Path(f"{result.summary['scenario']}-{result.summary['agent']}-{episode}.mp4")
        scenes = recorded_scenes(result, episode)
        with working(Console(stderr=True), "drawing", len(scenes)) as advance:
            save_film(scenes, path, fps, advance)
    except (ResultError, ScenarioError) as error:
        raise fail(error) from None
    typer.echo(path)


def play(
    scenario: Annotated[str, typer.Argument(help="An id, or the path of a .toml file.")] = "Manhattan32-CPP-v0",
    episode: _Episode = 0,
    split: Annotated[str, typer.Option(help="train, validation or test.")] = "train",
) -> None:
    """Fly yourself, with the arrow keys, and be scored. Needs the extra human.

    Space hovers, return lands, r starts again, n takes the next episode, q ends.
    """
    from uavbench import ScenarioError, load_scenario
    from uavbench.episode import check_number, check_split
    from uavbench.play import play as fly

    try:
        loaded = load_scenario(scenario)
        checked = check_split(split)
        check_number(loaded, checked, episode)
        fly(loaded, checked, episode, lambda record: typer.echo(_score(record.episode, record.landed, record.cr, record.cral)))
    except (ScenarioError, ValueError, ImportError) as error:
        raise fail(error) from None


def _score(episode: int, landed: bool, cr: float, cral: float) -> str:
    return f"episode {episode}: {'landed' if landed else 'crashed'}, CR {100 * cr:.1f} %, CRAL {100 * cral:.1f} %"


def report(
    folders: Annotated[list[Path], typer.Argument(help="Folders that evaluate wrote, of the same episodes.")],
    out: Annotated[Path, typer.Option(help="The folder to write.")] = Path("report"),
) -> None:
    """Write tables and figures that compare results.

    The comparison as Markdown, LaTeX and CSV; CRAL and failures to land against the budget, CR against targets or devices, and
    performance profiles, as PNG and PDF.
    """
    from uavbench import ScenarioError
    from uavbench.report import write_report
    from uavbench.results import ResultError, load_result

    try:
        write_report([load_result(folder) for folder in folders], out, typer.echo)
    except (ResultError, ScenarioError) as error:
        raise fail(error) from None
