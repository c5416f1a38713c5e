"""The commands. No logic is in them: each loads, calls one function of the library, and prints."""

import io
import sys
from pathlib import Path
from typing import Annotated

import typer

from uavbench.cli import cities, evaluation, flight, leaderboard, learning, pictures
from uavbench.cli.shared import (
    ClusterAddress,
    ClusterEngine,
    Commands,
    DecisionTimeout,
    command,
    crew_of,
    fail,
    flown,
    number,
)
from uavbench.cli.speed import speed
from uavbench.evaluation.interrupt import terminating_interrupts

app = typer.Typer(
    cls=Commands,
    epilog="\b\nStart with:\n  uavbench new my_agent.py\n  uavbench evaluate --agent my_agent.py",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    """If ``--version`` is given, print the version and exit."""
    if wanted:
        from uavbench import __version__

        typer.echo(f"uavbench {__version__}")
        raise typer.Exit


@app.callback()
def main(
    context: typer.Context,
    _version_wanted: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Benchmark suite for UAV path planning: coverage (CPP) and data harvesting (DH) on grid cities."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without "×" shows "?" rather than a traceback
    context.with_resource(terminating_interrupts())


@app.command("list", epilog="\b\nExample:\n  uavbench list")
def list_scenarios() -> None:
    """List the scenarios."""
    from rich.console import Console

    from uavbench import list_scenarios, load_scenario
    from uavbench.cli.display import scenario_table

    Console().print(scenario_table(load_scenario(name) for name in list_scenarios()))


@app.command(
    epilog="\b\nExamples:\n  uavbench show Manhattan32-CPP-v0\n  uavbench show Cities32-CPP-v0 --city 7 --save city.png"
)
def show(
    scenario: Annotated[str, typer.Argument(help="An id, or the path of a .toml file.")],
    city: Annotated[int, typer.Option(min=0, help="Which city to show, if the scenario has many.")] = 0,
    split: Annotated[str, typer.Option(help="The split of the city: test, validation or train.")] = "test",
    save: Annotated[
        Path | None,
        typer.Option(help="Save the map as a PNG with one pixel for each cell, which a scenario may name as its map."),
    ] = None,
) -> None:
    """Show a scenario's parameters and map; if it has many cities, one of them."""
    from rich.console import Console

    from uavbench import UavbenchError, load_scenario
    from uavbench.cli.display import scenario_text
    from uavbench.world.shown_map import save_city_picture, shown_city

    try:
        found = load_scenario(scenario)
        shown = shown_city(found, split, city)
        if save is not None:
            save_city_picture(shown, save)
        Console(highlight=False, soft_wrap=True).print(scenario_text(found, shown, f"city {city} of the {split} split"))
    except (UavbenchError, ValueError) as error:
        raise fail(error) from None
    if save is not None:
        typer.echo(f"wrote {save}")


@app.command(epilog="\b\nExample:\n  uavbench new my_agent.py")
def new(path: Annotated[Path, typer.Argument(help="The file to write.")]) -> None:
    """Write a template of an agent to a file."""
    from uavbench import UavbenchError
    from uavbench.agents.agent import write_template

    try:
        write_template(path)
    except UavbenchError as error:
        raise fail(error) from None
    typer.echo(f"wrote {path}; next:  {command('check', path)}")


@app.command(epilog="\b\nExample:\n  uavbench check my_agent.py")
def check(
    agent: Annotated[str, typer.Argument(help="path.py, path.py:Class, or the name of a built-in agent.")],
    scenario: Annotated[
        list[str] | None, typer.Option(help="A scenario to fly instead of Block8-CPP-v0 and Block8-DH-v0; repeatable.")
    ] = None,
    decision_timeout: DecisionTimeout = 60.0,
) -> None:
    """Check that an agent keeps the contract.

    Flies validation episodes with it, and says in one line what is wrong.
    """
    from uavbench import UavbenchError
    from uavbench.agents.agent import find_agent
    from uavbench.evaluation.check import SCENARIOS, check_agent

    try:
        checked = check_agent(find_agent(agent), scenario or SCENARIOS, decision_timeout)
    except UavbenchError as error:
        raise fail(error, 1) from None
    scores = ", ".join(f"CRAL {100 * cral:.0f} % on {name}" for name, cral in checked.cral.items())
    typer.echo(f"{agent} keeps the contract: {checked.decisions_per_second:,.0f} decisions/s, {scores}")


app.command(
    epilog="\b\nExamples:\n  uavbench evaluate --agent my_agent.py\n"
    "  uavbench evaluate --agent greedy --scenario Urban50-DH-v0 --episodes 100 --workers 2\n"
    "  uavbench evaluate --agent my_agent.py --scenario all --resume\n"
    "  uavbench evaluate --agent my_agent.py --cluster dask --address tcp://head:8786"
)(evaluation.evaluate)
app.command(
    epilog="\b\nExample:\n  uavbench evaluate --agent greedy --shard 1/2\n  uavbench evaluate --agent greedy --shard 2/2\n"
    "  uavbench merge results/Manhattan32-CPP-v0/greedy.shard-*"
)(evaluation.merge)
app.command(epilog="\b\nExample:\n  uavbench replay results/Manhattan32-CPP-v0/my_agent")(evaluation.replay)
app.command(epilog="\b\nExample:\n  uavbench compare results/Manhattan32-CPP-v0/greedy results/Manhattan32-CPP-v0/random")(
    evaluation.compare
)


@app.command(
    epilog="\b\nExamples:\n  uavbench bound Manhattan32-CPP-v0 --episodes 10\n"
    "  uavbench bound Manhattan32-CPP-v0 --result results/Manhattan32-CPP-v0/my_agent --workers 2"
)
def bound(
    scenario: Annotated[str, typer.Argument(help="An id, or the path of a .toml file.")],
    episodes: Annotated[
        int | None, typer.Option(min=0, help="How many test episodes to bound, from 0 on; by default all.")
    ] = None,
    result: Annotated[
        list[Path] | None,
        typer.Option(
            help="A folder that evaluate wrote, or a submission: its scores are kept where they are best; repeatable."
        ),
    ] = None,
    seconds: Annotated[
        float, typer.Option(min=0.0, callback=number, help="Seconds of processor time that each bound may take.")
    ] = 20.0,
    workers: Annotated[int, typer.Option(min=1, help="The number of processes.")] = 1,
    out: Annotated[Path, typer.Option(help="The folder of the table, <scenario>.csv.")] = Path("reference"),
    cluster: ClusterEngine = None,
    address: ClusterAddress = None,
) -> None:
    """Compute upper bounds on test episodes, which no agent can exceed.

    Writes a table of upper bounds and best known scores, and prints their means. It continues the table in the --out folder or,
    if there is none, the scenario's own, and computes only bounds that are missing or may improve with more seconds.
    """
    from rich.console import Console

    from uavbench import UavbenchError, load_scenario
    from uavbench.bounds.run import run_bounds
    from uavbench.cli.display import reference_table
    from uavbench.cli.progress import episodes_progress

    console = Console()
    try:
        loaded, results = load_scenario(scenario), [flown(folder) for folder in result or ()]
        with episodes_progress(console, f"bounds of {loaded.id}", "upper bound") as progress:
            known = run_bounds(
                loaded,
                episodes,
                results,
                out,
                seconds=seconds,
                workers=crew_of(workers, cluster, address),
                on_start=progress.show,
                on_known=lambda known: progress.advance(known.upper_bound),
            )
        console.print(reference_table(loaded, known))
        console.print(str(out / f"{loaded.id}.csv"), highlight=False, markup=False, soft_wrap=True)
    except (UavbenchError, ImportError) as error:
        raise fail(error) from None


@app.command(epilog="\b\nExample:\n  uavbench freeze my_city.toml")
def freeze(
    scenario: Annotated[Path, typer.Argument(help="The path of a .toml file.")],
    replace: Annotated[
        bool,
        typer.Option("--replace", help="Draw frozen episodes again. Only for a scenario of which nobody has seen a result."),
    ] = False,
) -> None:
    """Write a scenario's validation and test episodes to files, so that they never change.

    Prints the lines that name these files, which you add to the scenario's file.
    """
    from uavbench import UavbenchError, load_scenario
    from uavbench.simulation.freeze import freeze as freeze_scenario

    try:
        loaded = load_scenario(scenario)
        lines = freeze_scenario(loaded, replace=replace)
    except UavbenchError as error:
        raise fail(error) from None
    typer.echo(
        f"# the files are written; put these lines at the end of {loaded.path}, instead of tables of the same names:\n{lines}"
    )


app.command(
    "import",
    epilog="\b\nExamples:\n  uavbench import buildings.osm.pbf --out my_city.toml\n"
    "  uavbench import buildings.geojson --cell 5 --altitude 15 --shape 64x64 --centre 60.17,24.94 --out my_city.toml",
)(cities.import_city)
app.command(
    epilog="\b\nExamples:\n  uavbench speed\n  uavbench speed --scenario Manhattan32-CPP-v0 --rounds 30 --json speed.json"
)(speed)
app.command(
    epilog="\b\nExamples:\n  uavbench train ddqn --scenario Manhattan32-CPP-v0\n"
    "  uavbench train ddqn --scenario Urban50-DH-v0 --config my_config.toml --seed 1 --resume\n"
    "  uavbench train ddqn --scenario Urban50-DH-v0 --config finish --from runs/Urban50-DH-v0/ddqn-fast-0.safetensors\n"
    "  uavbench evaluate --agent runs/Manhattan32-CPP-v0/ddqn-fast-0.safetensors"
)(learning.train)
app.command(
    epilog="\b\nExamples:\n  uavbench export ddqn model.onnx --scenario Manhattan32-CPP-v0\n"
    "  uavbench evaluate --agent model.onnx"
)(learning.export)
app.command(
    epilog="\b\nExample:\n  uavbench dataset Manhattan32-CPP-v0 --agent planner --episodes 200 --workers 2",
)(learning.dataset)
app.command(
    epilog="\b\nExample:\n  uavbench submit results/*/my_agent --name 'My agent' --authors 'A. Author' --authors 'B. Author'"
)(leaderboard.submit)
app.add_typer(leaderboard.app, name="leaderboard")
app.command(epilog="\b\nExample:\n  uavbench plot results/Manhattan32-CPP-v0/my_agent --episode 17 --out flight.pdf")(
    pictures.plot
)
app.command(epilog="\b\nExample:\n  uavbench film results/Manhattan32-CPP-v0/my_agent --episode 17 --out flight.gif")(
    pictures.film
)
app.command(
    epilog="\b\nExamples:\n  uavbench mission results/Helsinki50-CPP-v0/planner --episode 17 --speed 4 --altitude 25\n"
    "  uavbench mission results/Urban50-DH-v0/planner --origin 48.262,11.668 --format kml --out flight.kml"
)(flight.mission)
app.command(
    epilog="\b\nExamples:\n  uavbench fly results/Manhattan32-CPP-v0/planner --episode 17 --speed 5 --out flown.png\n"
    "  uavbench fly results/Helsinki50-DH-v0/greedy --speed 3 --wind 4 --film flown.mp4"
)(flight.fly)
app.command(
    epilog="\b\nExamples:\n  uavbench plan my_city.toml --targets field.geojson --budget 300 --picture flight.png\n"
    "  uavbench plan my_city-dh.toml --targets sensors.csv --start 60.1705,24.9415 --speed 4"
)(flight.plan)
app.command(epilog="\b\nExample:\n  uavbench play Block8-DH-v0")(pictures.play)
app.command(epilog="\b\nExample:\n  uavbench report results/Manhattan32-CPP-v0/* --out report")(pictures.report)
