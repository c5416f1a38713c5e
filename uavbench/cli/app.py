"""The commands. No logic is in them: each loads, calls one function of the library, and prints."""

import io
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavbench.cli import cities, flight, leaderboard, learning, pictures
from uavbench.cli.shared import (
    ClusterAddress,
    ClusterEngine,
    Commands,
    DecisionTimeout,
    ResultFolder,
    ScenarioFile,
    command,
    crew_of,
    fail,
    flown,
    number,
)
from uavbench.cli.speed import speed
from uavbench.evaluation.interrupt import terminating_interrupts

if TYPE_CHECKING:
    from rich.console import Console

    from uavbench.evaluation.results import Result
    from uavbench.world.scenario import Scenario

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


@app.command(
    epilog="\b\nExamples:\n  uavbench evaluate --agent my_agent.py\n"
    "  uavbench evaluate --agent greedy --scenario Urban50-DH-v0 --episodes 100 --workers 2\n"
    "  uavbench evaluate --agent my_agent.py --scenario all --resume\n"
    "  uavbench evaluate --agent my_agent.py --cluster dask --address tcp://head:8786"
)
def evaluate(
    agent: Annotated[
        str,
        typer.Option(
            help="path.py, path.py:Class, package.module:Class, a .safetensors or .onnx file, or a built-in agent: "
            "belief_planner, boustrophedon, ddqn, greedy, imitation, orienteering, planner, ppo, random, tsp."
        ),
    ],
    scenario: Annotated[
        list[str] | None,
        typer.Option(
            help="An id, the path of a .toml file, or 'all'; repeatable. By default the scenario that the weights were trained "
            "on, or Manhattan32-CPP-v0 without weights."
        ),
    ] = None,
    weights: Annotated[Path | None, typer.Option(help="The weights for your own agent's file.")] = None,
    name: Annotated[str | None, typer.Option(help="The agent's name in the results; by default the file's name.")] = None,
    transfer: Annotated[
        bool, typer.Option("--transfer", help="Allow weights on another map than that of their training; the result says so.")
    ] = False,
    split: Annotated[str, typer.Option(help="test, validation or train.")] = "test",
    episodes: Annotated[
        int | None, typer.Option(min=1, help="How many episodes, from 0 on; by default all of the split, or 1000 of train.")
    ] = None,
    out: Annotated[Path, typer.Option(help="The folder of all results.")] = Path("results"),
    workers: Annotated[int, typer.Option(min=1, help="The number of processes.")] = 1,
    decision_timeout: DecisionTimeout = 60.0,
    resume: Annotated[bool, typer.Option("--resume", help="Continue an interrupted run; keep finished ones.")] = False,
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite",
            help="Replace a result or an interrupted run even if it is of another split, more episodes or another agent.",
        ),
    ] = False,
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="K/N", help="Fly only part K of N, for a batch system; uavbench merge makes a result of all parts."
        ),
    ] = None,
    cluster: ClusterEngine = None,
    address: ClusterAddress = None,
) -> None:
    """Score an agent on the episodes of a split.

    Prints Landed, CR and CRAL, each with its 95 % confidence interval, and the gaps to the upper bounds and to the best known
    scores if the scenario has them.
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.agents.agent import find_agent
    from uavbench.cli.progress import episodes_progress
    from uavbench.evaluation.evaluate import AgentDeclinedError, AgentError
    from uavbench.evaluation.run import jobs, run, run_shard
    from uavbench.evaluation.shards import read_shard

    console, start, status = Console(), Path.cwd(), 0
    try:
        source = replace(find_agent(agent, weights, name), transfer=transfer)
        planned = jobs(source, scenario, split, episodes, decision_timeout)
    except UavbenchError as error:
        raise fail(error) from None
    crew = crew_of(workers, cluster, address)
    out = start / out  # absolute, because an agent may change the current folder
    for job, count, optional in planned:
        try:
            with episodes_progress(console, f"{job.source.name} on {job.scenario.id}", "CRAL") as progress:
                how: Any = {"workers": crew, "resume": resume, "overwrite": overwrite, "on_record": progress.note}
                if shard is not None:
                    part = read_shard(shard, count)
                    folder = run_shard(job, part, out, on_start=lambda part=part: progress.show(len(part.numbers)), **how)
                    typer.echo(f"{len(part.numbers)} episodes; {_seen_from(start, folder)}")
                    continue
                result = run(job, count, out, on_start=lambda count=count: progress.show(count), **how)
            _print_result(console, result, job.scenario, start)
        except AgentDeclinedError as error:
            if optional:
                typer.echo(f"{job.scenario.id}: left out: {error.reason}", err=True)
            else:
                status = fail(error, 1).exit_code
        except UavbenchError as error:  # the other scenarios are still flown
            status = fail(error, 1 if isinstance(error, AgentError) or len(planned) > 1 else 2).exit_code
    if status:
        raise typer.Exit(status)


def _print_result(console: "Console", result: "Result", scenario: "Scenario", start: Path) -> None:
    """Print a result's table, its gaps to what is known, and where it is, as seen from the folder ``start``."""
    from uavbench.cli.display import gaps_text, result_table
    from uavbench.evaluation.reference import gaps

    console.print(result_table(result))
    known = gaps(result, scenario)
    if known:
        console.print(gaps_text(known), highlight=False)
    folder = _seen_from(start, result.folder)
    line = f"{result.summary['decisions_per_second']:,.0f} decisions/s, {result.summary['wall_time']:.1f} s; {folder}"
    console.print(line, highlight=False, markup=False, soft_wrap=True)


