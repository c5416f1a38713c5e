"""Results in tables and figures: a folder that a paper can take from."""

import html
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from uavbench.display import NAMES
from uavbench.memory import episodes_at_once
from uavbench.metrics import METRICS, Interval, compare, mean_interval, proportion_interval, summarise
from uavbench.replay import check_paired, flown_in
from uavbench.results import Result, ResultError, deliver
from uavbench.scenario import Scenario, SplitName
from uavbench.simulator import Simulator
from uavbench.spreadsheet import plain_cell

if TYPE_CHECKING:
    import pandas as pd

_BINS = 8
_FORMATS = ("png", "pdf")
_MARKERS = "osD^vP"
_INTERVALS = "95 % confidence intervals"


@dataclass(frozen=True)
class Compared:
    """What a report is of: results on the same episodes.

    Attributes
    ----------
    names : list of str
        Of the agents, no two alike.
    results : sequence of Result
    tables : list of DataFrame
        Their episodes.
    scenario : Scenario
    split : str
    """

    names: list[str]
    results: Sequence[Result]
    tables: list[Any]
    scenario: Scenario
    split: SplitName

    @property
    def subject(self) -> str:
        """Scenario, split and number of episodes: of those that every agent flew."""
        common, most = len(self.tables[0]), max(result.summary["episodes"] for result in self.results)
        hint = f" (of {most:,}, those that all flew)" if common < most else ""
        return f"{self.scenario.id}, {self.split} split, {common:,} episodes{hint}"


def write_report(
    results: Sequence[Result],
    folder: Path,
    on_file: Callable[[Path], object] = lambda path: None,
    scenario_file: str | None = None,
) -> None:
    """Write the tables and figures of results on the same episodes: `FILES`.

    Parameters
    ----------
    results : sequence of Result
    folder : Path
        Where to; it need not be there. Nothing is written before everything is computed.
    on_file : callable, optional
        Told of every file that is ready to be written.
    scenario_file : str, optional
        Where the scenario is, if it is a user's own and not where it was.

    Raises
    ------
    ResultError
        When there are none, one is there twice or damaged, or they are not of the same scenario, split and episodes.
    """
    compared = _compare(results, scenario_file)
    rows = _comparison(compared)
    files = {
        "comparison.md": _markdown(rows, compared.subject).encode(),
        "comparison.tex": _latex(rows, compared.subject).encode(),
        "comparison.csv": _csv(compared).encode(),
    }
    for name in files:
        on_file(folder / name)
    for name, draw in _FIGURES.items():
        figure = draw(compared)
        for ending in _FORMATS:
            buffer = io.BytesIO()
            figure.savefig(buffer, dpi=200, format=ending)
            files[f"{name}.{ending}"] = buffer.getvalue()
            on_file(folder / f"{name}.{ending}")
    deliver({folder / name: content for name, content in files.items()})


def _compare(results: Sequence[Result], scenario_file: str | None) -> Compared:
    """Look whether results can be compared."""
    if not results:
        raise ResultError("no results: give folders that uavbench evaluate wrote")
    folders = [result.folder.resolve() for result in results]
    for k, folder in enumerate(folders):
        if folder in folders[:k]:
            raise ResultError(f"{results[k].folder}: given twice")
    scenario, split = flown_in(results[0], scenario_file)
    for other in results[1:]:
        check_paired(results[0], other)
    tables = [result.scores() for result in results]
    common = min(len(table) for table in tables)  # every result begins with episode 0
    tables = [table.iloc[:common] for table in tables]
    return Compared(_names(results, folders), results, tables, scenario, split)


def _names(results: Sequence[Result], folders: Sequence[Path]) -> list[str]:
    """Return the agents' names; for those of one name as much of their folders' paths as tells them apart."""
    names: list[str] = [result.summary["agent"] for result in results]
    alike = [k for k, name in enumerate(names) if names.count(name) > 1]
    for parts in range(1, 100):
        ends = {k: "/".join(folders[k].parts[-parts:]) for k in alike}
        if len(set(ends.values())) == len(alike):
            return [ends.get(k, name) for k, name in enumerate(names)]
    return [str(folder) for folder in folders]


# Tables.


