"""``uavbench submit`` and ``uavbench leaderboard``."""

from pathlib import Path
from typing import Annotated

import typer

from uavbench.cli.shared import ClusterAddress, ClusterEngine, DecisionTimeout, crew_of, fail

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Check submissions, and build the leaderboard from them.",
    epilog="\b\nExamples:\n  uavbench leaderboard verify leaderboard/submissions/my-agent\n"
    "  uavbench leaderboard build leaderboard/submissions",
)

_Submissions = Annotated[Path, typer.Argument(help="A folder of submissions, or a single submission.")]
_Workers = Annotated[int, typer.Option(min=1, help="The number of processes.")]


def submit(
    results: Annotated[list[Path], typer.Argument(help="Folders that evaluate wrote, one for each scenario.")],
    name: Annotated[str, typer.Option(help="The agent's name on the leaderboard.")],
    authors: Annotated[list[str], typer.Option(help="An author of the agent; repeatable.")],
    link: Annotated[str, typer.Option(help="The web address of a description.")] = "",
    method: Annotated[
        str,
        typer.Option(
            help='How it decides: "policy" (one pass of a network), "policy + mask" (of safe actions), "rules", '
            '"search on a belief" or "search on the state".'
        ),
    ] = "",
    training: Annotated[str, typer.Option(help="What it was trained on, with which seeds.")] = "",
    hardware: Annotated[str, typer.Option(help="The machine it was flown on; by default this one.")] = "",
    out: Annotated[Path, typer.Option(help="The folder of submissions.")] = Path("leaderboard/submissions"),
) -> None:
    """Make a submission to the leaderboard.

    Each result must be of all test episodes of one scenario. Every action is replayed first. Then a manifest, the actions and
    the episodes are written to OUT/<name>/<scenario>. Flights that are better than all before are kept in best_known/ beside
    OUT.
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.cli.progress import working
    from uavbench.evaluation.results import load_result
    from uavbench.leaderboard.submit import submit as make_submission

    try:
        loaded = [load_result(folder) for folder in results]
        best: list[tuple[str, int]] = []
        with working(Console(stderr=True), "replaying", len(loaded)) as advance:
            told = {"name": name, "link": link, "method": method, "training": training, "hardware": hardware}
            folders = make_submission(
                loaded,
                out,
                authors=authors,
                on_checked=advance,
                on_best=lambda scenario, count: best.append((scenario, count)),
                **told,
            )
    except UavbenchError as error:
        raise fail(error) from None
    for folder in folders:
        typer.echo(folder)
    for scenario, count in best:
        if count:
            typer.echo(f"{scenario}: {count:,} flights are now the best known ones")


@app.command(epilog="\b\nExample:\n  uavbench leaderboard verify leaderboard/submissions/my-agent")
def verify(folder: _Submissions, workers: _Workers = 1) -> None:
    """Replay every action of submissions and compare every number.

    If submissions are refused, names each with the reason, and the exit status is 1.
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.cli.progress import working
    from uavbench.leaderboard.board import submission_folders
    from uavbench.leaderboard.board import verify as check

    try:
        folders = submission_folders(folder)
        with working(Console(stderr=True), "replaying", len(folders)) as advance:
            held, refused = check(folders, workers, advance)
    except UavbenchError as error:
        raise fail(error) from None
    for submission, flown in held:
        typer.echo(f"{submission.label}: all {len(flown)} episodes reproduced, every number")
    for line in refused:
        fail(f"refused: {line}")
    if refused:
        raise typer.Exit(1)