def _seen_from(start: Path, folder: Path) -> Path:
    """Return a folder as seen from the folder ``start``, if it is inside."""
    return folder.relative_to(start) if folder.is_relative_to(start) else folder


@app.command(
    epilog="\b\nExample:\n  uavbench evaluate --agent greedy --shard 1/2\n  uavbench evaluate --agent greedy --shard 2/2\n"
    "  uavbench merge results/Manhattan32-CPP-v0/greedy.shard-*"
)
def merge(
    folders: Annotated[list[Path], typer.Argument(help="The folders that evaluate --shard wrote, all of one evaluation.")],
    out: Annotated[Path, typer.Option(help="The folder of all results.")] = Path("results"),
    scenario: ScenarioFile = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a result that is there, even if it is of another evaluation.")
    ] = False,
) -> None:
    """Make a result of all shards of an evaluation.

    Every episode is flown again from its actions. Missing shards, shards that are given twice, and shards of different
    evaluations are refused.
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.cli.progress import working
    from uavbench.evaluation.shards import merge as merge_shards

    try:
        with working(Console(stderr=True), "checking", len(folders)) as advance:
            result = merge_shards(folders, out, scenario=scenario, overwrite=overwrite, on_shard=advance)
        _print_result(Console(), result, result.scenario, Path.cwd())
    except UavbenchError as error:
        raise fail(error) from None


@app.command(epilog="\b\nExample:\n  uavbench replay results/Manhattan32-CPP-v0/my_agent")
def replay(
    folder: ResultFolder,
    scenario: ScenarioFile = None,
) -> None:
    """Simulate a result again from its actions.

    Every number must be reproduced.
    """
    from uavbench import UavbenchError
    from uavbench.evaluation.replay import replay as replay_result

    try:
        result = flown(folder)
        wrong = replay_result(result, scenario)
    except UavbenchError as error:
        raise fail(error) from None
    if wrong:
        more = f"\n… and {len(wrong) - 10} more" if len(wrong) > 10 else ""
        raise fail(f"{folder} is not reproduced:\n" + "\n".join(wrong[:10]) + more, 1)
    typer.echo(f"{folder}: all {result.summary['episodes']} episodes reproduced, every number")


@app.command(epilog="\b\nExample:\n  uavbench compare results/Manhattan32-CPP-v0/greedy results/Manhattan32-CPP-v0/random")
def compare(first: ResultFolder, second: ResultFolder) -> None:
    """Compare two agents on the same episodes.

    Prints paired differences and the probability that the first agent is better, with their confidence intervals.
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.cli.display import comparison_table
    from uavbench.evaluation.replay import compare_results

    try:
        a, b = flown(first), flown(second)
        found, episodes = compare_results(a, b)
        Console().print(comparison_table(a, b, found, episodes))
    except UavbenchError as error:
        raise fail(error) from None


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
