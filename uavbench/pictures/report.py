"""Reports: a folder with tables and figures of results, ready for publications."""

import html
import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from uavbench.evaluation.metrics import METRICS, NAMES, Interval, difference_over_seeds, mean_over_seeds, share_over_seeds
from uavbench.evaluation.replay import check_paired, flown_in
from uavbench.evaluation.results import Result, ResultError, deliver
from uavbench.evaluation.spreadsheet import plain_cell
from uavbench.pictures.figures import Figure, MaxNLocator, fixed_style
from uavbench.simulation.memory import episodes_at_once
from uavbench.simulation.simulator import Simulator
from uavbench.world.cities import city_at, city_keys, city_numbers
from uavbench.world.city import City
from uavbench.world.episode import episode_keys
from uavbench.world.scenario import Scenario, SplitName

if TYPE_CHECKING:
    import pandas as pd

_BINS = 8
_FORMATS = ("png", "pdf")
_MARKERS = "osD^vP"
_INTERVALS = "95 % confidence intervals"


@dataclass(frozen=True)
class Compared:
    """What a report compares: entries, each a result or a group of results, on the same episodes.

    Attributes
    ----------
    names : list of str
        The names of the entries, all different.
    runs : list of list of DataFrame
        For each entry, the episodes of its result, or of one result for each seed. Only episodes that all results have.
    scenario : Scenario
    split : str
    longest : int
        The number of episodes of the longest result.
    """

    names: list[str]
    runs: list[list[Any]]
    scenario: Scenario
    split: SplitName
    longest: int

    @property
    def tables(self) -> list[Any]:
        """The episodes of each entry's first result."""
        return [tables[0] for tables in self.runs]

    def values(self, metric: Callable[[Any], Any]) -> list[NDArray[Any]]:
        """Return, for each entry, the values of ``metric``, a function of a table: shape (seeds, episodes)."""
        return [np.stack([metric(table).to_numpy() for table in tables]) for tables in self.runs]

    @cached_property
    def cities(self) -> NDArray[np.int64] | None:
        """The number of the city of each episode; None if the scenario has one map."""
        return city_numbers(self.scenario, self.split, self.tables[0]["episode"].to_numpy(np.int64))

    @property
    def labels(self) -> list[str]:
        """The entries' names; with the number of seeds, if an entry has more than one."""
        return [
            f"{name} ({len(runs)} seeds)" if len(runs) > 1 else name for name, runs in zip(self.names, self.runs, strict=True)
        ]

    @property
    def subject(self) -> str:
        """Scenario, split, and the number of episodes that all results have."""
        common = len(self.tables[0])
        hint = f" (of {self.longest:,}, those that all flew)" if common < self.longest else ""
        return f"{self.scenario.id}, {self.split} split, {common:,} episodes{hint}"


def write_report(
    results: Sequence[Result],
    folder: Path,
    on_file: Callable[[Path], object] = lambda path: None,
    scenario_file: str | None = None,
    groups: Mapping[str, Sequence[Result]] | None = None,
    against: str | None = None,
) -> list[str]:
    """Write tables and figures that compare results on the same episodes.

    Parameters
    ----------
    results : sequence of Result
        Each is one entry.
    folder : Path
        Where to write; created if it does not exist. Nothing is written before everything is computed.
    on_file : callable, optional
        Called with the path of every file that is ready to be written.
    scenario_file : str, optional
        The scenario's file, if it is a user's own and has moved.
    groups : mapping of str to sequence of Result, optional
        Methods that were trained with several seeds, by name, with a result for each seed. Each method is one entry, after
        those of ``results``: the mean over its seeds, with confidence intervals over seeds and episodes.
    against : str, optional
        The name of the entry that the others are compared with, which is listed first; by default the first entry.

    Returns
    -------
    list of str
        The names of the files.

    Raises
    ------
    ResultError
        When there are no results, one is given twice or damaged, two entries have the same name, the results are not of the
        same scenario and split, no entry has the name ``against``, or a file cannot be written.
    """
    compared = _compare(results, scenario_file, groups or {}, against)
    rows = _comparison(compared)
    files = {
        "comparison.md": _markdown(rows, compared.subject).encode(),
        "comparison.tex": _latex(rows, compared.subject).encode(),
        "comparison.csv": _csv(compared).encode(),
    }
    for name in files:
        on_file(folder / name)
    with fixed_style("".join(compared.labels)):
        for name, draw in (_FIGURES if compared.cities is None else {**_FIGURES, **_CITY_FIGURES}).items():
            figure = draw(compared)
            for ending in _FORMATS:
                buffer = io.BytesIO()
                figure.savefig(buffer, dpi=200, format=ending)
                files[f"{name}.{ending}"] = buffer.getvalue()
                on_file(folder / f"{name}.{ending}")
    deliver({folder / name: content for name, content in files.items()})
    return list(files)