def _numbers(compared: Compared) -> "pd.DataFrame":
    """Return the table as numbers, shares in [0, 1]: scores, differences in CRAL to the first result, and steps."""
    import pandas as pd

    first = compared.tables[0]["cral"].to_numpy(np.float64)
    rows: list[dict[str, Any]] = []
    for name, table in zip(compared.names, compared.tables, strict=True):
        row: dict[str, Any] = {"agent": name, "episodes": len(table)}
        landed, cr, cral = (table[metric].to_numpy(np.float64) for metric in METRICS)
        intervals = summarise(landed > 0, cr, cral)
        if table is not compared.tables[0]:
            intervals["cral_difference"] = compare(cral, first).difference
        for metric, interval in intervals.items():
            row |= {metric: interval.mean, f"{metric}_low": interval.low, f"{metric}_high": interval.high}
        rows.append({**row, "steps": table["steps"].mean()})
    steps = [row.pop("steps") for row in rows]
    return pd.DataFrame(rows).assign(steps=steps)


def _csv(compared: Compared) -> str:
    """Return the numbers as a file that spreadsheets read without taking a name for a formula."""
    numbers = _numbers(compared).assign(agent=[plain_cell(name) for name in compared.names])
    return numbers.to_csv(index=False, lineterminator="\n")


def _comparison(compared: Compared) -> list[list[str]]:
    """Return the rows of the table as people read it, the head first."""
    rows = [["agent", *(NAMES[name] for name in METRICS), f"CRAL − {compared.names[0]}", "steps"]]
    for row in _numbers(compared).to_dict("records"):
        scores = [_cell(row, name) for name in METRICS]
        difference = "" if len(rows) == 1 else _cell(row, "cral_difference", "+")
        rows.append([row["agent"], *scores, difference, f"{row['steps']:.1f}"])
    return rows


def _cell(row: Mapping[Any, Any], name: str, sign: str = "") -> str:
    mean, low, high = (f"{100 * row[name + part]:{sign}.1f}".replace("-", "−") for part in ("", "_low", "_high"))
    return f"{mean} [{low}, {high}]"


def _markdown(rows: Sequence[Sequence[str]], subject: str) -> str:
    head, *body = rows
    cells = [[_marked(cell) for cell in head], *([_marked(name), *numbers] for name, *numbers in body)]
    lines = ["| " + " | ".join(row) + " |" for row in cells]
    lines.insert(1, "| --- |" + " ---: |" * (len(rows[0]) - 1))
    return "\n".join([f"{subject}; in %, with {_INTERVALS}; steps are means.", "", *lines]) + "\n"


def _marked(text: str) -> str:
    """Return text that Markdown shows as it is, HTML in it too."""
    return re.sub(r"([\\`*|\[\]])", r"\\\1", html.escape(text, quote=False))


def _latex(rows: Sequence[Sequence[str]], subject: str) -> str:
    head, *body = [" & ".join(_tex(cell) for cell in row) + r" \\" for row in rows]
    columns = "l" + "r" * (len(rows[0]) - 1)
    begin = [f"% {subject}; in %, with {_INTERVALS}; steps are means.", rf"\begin{{tabular}}{{{columns}}}"]
    return "\n".join([*begin, r"\hline", head, r"\hline", *body, r"\hline", r"\end{tabular}"]) + "\n"


_TEX = {letter: f"\\{letter}" for letter in "_%&#${}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "−": "$-$",
}


def _tex(text: str) -> str:
    return "".join(_TEX.get(letter, letter) for letter in text)


# Figures.


def _budgets(compared: Compared) -> NDArray[np.float64]:
    return compared.tables[0]["budget"].to_numpy(np.float64)


def _amounts(compared: Compared) -> NDArray[np.float64]:
    """Return, for each episode, the number of devices or the share of cells that are targets, in per cent."""
    numbers = compared.tables[0]["episode"].tolist()
    slots = min(len(numbers), episodes_at_once(compared.scenario))
    simulator = Simulator(compared.scenario, slots)
    parts: list[NDArray[np.float64]] = []
    for first in range(0, len(numbers), slots):
        some = numbers[first : first + slots]
        simulator.reset(range(len(some)), compared.split, some)
        parts.append((simulator.state.target[: len(some)] > 0).sum(axis=(1, 2)).astype(np.float64))
    there = np.concatenate(parts)
    return there if compared.scenario.mission.kind == "harvesting" else 100 * there / simulator.state.target[0].size


