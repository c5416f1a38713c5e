"""What commands share: error messages and arguments."""

import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
import typer.core

from uavbench.evaluation.interrupt import ignore_interrupts

if TYPE_CHECKING:
    from uavbench.evaluation.crew import Crew
    from uavbench.evaluation.results import Result


class Commands(typer.core.TyperGroup):
    """The commands: an interrupt, by Ctrl-C or SIGTERM, ends each of them with one line that says what was kept."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that the arguments name."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            ignore_interrupts()
            error.args = error.args or ("interrupted",)
            raise fail(error, 1) from None


ResultFolder = Annotated[Path, typer.Argument(help="A folder that evaluate wrote, OUT/<scenario>/<agent>, or a submission.")]


def number(value: float) -> float:
    """Refuse NaN, which older versions of Typer accept whatever the limits are."""
    if math.isnan(value):
        raise typer.BadParameter("nan is not a number")
    return value


DecisionTimeout = Annotated[float, typer.Option(min=1e-3, callback=number, help="Seconds that one decision may take.")]
ClusterEngine = Annotated[
    Literal["ray", "dask"] | None,
    typer.Option("--cluster", help="Work on a cluster of this kind instead of in --workers processes."),
]
ClusterAddress = Annotated[
    str | None, typer.Option("--address", help="Where the cluster is; by default one is started on this machine.")
]


def crew_of(workers: int, cluster: Literal["ray", "dask"] | None, address: str | None) -> "Crew":
    """Return who works: processes of this machine, or a cluster, which tells when a part of it is lost."""
    from uavbench.evaluation.cluster import Cluster

    if cluster is not None:
        return Cluster(cluster, address, lambda why: warn(f"a part of the cluster is lost: {why}"))
    if address is not None:
        raise fail("--address belongs to a cluster: give --cluster ray or --cluster dask")
    return workers


ScenarioFile = Annotated[
    str | None, typer.Option("--scenario", help="The .toml file of a scenario of your own, if it has moved.")
]


def flown(folder: Path) -> "Result":
    """Return the result in a folder: one that ``evaluate`` wrote, or a submission to the leaderboard.

    Raises
    ------
    ResultError
        When the folder holds no result, or one that cannot be used.
    """
    from uavbench.evaluation.results import ResultError, load_result
    from uavbench.leaderboard.submission import MANIFEST, SubmissionError, load_submission

    if not (folder / MANIFEST).exists():
        return load_result(folder)
    try:
        return load_submission(
            folder.absolute()
        ).result  # absolute: the names of folder and parent are checked, and "." has none
    except SubmissionError as error:
        raise ResultError(str(error)) from None


def command(*words: object) -> str:
    """Return a command of uavbench that can be pasted into a shell: words with spaces or other special letters are quoted."""
    return shlex.join(["uavbench", *map(str, words)])


def warn(line: str) -> None:
    """Print one line of warning."""
    print(f"uavbench: {line}", file=sys.stderr)  # noqa: T201


def fail(error: BaseException | str, code: int = 2) -> typer.Exit:
    """Print what is wrong without control characters, which may come from a file; return the exit with ``code``."""
    lines = "\n".join([str(error), *getattr(error, "__notes__", ())])
    seen = "".join(letter if letter.isprintable() or letter in "\n\t" else "?" for letter in lines)
    print(f"uavbench: {seen}", file=sys.stderr)  # noqa: T201
    return typer.Exit(code)