def _compare(
    results: Sequence[Result], scenario_file: str | None, groups: Mapping[str, Sequence[Result]], against: str | None = None
) -> Compared:
    """Check that results can be compared, and select the episodes that all of them have."""
    every = [*results, *(result for group in groups.values() for result in group)]
    if not every:
        raise ResultError("no results: give folders that uavbench evaluate wrote")
    folders = [result.folder.resolve() for result in every]
    for k, folder in enumerate(folders):
        if folder in folders[:k]:
            raise ResultError(f"{every[k].folder}: given twice")
    names = _names(results, folders[: len(results)])
    for name in groups:
        if name in names:
            raise ResultError(f"--group {name}: a result has this name; choose another one")
    scenario, split = flown_in(every[0], scenario_file)
    for other in every[1:]:
        check_paired(every[0], other)
    runs = [[result.scores() for result in group] for group in (*([result] for result in results), *groups.values())]
    lengths = [len(table) for tables in runs for table in tables]
    runs = [[table.iloc[: min(lengths)] for table in tables] for tables in runs]  # every result begins with episode 0
    entries = list(zip([*names, *groups], runs, strict=True))
    if against is not None:
        if against not in (name for name, _ in entries):
            raise ResultError(
                f"--against {against}: no entry has this name; there are {', '.join(name for name, _ in entries)}"
            )
        entries.sort(key=lambda entry: entry[0] != against)
    return Compared([name for name, _ in entries], [tables for _, tables in entries], scenario, split, max(lengths))


def _names(results: Sequence[Result], folders: Sequence[Path]) -> list[str]:
    """Return the agents' names; where several have the same name, the shortest ends of their folders' paths that differ."""
    names: list[str] = [result.summary["agent"] for result in results]
    alike = [k for k, name in enumerate(names) if names.count(name) > 1]
    for parts in range(1, 100):
        ends = {k: "/".join(folders[k].parts[-parts:]) for k in alike}
        if len(set(ends.values())) == len(alike):
            return [ends.get(k, name) for k, name in enumerate(names)]
    return [str(folder) for folder in folders]


# Tables.


def _numbers(compared: Compared) -> "pd.DataFrame":
    """Return the table as numbers: scores in [0, 1], differences in CRAL from the first entry, and steps."""
    import pandas as pd

    scores = {metric: compared.values(lambda table, metric=metric: table[metric]) for metric in (*METRICS, "steps")}
    rows: list[dict[str, Any]] = []
    cities = compared.cities
    for k, name in enumerate(compared.names):
        landed, cr, cral, steps = (scores[metric][k].astype(np.float64) for metric in scores)
        row: dict[str, Any] = {"agent": name, "seeds": len(steps), "episodes": steps.shape[1]}
        intervals = {name: mean_over_seeds(values, clusters=cities) for name, values in (("cr", cr), ("cral", cral))}
        intervals = {"landed": share_over_seeds(landed > 0, clusters=cities), **intervals}
        if k > 0:
            intervals["cral_difference"] = difference_over_seeds(cral, scores["cral"][0], clusters=cities)
        for metric, interval in intervals.items():
            row |= {metric: interval.mean, f"{metric}_low": interval.low, f"{metric}_high": interval.high}
        rows.append({**row, "steps": steps.mean()})
    means = [row.pop("steps") for row in rows]
    return pd.DataFrame(rows).assign(steps=means)


