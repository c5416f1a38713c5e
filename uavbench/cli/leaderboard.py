"""``uavbench submit`` and ``uavbench leaderboard``."""

from pathlib import Path
from typing import Annotated

import typer

from uavbench.cli.shared import DecisionTimeout, fail

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Check submissions, and make the leaderboard of them.",
    epilog="\b\nExamples:\n  uavbench leaderboard verify leaderboard/submissions/my-agent\n"
    "  uavbench leaderboard build leaderboard/submissions",
)

_Submissions = Annotated[Path, typer.Argument(help="A folder of submissions, or one of them.")]
_Workers = Annotated[int, typer.Option(min=1, help="Processes.")]


def submit(
    results: Annotated[list[Path], typer.Argument(help="Folders that evaluate wrote, all of one agent.")],
    name: Annotated[str, typer.Option(help="What the leaderboard calls the agent.")],
    authors: Annotated[list[str], typer.Option(help="Who made it; repeatable.")],
    link: Annotated[str, typer.Option(help="Where it is described.")] = "",
    training: Annotated[str, typer.Option(help="On what it was trained, with which seeds.")] = "",
    hardware: Annotated[str, typer.Option(help="On what it was flown; by default this machine.")] = "",
    out: Annotated[Path, typer.Option(help="The folder of submissions.")] = Path("leaderboard/submissions"),
) -> None:
    """Make a submission to the leaderboard.

    The results are of all test episodes, a scenario each. Every action is replayed first. What is written is
    OUT/<name>/<scenario>: a manifest, the actions and the episodes.
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.cli.progress import working
    from uavbench.evaluation.results import load_result
    from uavbench.leaderboard.submit import submit as make_submission

    try:
        loaded = [load_result(folder) for folder in results]
        with working(Console(stderr=True), "replaying", len(loaded)) as advance:
            told = {"name": name, "link": link, "training": training, "hardware": hardware}
            folders = make_submission(loaded, out, authors=authors, on_checked=advance, **told)
    except UavbenchError as error:
        raise fail(error) from None
    for folder in folders:
        typer.echo(folder)


@app.command(epilog="\b\nExample:\n  uavbench leaderboard verify leaderboard/submissions/my-agent")
def verify(folder: _Submissions, workers: _Workers = 1) -> None:
    """Replay every action of submissions and compare every number.

    What is refused is named, with the reason, and the exit status is 1 then.
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

    They are leaderboard.csv and index.html beside the submissions' folder.

    What is refused is named, with the reason, and the rest is built; the exit status is 1 then.
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
        fail("none holds: nothing was written")
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
        typer.Option(help="What was submitted: path.py, path.py:Class, a .safetensors or .onnx file, or a built-in."),
    ],
    weights: Annotated[Path | None, typer.Option(help="What the agent's own file flew with.")] = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="How many, from 0 on; by default all.")] = None,
    fresh: Annotated[int, typer.Option(min=0, help="How many episodes that nobody has published.")] = 200,
    key: Annotated[
        int | None, typer.Option(min=0, help="What they are drawn from: use a long number, once; by default a random one.")
    ] = None,
    workers: _Workers = 1,
    decision_timeout: DecisionTimeout = 60.0,
) -> None:
    """Execute a submission's agent again, compare every action, and let it fly episodes that nobody has published.

    Where it takes the same actions, that is written down in reruns.csv beside the folder of all submissions, and the next build
    shows the tier "rerun", unless the score on the fresh episodes is another one. An agent on the observation track runs in a
    process of its own, which holds no simulator.

    This executes a stranger's code: do it in a container without a network (docs/leaderboard.md).
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
                told = submission, source, count, workers, decision_timeout
                try:
                    found = fly_again(*told, lambda record: progress.advance(record.cral), fresh, key)
                except RerunInterrupted as interrupted:
                    if interrupted.rerun.episodes:
                        save_rerun(kept, interrupted.rerun)
                    done = f"that the actions of {interrupted.rerun.episodes} episodes are the same stands in {kept}"
                    raise fail(f"interrupted; {done}", 1) from None
            save_rerun(kept, found)
            typer.echo(f"{submission.label}: {agent} took the same actions on {count} episodes; it stands in {kept}")
            if fresh:
                typer.echo(f"{submission.label}: {fresh_text(found)}")
    except UavbenchError as error:
        raise fail(error, 1) from None
