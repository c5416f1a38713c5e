"""What the commands print: tables and maps."""

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from uavbench.errors import one_line
from uavbench.evaluation.metrics import NAMES
from uavbench.world.cells import CELL_NAMES, CHARACTERS
from uavbench.world.scenario import Scenario

if TYPE_CHECKING:  # these import the compiler, and listing scenarios must not wait for that
    from uavbench.evaluation.metrics import Comparison, Interval
    from uavbench.evaluation.reference import Gaps, Reference
    from uavbench.evaluation.results import Result
    from uavbench.flight.flown import Flown
    from uavbench.flight.route import Flight
    from uavbench.leaderboard.ranking import Row
    from uavbench.speed.measure import Speed

_CITIES = 10  # from so many cities on, what one in ten has is printed
_LONGEST_HEAD = 20  # characters of an agent's name in a column's header
_STYLES = {"L": "bold blue", "N": "red", "#": "bright_black", "b": "bright_black"}


def scenario_table(scenarios: Iterable[Scenario]) -> Table:
    """Return the table of `uavbench list`."""
    table = Table(box=None, header_style="bold")
    for column in ("id", "map", "mission", "UAVs", "budget", "targets"):
        table.add_column(column, no_wrap=True)
    for scenario in scenarios:
        shape, budget = "{}×{}".format(*scenario.shape), "{}–{}".format(*scenario.budget)
        uavs = "{}–{}".format(*scenario.uavs) if scenario.uavs else "1"
        table.add_row(scenario.id, shape, scenario.mission.kind, uavs, budget, scenario.mission.targets)
    return table


def speed_tables(speeds: "Iterable[Speed]") -> Iterator[Table]:
    """Return the tables of `uavbench speed`, one for each task; they fit in 80 columns."""
    for task, rows in groupby(speeds, key=lambda speed: speed.task):
        table = Table(
            title=escape(task), title_justify="left", title_style="bold", box=None, header_style="dim", padding=(0, 1)
        )
        table.add_column("interface", min_width=13, no_wrap=True)
        for column, width in (("envs", 5), ("threads", 7), ("steps/s", 10), ("µs/step", 7), ("bytes", 6), ("GB/s", 5)):
            table.add_column(column, justify="right", min_width=width, no_wrap=True)
        table.add_column("copy/step", justify="right", no_wrap=True)
        for speed in rows:
            counted = [f"{speed.environments:,}", str(speed.threads), f"{speed.steps_per_second:,.0f}"]
            written = [f"{speed.bytes:,}", f"{speed.bytes / speed.microseconds / 1000:.2f}"] if speed.bytes else ["", ""]
            copied = f"{speed.copying / speed.microseconds:.2f}" if speed.copying else ""
            table.add_row(speed.interface, *counted, f"{speed.microseconds:.2f}", *written, copied)
        yield table


def scenario_text(scenario: Scenario, cells: NDArray[np.uint8], which: str) -> Text:
    """Return what `uavbench show` prints: the parameters and a map, given as codes of cells; ``which`` says which map it is."""
    text = Text()
    text.append(f"{scenario.id}", style="bold")
    text.append(f"  {one_line(scenario.title)}\n")  # a title may come from anybody, with control characters for the terminal
    text.append(f"digest {scenario.digest}\nfile {one_line(scenario.path)}\n\n")
    parts = scenario.model_dump(
        mode="json", exclude={"id": True, "title": True, "path": True, "rows": True, "cities": {"maps"}}
    )
    rows = [(name, value) for name, value in _flat(parts) if value != ""]
    width = max(len(name) for name, _ in rows) + 2
    for name, value in rows:
        text.append(f"{name:{width}}", style="cyan")
        text.append(f"{one_line(value)}\n")
    text.append(f"\n{which}\n" if scenario.cities else "\n")
    for row in cells:
        for code in row:
            text.append(CHARACTERS[code], style=_STYLES.get(CHARACTERS[code], ""))
        text.append("\n")
    text.append(f"\n{'  '.join(f'{sign} {name}' for sign, name in zip(CHARACTERS, CELL_NAMES, strict=True))}\n", style="dim")
    return text


