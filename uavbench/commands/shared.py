"""What commands share: how they fail, and arguments."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from uavbench.results import Result

ResultFolder = Annotated[Path, typer.Argument(help="A folder that evaluate wrote: OUT/<scenario>/<agent>.")]
ScenarioFile = Annotated[
    str | None, typer.Option("--scenario", help="The .toml file of a scenario of your own, if it has moved.")
]


def flown(folder: Path) -> "Result":
    """Return the result in a folder: one that ``evaluate`` wrote, or a submission to the leaderboard."""
    from uavbench.leaderboard.submission import MANIFEST, load_submission
    from uavbench.results import load_result

    return load_submission(folder).result if (folder / MANIFEST).exists() else load_result(folder)


def fail(error: BaseException | str, code: int = 2) -> typer.Exit:
    """Print what is wrong, and return the exit with ``code``."""
    print(f"uavbench: {error}", file=sys.stderr)  # noqa: T201
    return typer.Exit(code)
