"""Results in tables and figures: a folder that a paper can take from."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uavbench.display import NAMES
from uavbench.metrics import METRICS, Interval, compare, mean_interval, proportion_interval
from uavbench.replay import check_paired
from uavbench.results import Result, ResultError
from uavbench.simulator import Simulator

_BINS = 8
_FORMATS = ("png", "pdf")


def write_report(results: Sequence[Result], folder: Path, on_file: Callable[[Path], None] = lambda path: None) -> None:
    """Write the tables and figures of results on the same episodes.

    ``comparison.md``, ``.tex`` and ``.csv``; ``cral_against_budget``, ``cr_against_targets``, ``failures_against_budget`` and
    ``performance_profiles`` as PNG and PDF.

    Raises
    ------
    ResultError
        When there are none, or they are not of the same scenario, split and episodes.
    """
    if not results:
        raise ResultError("no results: give folders that uavbench evaluate wrote")
    for other in results[1:]:
        check_paired(results[0], other)
    names = _names(results)
    folder.mkdir(parents=True, exist_ok=True)
    tables = _comparison(results, names)
    for ending, text in {"md": _markdown(tables), "tex": _latex(tables), "csv": _csv(tables)}.items():
        path = folder / f"comparison.{ending}"
        path.write_text(text, encoding="utf-8")
        on_file(path)
    figures = {
        "cral_against_budget": _against(results, names, "budget", "cral"),
        "cr_against_targets": _against(results, names, _amount_name(results[0]), "cr"),
        "failures_against_budget": _against(results, names, "budget", "failed"),
        "performance_profiles": _profiles(results, names),
    }
    for name, figure in figures.items():
        for ending in _FORMATS:
            path = folder / f"{name}.{ending}"
            figure.savefig(path, dpi=200)
            on_file(path)


def _names(results: Sequence[Result]) -> list[str]:
    """Return the agents' names; folders, where two are of one name."""
    names = [result.summary["agent"] for result in results]
    return names if len(set(names)) == len(names) else [str(result.folder) for result in results]


# Tables.


def _comparison(results: Sequence[Result], names: Sequence[str]) -> list[list[str]]:
    """Return the rows of the table, the head first: scores, and differences in CRAL to the first result."""
    first = results[0].episodes()["cral"].to_numpy(np.float64)
    rows = [["agent", *(NAMES[name] for name in METRICS), f"CRAL − {names[0]}", "steps"]]
    for result, name in zip(results, names, strict=True):
        table = result.episodes()
        difference = "" if result is results[0] else _cell(compare(table["cral"].to_numpy(np.float64), first).difference, "+")
        scores = [_cell(interval) for interval in result.metrics.values()]
        rows.append([name, *scores, difference, f"{table['steps'].mean():.1f}"])
    return rows


def _cell(interval: Interval, sign: str = "") -> str:
    return f"{100 * interval.mean:{sign}.1f} [{100 * interval.low:{sign}.1f}, {100 * interval.high:{sign}.1f}]"


def _markdown(rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    lines.insert(1, "| --- |" + " ---: |" * (len(rows[0]) - 1))
    return "\n".join(lines) + "\n"


def _latex(rows: Sequence[Sequence[str]]) -> str:
    escaped = [[_tex(cell) for cell in row] for row in rows]
    head, *body = [" & ".join(row) + r" \\" for row in escaped]
    columns = "l" + "r" * (len(rows[0]) - 1)
    return (
        "\n".join([rf"\begin{{tabular}}{{{columns}}}", r"\hline", head, r"\hline", *body, r"\hline", r"\end{tabular}"]) + "\n"
    )


def _tex(text: str) -> str:
    for plain, tex in {"\\": r"\textbackslash{}", "_": r"\_", "%": r"\%", "&": r"\&", "#": r"\#", "−": "$-$"}.items():
        text = text.replace(plain, tex)
    return text


def _csv(rows: Sequence[Sequence[str]]) -> str:
    import csv
    import io

    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


# Figures.


def _amount_name(result: Result) -> str:
    return "devices" if result.scenario.mission.kind == "harvesting" else "share of target cells, %"


def _amounts(result: Result) -> NDArray[np.float64]:
    """Return, for each episode, the number of devices or the share of cells that are targets, in per cent."""
    scenario, numbers = result.scenario, result.episodes()["episode"].tolist()
    simulator = Simulator(scenario, len(numbers))
    simulator.reset(range(len(numbers)), result.summary["split"], numbers)
    there = (simulator.state.target > 0).sum(axis=(1, 2)).astype(np.float64)
    return there if scenario.mission.kind == "harvesting" else 100 * there / simulator.state.target[0].size


def _against(results: Sequence[Result], names: Sequence[str], by: str, metric: str) -> Any:
    """Return the figure of a metric's means over episodes alike in budget, targets or devices."""
    label = {"cral": "CRAL, %", "cr": "CR, %", "failed": "not landed, %"}[metric]
    figure, axes = _figure(by if by != "budget" else "movement budget", label)
    x = results[0].episodes()["budget"].to_numpy(np.float64) if by == "budget" else _amounts(results[0])
    groups = _groups(x)
    for result, name in zip(results, names, strict=True):
        table = result.episodes()
        if metric == "failed":
            failed = table["landed"].to_numpy() == 0
            found = [proportion_interval(failed[group]) for group in groups]
        else:
            values = table[metric].to_numpy(np.float64)
            found = [mean_interval(values[group]) for group in groups]
        middle = [float(x[group].mean()) for group in groups]
        _band(axes, middle, found, name)
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


def _profiles(results: Sequence[Result], names: Sequence[str]) -> Any:
    """Return the figure of performance profiles: on which share of episodes CRAL is above τ (Agarwal et al., NeurIPS 2021)."""
    figure, axes = _figure("CRAL τ, %", "episodes with CRAL above τ, %")
    levels = np.linspace(0.0, 1.0, 101)
    for result, name in zip(results, names, strict=True):
        cral = result.episodes()["cral"].to_numpy(np.float64)
        _band(axes, (100 * levels).tolist(), [proportion_interval(cral > level) for level in levels], name, marker="")
    axes.legend(fontsize=8)
    return figure


def _figure(across: str, up: str) -> tuple[Any, Any]:
    figure: Any = Figure(figsize=(5.0, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.set(xlabel=across, ylabel=up)
    axes.grid(alpha=0.3)
    return figure, axes


def _band(axes: Any, x: Sequence[float], found: Sequence[Interval], name: str, marker: str = "o") -> None:
    """Draw means with the band of their intervals."""
    (line,) = axes.plot(x, [100 * each.mean for each in found], marker=marker, markersize=3.5, lw=1.4, label=name)
    low, high = [100 * each.low for each in found], [100 * each.high for each in found]
    axes.fill_between(x, low, high, color=line.get_color(), alpha=0.18, lw=0)
