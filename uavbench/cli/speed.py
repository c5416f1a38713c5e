"""``uavbench speed``."""

import json
from pathlib import Path
from typing import Annotated

import typer

from uavbench.cli.shared import fail, warn


def speed(
    scenario: Annotated[
        list[str] | None,
        typer.Option(help="An id or a .toml file; by default both missions on both of the paper's maps; repeatable."),
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help="How often everything is measured; the best round counts.")] = 10,
    peers: Annotated[bool, typer.Option(help="Measure other suites too, if they are installed.")] = True,
    out: Annotated[
        Path | None, typer.Option("--json", help="Also write the figures and the machine's name to this file.")
    ] = None,
) -> None:
    """Measure how many steps per second this machine simulates.

    Measures one environment, and batches of 1 to 1,024 environments on one core and on all, with and without observations. The
    tables also show how long copying the same observations takes. The first run compiles the code for several cores.
    """
    from rich.console import Console

    from uavbench import UavbenchError, load_scenario
    from uavbench.cli.display import speed_tables
    from uavbench.cli.progress import working
    from uavbench.speed.measure import SCENARIOS, machine, measure, prepare, report
    from uavbench.world.files import check_file_writable, write_atomic

    console = Console()
    try:
        if out is not None:  # now, rather than after all measurements
            check_file_writable(out)
        everything = prepare([load_scenario(name) for name in scenario or SCENARIOS], peers=peers, on_failure=warn)
        with working(console, "rounds", rounds) as advance:
            speeds = measure(everything, rounds, advance)
    except UavbenchError as error:
        raise fail(error) from None
    except OSError as error:
        raise fail(f"--json: cannot write {error.filename or out}: {error.strerror}") from None
    for table in speed_tables(speeds):
        console.print(table, "")
    console.print(
        "copy/step: the time to copy the same observations, divided by the time of a step", style="dim", highlight=False
    )
    console.print("{processor}, {cores} cores, {system}".format(**machine()), highlight=False, markup=False)
    if out is not None:
        try:
            write_atomic(out, (json.dumps(report(speeds), indent=1) + "\n").encode())
        except OSError as error:
            raise fail(f"--json: cannot write {error.filename or out}: {error.strerror}") from None
        console.print(f"wrote {out}", highlight=False, markup=False, soft_wrap=True)