def _csv(compared: Compared) -> str:
    """Return the numbers as CSV in which no spreadsheet takes an agent's name for a formula."""
    numbers = _numbers(compared).assign(agent=[plain_cell(name) for name in compared.names])
    return numbers.to_csv(index=False, lineterminator="\n")


def _comparison(compared: Compared) -> list[list[str]]:
    """Return the rows of the table as formatted text, the header first."""
    rows = [["agent", *(NAMES[name] for name in METRICS), f"CRAL − {compared.names[0]}", "steps"]]
    for label, row in zip(compared.labels, _numbers(compared).to_dict("records"), strict=True):
        scores = [_cell(row, name) for name in METRICS]
        difference = "" if len(rows) == 1 else _cell(row, "cral_difference", "+")
        rows.append([label, *scores, difference, f"{row['steps']:.1f}"])
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
    """Escape Markdown and HTML in a text."""
    return re.sub(r"([\\`*|\[\]])", r"\\\1", html.escape(text, quote=False))


def _latex(rows: Sequence[Sequence[str]], subject: str) -> str:
    head, *body = [" & ".join(_tex(cell) for cell in row) + r" \\" for row in rows]
    body = [f"{{}}{row}" if row[0] in "[*" else row for row in body]  # else LaTeX takes it for an argument of the \\ above
    columns = "l" + "r" * (len(rows[0]) - 1)
    notes = [f"% {subject}; in %, with {_INTERVALS}; steps are means.", r"% Needs \usepackage{booktabs}."]
    table = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", head, r"\midrule", *body, r"\bottomrule", r"\end{tabular}"]
    return "\n".join([*notes, *table]) + "\n"


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
    """Return each episode's number of target cells if the mission counts them, else their share of the map in per cent."""
    numbers = compared.tables[0]["episode"].tolist()
    slots = min(len(numbers), episodes_at_once(compared.scenario))
    simulator = Simulator(compared.scenario, slots)
    parts: list[NDArray[np.float64]] = []
    for first in range(0, len(numbers), slots):
        some = numbers[first : first + slots]
        simulator.reset(range(len(some)), compared.split, some)
        parts.append((simulator.state.target[: len(some)] > 0).sum(axis=(1, 2)).astype(np.float64))
    there = np.concatenate(parts)
    return there if compared.scenario.mission.counted else 100 * there / simulator.state.target[0].size


def _cral_against_budget(compared: Compared) -> Any:
    return _against(compared, _budget_name(compared), "CRAL, %", _budgets(compared), lambda table: table["cral"])


def _cr_against_targets(compared: Compared) -> Any:
    label = compared.scenario.mission.counted or "share of target cells, %"
    return _against(compared, label, "CR, %", _amounts(compared), lambda table: table["cr"])


def _cral_against_building_share(compared: Compared) -> Any:
    shares = _of_cities(compared, lambda city: 100 * city.building.mean())
    return _against(compared, "buildings, % of the city", "CRAL, %", shares, lambda table: table["cral"])


def _cral_against_landing_distance(compared: Compared) -> Any:
    distances = _of_cities(compared, lambda city: city.distance_to_landing[city.distance_to_landing >= 0].mean())
    across = "moves to a landing zone, mean over the city"
    return _against(compared, across, "CRAL, %", distances, lambda table: table["cral"])


def _of_cities(compared: Compared, measure: Callable[[City], float]) -> NDArray[np.float64]:
    """Return a measure of each episode's city, shape (n,)."""
    numbers = compared.tables[0]["episode"].to_numpy(np.int64)
    keys = city_keys(compared.scenario, episode_keys(compared.split, numbers))
    measured = {key: measure(city_at(compared.scenario, key)) for key in dict.fromkeys(keys)}
    return np.array([measured[key] for key in keys])


def _failures_against_budget(compared: Compared) -> Any:
    figure = _against(compared, _budget_name(compared), "not landed, %", _budgets(compared), lambda table: table["landed"] == 0)
    (axes,) = figure.axes
    if all((table["landed"] == 1).all() for tables in compared.runs for table in tables):
        axes.set(ylim=(-0.5, 10))
        axes.text(0.5, 0.5, "All agents landed in every episode.", transform=axes.transAxes, ha="center", va="center")
    return figure


