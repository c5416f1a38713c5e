"""Commands that fly episodes with agents, and that check and compare their results."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uavbench.cli.shared import (
    ClusterAddress,
    ClusterEngine,
    DecisionTimeout,
    ResultFolder,
    ScenarioFile,
    crew_of,
    fail,
    flown,
)

if TYPE_CHECKING:
    from rich.console import Console

    from uavbench.evaluation.results import Result
    from uavbench.world.scenario import Scenario


def evaluate(
    agent: Annotated[
        str,
        typer.Option(
            help="path.py, path.py:Class, package.module:Class, a .safetensors or .onnx file, or a built-in agent: "
            "belief_planner, boustrophedon, ddqn, greedy, imitation, orienteering, planner, ppo, quick_planner, "
            "random, tsp."
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