def _cral_against_budget(compared: Compared) -> Any:
    return _against(compared, _budget_name(compared), "CRAL, %", _budgets(compared), lambda table: table["cral"])


def _cr_against_targets(compared: Compared) -> Any:
    harvests = compared.scenario.mission.kind == "harvesting"
    label = "devices" if harvests else "share of target cells, %"
    return _against(compared, label, "CR, %", _amounts(compared), lambda table: table["cr"])


def _failures_against_budget(compared: Compared) -> Any:
    return _against(compared, _budget_name(compared), "not landed, %", _budgets(compared), lambda table: table["landed"] == 0)


def _budget_name(compared: Compared) -> str:
    return "movement budget, all UAVs together" if compared.scenario.team else "movement budget"


def _against(compared: Compared, across: str, up: str, x: NDArray[np.float64], metric: Callable[[Any], Any]) -> Any:
    """Return the figure of a metric's means over episodes alike in ``x``."""
    figure, axes = _figure(compared, across, up)
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    groups = _groups(x)
    middle = [float(x[group].mean()) for group in groups]
    for k, (name, table) in enumerate(zip(compared.names, compared.tables, strict=True)):
        values = metric(table).to_numpy()
        interval = proportion_interval if values.dtype == np.bool_ else mean_interval
        _band(axes, k, middle, [interval(values[group]) for group in groups], name, marker=_MARKERS[k % len(_MARKERS)])
    axes.legend(fontsize=8)
    return figure


def _groups(x: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Return episodes in groups alike in ``x``: a value each, if there are few, else about as many in each."""
    values = np.unique(x)
    if len(values) <= _BINS:
        return [np.flatnonzero(x == value) for value in values]
    edges = np.unique(np.quantile(x, np.linspace(0, 1, _BINS + 1)))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    return [np.flatnonzero(place == k) for k in range(len(edges) - 1) if (place == k).any()]


def _performance_profiles(compared: Compared) -> Any:
    """Return the figure of performance profiles: on which share of episodes CRAL is above τ (Agarwal et al., NeurIPS 2021)."""
    figure, axes = _figure(compared, "CRAL τ, %", "episodes with CRAL above τ, %")
    levels = np.arange(100) / 100  # no CRAL is above 1
    for k, (name, table) in enumerate(zip(compared.names, compared.tables, strict=True)):
        cral = table["cral"].to_numpy(np.float64)
        _band(axes, k, (100 * levels).tolist(), [proportion_interval(cral > level) for level in levels], name)
    axes.legend(fontsize=8)
    return figure


def _figure(compared: Compared, across: str, up: str) -> tuple[Any, Any]:
    figure: Any = Figure(figsize=(5.0, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.set_title(compared.subject, fontsize=8)
    axes.set(xlabel=across, ylabel=up)
    axes.grid(alpha=0.3)
    return figure, axes


def _band(axes: Any, k: int, x: Sequence[float], found: Sequence[Interval], name: str, marker: str = "") -> None:
    """Draw the means of agent ``k`` with the band of their intervals; dashes show lines that lie on each other."""
    dashes = "-" if k == 0 else (0, (4, 1 + k))
    label = name.replace("$", r"\$")  # else mathematics
    label = f" {label}" if label.startswith("_") else label  # else left out of the legend
    (line,) = axes.plot(x, [100 * each.mean for each in found], ls=dashes, marker=marker, ms=4, mfc="none", lw=1.4, label=label)
    low, high = [100 * each.low for each in found], [100 * each.high for each in found]
    axes.fill_between(x, low, high, color=line.get_color(), alpha=0.18, lw=0)


_FIGURES = {
    "cral_against_budget": _cral_against_budget,
    "cr_against_targets": _cr_against_targets,
    "failures_against_budget": _failures_against_budget,
    "performance_profiles": _performance_profiles,
}
#: The files of a report.
FILES = (
    *(f"comparison.{ending}" for ending in ("md", "tex", "csv")),
    *(f"{name}.{ending}" for name in _FIGURES for ending in _FORMATS),
)