def _budget_name(compared: Compared) -> str:
    return "movement budget, all UAVs together" if compared.scenario.team else "movement budget"


def _against(compared: Compared, across: str, up: str, x: NDArray[np.float64], metric: Callable[[Any], Any]) -> Any:
    """Return the figure of a metric's means over groups of episodes with similar ``x``."""
    figure, axes = _figure(compared, across, up)
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    groups = _groups(x)
    middle = [float(x[group].mean()) for group in groups]
    for k, values in enumerate(compared.values(metric)):
        shares = values.dtype == np.bool_
        found = [
            (share_over_seeds if shares else mean_over_seeds)(
                values[:, group], clusters=None if compared.cities is None else compared.cities[group]
            )
            for group in groups
        ]
        never = shares and not values.any()  # no band around zero: several of them would hide the other lines
        _band(axes, k, middle, found, compared.labels[k], marker=_MARKERS[k % len(_MARKERS)], shade=not never)
    _legend(figure, axes)
    return figure


def _groups(x: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Return groups of episodes with similar ``x``: one for each value if there are few values, else of about equal size."""
    values = np.unique(x)
    if len(values) <= _BINS:
        return [np.flatnonzero(x == value) for value in values]
    edges = np.unique(np.quantile(x, np.linspace(0, 1, _BINS + 1)))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    return [np.flatnonzero(place == k) for k in range(len(edges) - 1) if (place == k).any()]


def _performance_profiles(compared: Compared) -> Any:
    """Return the figure of performance profiles: the share of episodes with CRAL above τ (Agarwal et al., NeurIPS 2021)."""
    figure, axes = _figure(compared, "CRAL τ, %", "episodes with CRAL above τ, %")
    levels = np.arange(100) / 100  # no CRAL is above 1
    for k, cral in enumerate(compared.values(lambda table: table["cral"])):
        found = [share_over_seeds(cral > level, clusters=compared.cities) for level in levels]
        _band(axes, k, (100 * levels).tolist(), found, compared.labels[k])
    _legend(figure, axes)
    return figure


def _figure(compared: Compared, across: str, up: str) -> tuple[Any, Any]:
    figure: Any = Figure(figsize=(5.0, 3.3), layout="constrained")
    axes = figure.subplots()
    axes.set_title(compared.subject, fontsize=8)
    axes.set(xlabel=across, ylabel=up)
    axes.grid(alpha=0.3)
    return figure, axes


def _legend(figure: Any, axes: Any) -> None:
    """Write the entries' names below the axes, where they cover nothing; the figure grows by the height of these lines."""
    handles, labels = axes.get_legend_handles_labels()
    columns = max(1, min(4, int(75 / (7 + max(map(len, labels))))))  # about 75 letters fit in a line
    figure.set_figheight(figure.get_figheight() + 0.17 * math.ceil(len(labels) / columns))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=8, frameon=False)


def _band(
    axes: Any, k: int, x: Sequence[float], found: Sequence[Interval], name: str, marker: str = "", shade: bool = True
) -> None:
    """Draw the means of entry ``k`` with a band of their intervals; the dashes let overlapping lines be told apart."""
    dashes = "-" if k == 0 else (0, (4, 1 + k))
    label = name.replace("$", r"\$")  # else Matplotlib reads it as mathematics
    label = f" {label}" if label.startswith("_") else label  # else Matplotlib leaves it out of the legend
    (line,) = axes.plot(x, [100 * each.mean for each in found], ls=dashes, marker=marker, ms=4, mfc="none", lw=1.4, label=label)
    if not shade:
        return
    low, high = [100 * each.low for each in found], [100 * each.high for each in found]
    axes.fill_between(x, low, high, color=line.get_color(), alpha=0.18, lw=0)


_FIGURES = {
    "cral_against_budget": _cral_against_budget,
    "cr_against_targets": _cr_against_targets,
    "failures_against_budget": _failures_against_budget,
    "performance_profiles": _performance_profiles,
}
#: More of them, if the scenario has many cities.
_CITY_FIGURES = {
    "cral_against_building_share": _cral_against_building_share,
    "cral_against_landing_distance": _cral_against_landing_distance,
}