@app.command(epilog="\b\nExample:\n  uavbench leaderboard build leaderboard/submissions --workers 2")
def build(
    submissions: Annotated[Path, typer.Argument(help="The folder of all submissions: <name>/<scenario>.")],
    workers: _Workers = 1,
) -> None:
    """Replay all submissions, and write the table and the page.

    The table is leaderboard.csv and the page is index.html, beside the submissions' folder. owners.toml there records who owns
    each name.

    If submissions are refused, names each with the reason and builds the leaderboard from the others; the exit status is 1.
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.cli.display import leaderboard_tables
    from uavbench.cli.progress import working
    from uavbench.leaderboard.board import build as build_board
    from uavbench.leaderboard.board import submission_folders

    console = Console()
    try:
        with working(Console(stderr=True), "replaying", len(submission_folders(submissions))) as advance:
            board = build_board(submissions, workers, advance)
    except UavbenchError as error:
        raise fail(error) from None
    console.print(leaderboard_tables(board.rows))
    for line in board.alike:
        typer.echo(f"note: {line}")
    for line in board.refused:
        fail(f"refused: {line}")
    if not board.rows:
        fail("no valid submission: nothing was written")
    if board.refused:
        raise typer.Exit(1)


@app.command(
    epilog="\b\nExamples:\n  uavbench leaderboard rerun leaderboard/submissions/greedy --agent greedy\n"
    "  uavbench leaderboard rerun leaderboard/submissions/planner --agent planner --episodes 100 --workers 2\n"
    "  uavbench leaderboard rerun leaderboard/submissions/my-agent --agent my_agent.py --weights my_weights.pt\n"
    "  uavbench leaderboard rerun leaderboard/submissions/my-agent --agent my_agent.py --fresh 500"
)
def rerun(
    folder: _Submissions,
    agent: Annotated[
        str,
        typer.Option(help="The submitted agent: path.py, path.py:Class, a .safetensors or .onnx file, or a built-in agent."),
    ],
    weights: Annotated[Path | None, typer.Option(help="The weights that the agent's file flew with.")] = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="How many submitted episodes, from 0 on; by default all.")] = None,
    fresh: Annotated[int, typer.Option(min=0, help="How many fresh episodes, which nobody has published.")] = 200,
    key: Annotated[
        int | None, typer.Option(min=0, help="The key of the fresh episodes: a long number, used once; by default random.")
    ] = None,
    workers: _Workers = 1,
    decision_timeout: DecisionTimeout = 60.0,
    cluster: ClusterEngine = None,
    address: ClusterAddress = None,
) -> None:
    """Run a submission's agent again, compare every action, and let it fly fresh episodes, which nobody has published.

    If it takes the same actions, reruns.csv beside the folder of all submissions records that. After a rerun of all episodes,
    the next build shows the tier "rerun", unless the score on fresh episodes does not agree with the submitted one. An agent on
    the observation track runs in a process of its own, which holds no simulator.

    This runs a stranger's code: do it in a container without a network (docs/leaderboard.md).
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.agents.agent import find_agent
    from uavbench.cli.progress import episodes_progress
    from uavbench.leaderboard.board import submission_folders
    from uavbench.leaderboard.reruns import RerunInterrupted, check_reruns, fly_again, fresh_text, save_rerun
    from uavbench.leaderboard.submission import load_submission

    try:
        source = find_agent(agent, weights)
        for each in submission_folders(folder):
            submission = load_submission(each)
            kept = each.parent.parent.parent / "reruns.csv"
            check_reruns(kept)
            count = min(episodes or submission.manifest.result.episodes, submission.manifest.result.episodes)
            with episodes_progress(Console(stderr=True), submission.label, "CRAL") as progress:
                progress.show(count + fresh)
                told = submission, source, count, crew_of(workers, cluster, address), decision_timeout
                try:
                    found = fly_again(*told, progress.note, fresh, key)
                except RerunInterrupted as interrupted:
                    if interrupted.rerun.episodes:
                        save_rerun(kept, interrupted.rerun)
                        done = f"the actions of {interrupted.rerun.episodes} episodes are the same, recorded in {kept}"
                        raise KeyboardInterrupt(f"interrupted; {done}") from None
                    raise
            save_rerun(kept, found)
            typer.echo(f"{submission.label}: {agent} took the same actions on {count} episodes, recorded in {kept}")
            if fresh:
                typer.echo(f"{submission.label}: {fresh_text(found)}")
    except UavbenchError as error:
        raise fail(error, 1) from None


@app.command(
    epilog="\b\nExamples:\n  uavbench leaderboard fly leaderboard/submissions/greedy/Manhattan32-CPP-v0\n"
    "  uavbench leaderboard fly leaderboard/submissions/{planner,greedy}/Urban50-* --episodes 5 --speed 3 --workers 2"
)
def fly(
    folders: Annotated[list[Path], typer.Argument(help="Submissions of one board, or folders of submissions.")],
    episodes: Annotated[int, typer.Option(min=1, help="How many episodes, from 0 on.")] = 20,
    speed: Annotated[list[float] | None, typer.Option(help="m/s; repeatable; by default 2, 5 and 8.")] = None,
    workers: _Workers = 1,
) -> None:
    """Fly recorded episodes of submissions with physics, as uavbench fly does, without wind.

    What was flown is recorded in flown.csv beside the folder of all submissions, and is not flown again. The next build shows
    how many flights were safe; this is not part of the rank. Needs the extra flight: pip install 'uavbench[flight]'.
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.cli.progress import working
    from uavbench.leaderboard.board import submission_folders
    from uavbench.leaderboard.flown import SPEEDS, file_beside, fly_missing, load_flown, missing_flights, safety
    from uavbench.leaderboard.submission import load_submission

    try:
        submissions = [load_submission(each) for folder in folders for each in submission_folders(folder)]
        kept = file_beside(submissions)
        missing = missing_flights(submissions, episodes, speed or SPEEDS, load_flown(kept))
        with working(Console(stderr=True), "flying", len(missing)) as advance:
            fly_missing(missing, kept, workers, advance)
        known = load_flown(kept)
    except UavbenchError as error:
        raise fail(error) from None
    for submission in submissions:
        for each in safety(known, submission):
            typer.echo(f"{submission.label}: {each.safe} of {each.flown} flights at {each.speed:g} m/s were safe")