def _flat(parts: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield nested parameters with dotted names."""
    for name, value in parts.items():
        if isinstance(value, Mapping):
            yield from _flat(cast("Mapping[str, Any]", value), f"{prefix}{name}.")
        elif value is not None:
            yield f"{prefix}{name}", value


def result_table(result: "Result") -> Group:
    """Return the scores that `uavbench evaluate` prints, in per cent."""
    summary = result.summary
    title = f"{summary['agent']} on {summary['scenario']}, {summary['episodes']} {summary['split']} episodes"
    table = Table(header_style="bold")
    for column in ("metric", "mean %", "95 % confidence interval"):
        table.add_column(column, justify="left" if column == "metric" else "right")
    for name, interval in result.metrics.items():
        table.add_row(NAMES[name], f"{100 * interval.mean:.1f}", _bounds(interval))
    parts = [Text(title, style="bold"), table]
    if summary.get("cral_over_cities", {}).get("cities", 0) >= _CITIES:
        spread = {name: 100 * value for name, value in summary["cral_over_cities"].items()}
        line = f"CRAL in {spread['cities'] / 100:.0f} cities: one in ten below {spread['tenth']:.1f} %, one in ten above "
        parts.append(Text(f"{line}{spread['ninetieth']:.1f} %"))
    return Group(*parts)


def comparison_table(first: "Result", second: "Result", comparison: "Mapping[str, Comparison]", episodes: int) -> Group:
    """Return what `uavbench compare` prints, in percentage points."""
    a, b = first.summary["agent"], second.summary["agent"]
    if a == b:
        a, b = str(first.folder), str(second.folder)
    better = a if len(a) <= _LONGEST_HEAD else "first"
    most = max(first.summary["episodes"], second.summary["episodes"])
    common = f" (of {most}, those that both flew)" if episodes < most else ""
    title = f"{a} - {b} on {first.summary['scenario']}, {episodes} paired episodes{common}"
    table = Table(header_style="bold")
    for column in ("metric", "difference, points", "95 % CI", f"P({escape(better)} better) %", "95 % CI"):
        table.add_column(column, justify="left" if column == "metric" else "right")
    for name, found in comparison.items():
        table.add_row(
            NAMES[name],
            f"{100 * found.difference.mean:+.1f}",
            _bounds(found.difference, "+"),
            f"{100 * found.improvement.mean:.1f}",
            _bounds(found.improvement),
        )
    return Group(Text(title, style="bold"), table)


def gaps_text(gaps: "Gaps") -> str:
    """Return how far a result is from the upper bounds and the best known scores, in percentage points of CRAL."""
    lines: list[str] = []
    for label, gap, count in (("bound", gaps.to_bound, gaps.bounded), ("best known", gaps.to_best, gaps.compared)):
        if gap:
            points = f"{100 * gap.mean:.1f} {_bounds(gap)}"
            lines.append(f"gap to {label:11}{points} points of CRAL, over {_count(count)}")
    if gaps.optimal:
        lines.append(f"proved optimal on {_count(gaps.optimal)}")
    if gaps.better:
        lines.append(f"better than the best known on {_count(gaps.better)}: uavbench bound --result records it")
    return "\n".join(lines)


def reference_table(scenario: Scenario, reference: "Reference") -> Group:
    """Return what `uavbench bound` prints: means of upper bounds, best known scores and their gaps, in per cent."""
    from uavbench.evaluation.reference import SPLIT, mean_known
    from uavbench.world.cities import city_numbers

    known = list(reference.values())
    bound, best = (np.array([getattr(k, name) for k in known]) for name in ("upper_bound", "best_known"))
    cities = city_numbers(scenario, SPLIT, np.array(list(reference), dtype=np.int64))
    table = Table(header_style="bold")
    for column in ("CRAL", "mean %", "95 % confidence interval", "episodes"):
        table.add_column(column, justify="left" if column == "CRAL" else "right")
    for name, values in {"upper bound": bound, "best known": best, "gap": bound - best}.items():
        interval = mean_known(values, cities)
        if interval:
            table.add_row(name, f"{100 * interval.mean:.1f}", _bounds(interval), f"{(~np.isnan(values)).sum():,}")
    optimal = sum(k.proved_optimal for k in known)
    title = f"{scenario.id}, test episodes" + (f", {optimal:,} proved optimal" if scenario.mission.exact else "")
    return Group(Text(title, style="bold"), table)


def _count(episodes: int) -> str:
    return f"{episodes:,} episode{'s' if episodes != 1 else ''}"


def _bounds(interval: "Interval", sign: str = "") -> str:
    return f"[{100 * interval.low:{sign}.1f}, {100 * interval.high:{sign}.1f}]"


def leaderboard_tables(rows: "Iterable[Row]") -> Group:
    """Return what `uavbench leaderboard build` prints: the scores, in per cent, a table for each track."""
    tables: dict[str, Table] = {}
    last: dict[str, str] = {}
    for row in rows:
        if row.track not in tables:
            table = tables[row.track] = Table(
                title=f"{row.track} track",
                box=box.SIMPLE_HEAD,
                padding=0,
                show_edge=False,  # so that it fits in 80 columns
            )
            for column in ("scenario", "agent", "rank", "Landed", "CR", "CRAL", "95 % CI"):
                table.add_column(column, justify="left" if column in ("scenario", "agent") else "right", no_wrap=True)
        if last.get(row.track, row.scenario) != row.scenario:
            tables[row.track].add_section()
        last[row.track] = row.scenario
        scores = [f"{100 * interval.mean:.1f}" for interval in (row.landed, row.cr, row.cral)]
        rank = "–" if row.rank is None else str(row.rank)
        interval = "published" if row.tier == "published" else _bounds(row.cral)
        tables[row.track].add_row(row.scenario, row.name, rank, *scores, interval)
    return Group(*tables.values())


def flown_table(flown: "Flown") -> Group:
    """Return what `uavbench fly` prints: what each quadrotor did, and CR as flown beside CR on the grid."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    for column in ("", *(f"UAV {k + 1}" for k in range(len(flown.uavs)))) if len(flown.uavs) > 1 else ("", "UAV"):
        table.add_column(column, justify="right" if column else "left")
    rows = {
        "hit something": ["yes" if uav.hit else "no" for uav in flown.uavs],
        "entered a no-fly zone": ["yes" if uav.zone else "no" for uav in flown.uavs],
        "least distance to a building": [_metres(uav.clearance) for uav in flown.uavs],
        "largest distance off the track": [_metres(uav.off_track) for uav in flown.uavs],
        "time": [f"{uav.seconds:.0f} s" for uav in flown.uavs],
        "energy": [f"{uav.energy:.1f} Wh" for uav in flown.uavs],
    }
    for name, cells in rows.items():
        table.add_row(name, *cells)
    flight, said = flown.flight, flown.conditions
    title = f"{flight.scenario.id}, episode {flight.episode}, {flight.agent}: {said.speed:g} m/s, wind {said.wind:g} m/s"
    scores = f"CR as flown {100 * flown.cr:.1f} %, on the grid {100 * flight.cr:.1f} %"
    return Group(Text(title, style="bold"), table, Text(scores))


def own_lines(flight: "Flight", cell: float, speed: float) -> Iterator[str]:
    """Yield what `uavbench plan` prints of a flight."""
    (route,) = flight.routes
    steps = route.moves + sum(stop.wait for stop in route.stops)
    given, done = int((flight.target > 0).sum()), int(((flight.target > 0) & (flight.left <= 0)).sum())
    what = "devices emptied" if flight.scenario.mission.words.mark else "cells covered"
    yield f"{what}: {done} of {given}; CR {100 * flight.cr:.1f} %"
    minutes = steps * cell / speed / 60
    yield f"{route.moves * cell:,.0f} m, {minutes:.1f} min at {speed:g} m/s, {steps} of {flight.scenario.budget[1]} moves"
    if not route.landed:
        yield "it does not land within its budget"


def _metres(value: float) -> str:
    return "–" if math.isinf(value) else f"{value:.1f} m"
