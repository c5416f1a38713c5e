"""What commands share: how they fail, and arguments."""

import sys
from pathlib import Path
from typing import Annotated

import typer

ResultFolder = Annotated[Path, typer.Argument(help="A folder that evaluate wrote: OUT/<scenario>/<agent>.")]


def fail(error: BaseException | str, code: int = 2) -> typer.Exit:
    """Print what is wrong, and return the exit with ``code``."""
    print(f"uavbench: {error}", file=sys.stderr)  # noqa: T201
    return typer.Exit(code)
