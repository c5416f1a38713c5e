"""``uavbench submit`` and ``uavbench leaderboard``."""

from pathlib import Path
from typing import Annotated

import typer

from uavbench.commands.shared import DecisionTimeout, fail

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
    from uavbench.leaderboard.submit import submit as make_submission
    from uavbench.progress import working
    from uavbench.results import load_result

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
    from uavbench.leaderboard.board import submission_folders
    from uavbench.leaderboard.board import verify as check
    from uavbench.progress import working

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
    from uavbench.display import leaderboard_tables
    from uavbench.leaderboard.board import build as build_board
    from uavbench.leaderboard.board import submission_folders
    from uavbench.progress import working

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
    "  uavbench leaderboard rerun leaderboard/submissions/my-agent --agent my_agent.py --weights my_weights.pt"
)
def rerun(
    folder: _Submissions,
    agent: Annotated[
        str,
        typer.Option(help="What was submitted: path.py, path.py:Class, a .safetensors or .onnx file, or a built-in."),
    ],
    weights: Annotated[Path | None, typer.Option(help="What the agent's own file flew with.")] = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="How many, from 0 on; by default all.")] = None,
    workers: _Workers = 1,
    decision_timeout: DecisionTimeout = 60.0,
) -> None:
    """Execute a submission's agent again, and compare every action.

    Where it takes the same ones, that is written down in reruns.csv beside the folder of all submissions, and the next build
    shows the tier "rerun".
    """
    from rich.console import Console

    from uavbench import UavbenchError
    from uavbench.agent import find_agent
    from uavbench.leaderboard.board import submission_folders
    from uavbench.leaderboard.reruns import check_reruns, fly_again, save_rerun
    from uavbench.leaderboard.submission import load_submission
    from uavbench.progress import episodes_progress

    try:
        source = find_agent(agent, weights)
        for each in submission_folders(folder):
            submission = load_submission(each)
            kept = each.parent.parent.parent / "reruns.csv"
            check_reruns(kept)
            count = min(episodes or submission.manifest.result.episodes, submission.manifest.result.episodes)
            with episodes_progress(Console(stderr=True), submission.label, "CRAL") as progress:
                progress.show(count)
                found = fly_again(
                    submission, source, count, workers, decision_timeout, lambda record: progress.advance(record.cral)
                )
            save_rerun(kept, found)
            typer.echo(f"{submission.label}: {agent} took the same actions on {count} episodes; it stands in {kept}")
    except UavbenchError as error:
        raise fail(error, 1) from None
