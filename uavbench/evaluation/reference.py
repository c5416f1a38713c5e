"""What is known about the test episodes: upper bounds and best scores, in ``reference/<id>.csv`` beside the scenario's file."""

import csv
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.errors import one_line
from uavbench.evaluation.metrics import Interval, mean_interval, tolerance
from uavbench.evaluation.replay import replay
from uavbench.evaluation.results import Result, ResultError
from uavbench.world.cities import city_numbers
from uavbench.world.files import TABLE_BYTES, FileError, read_text, write_atomic
from uavbench.world.scenario import Scenario

#: The split whose episodes have bounds.
SPLIT = "test"
_COLUMNS = ("episode", "upper_bound", "method", "seconds", "best_known", "agent", "proved_optimal", "scenario_digest")
#: How many digits of a scenario's digest tables have: enough to tell scenarios apart.
DIGITS = 12


@dataclass(frozen=True)
class Known:
    """What is known about one test episode.

    Attributes
    ----------
    episode : int
        The episode's number.
    upper_bound : float
        What no agent can exceed: in CPP by the CRAL of any flight, in DH by its expected CRAL over the noise. In [0, 1]; NaN
        where none has been computed.
    method : str
        The method that gave the bound.
    seconds : float
        Processor time that the method was allowed to take.
    best_known : float
        The highest CRAL that an agent has reached, in [0, 1]; NaN where there is none.
    agent : str
        The agent that reached it.
    proved_optimal : bool
        Whether the best known CRAL reaches the bound. Never in DH, where a lucky flight may exceed the expected CRAL.
    """

    episode: int
    upper_bound: float = math.nan
    method: str = ""
    seconds: float = 0.0
    best_known: float = math.nan
    agent: str = ""
    proved_optimal: bool = False


#: What is known about episodes, by their numbers.
Reference = dict[int, Known]


@dataclass(frozen=True)
class Gaps:
    """How far a result is from the upper bounds and from the best known scores, in CRAL.

    Attributes
    ----------
    to_bound : Interval, optional
        Mean of upper bound − CRAL over the ``bounded`` episodes.
    to_best : Interval, optional
        Mean of best known − CRAL over the ``compared`` episodes.
    bounded, compared : int
        Number of episodes that have an upper bound, and a best known score.
    optimal : int
        Number of episodes on which the result is proved optimal.
    better : int
        Number of episodes on which the result is better than the best known.
    """

    to_bound: Interval | None
    to_best: Interval | None
    bounded: int
    compared: int
    optimal: int
    better: int


def reference_path(scenario: Scenario) -> Path:
    """Return the path of a scenario's reference table; the file need not exist."""
    return scenario.path.parent / "reference" / f"{scenario.id}.csv"


def load_reference(path: Path, scenario: Scenario) -> Reference:
    """Read what is known; empty if there is no file.

    Raises
    ------
    ResultError
        When the file is damaged, or of another scenario.
    """
    if not path.exists():
        return {}
    known: Reference = {}
    try:
        rows = csv.DictReader(read_text(path, TABLE_BYTES).splitlines(), strict=True)
        if tuple(rows.fieldnames or ()) != _COLUMNS:
            raise ValueError(f"its columns are not {', '.join(_COLUMNS)}")
        for row in rows:
            if row["scenario_digest"] != scenario.digest[:DIGITS]:
                raise ResultError(
                    f"{path}: scenario_digest: it is of another version of {scenario.id} ({row['scenario_digest']}): delete it"
                )
            number = int(row["episode"])
            if number in known or not 0 <= number < scenario.splits.test.episodes:
                raise ValueError(f"episode {number} is there twice, or is no test episode")
            known[number] = Known(
                episode=number,
                upper_bound=_fraction(row["upper_bound"]),
                method=row["method"],
                seconds=float(row["seconds"]),
                best_known=_fraction(row["best_known"]),
                agent=row["agent"],
                proved_optimal=row["proved_optimal"] == "1",
            )
    except ResultError:
        raise
    except FileError as error:
        raise ResultError(str(error)) from None
    except (ValueError, TypeError, csv.Error) as error:
        raise ResultError(f"{path}: damaged: {one_line(error)}") from None
    return known


def save_reference(path: Path, scenario: Scenario, known: Reference) -> None:
    """Write what is known, completely or not at all."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for number in sorted(known):
        k = known[number]
        proved, digest = int(k.proved_optimal), scenario.digest[:DIGITS]
        writer.writerow(
            [number, _text(k.upper_bound), k.method, f"{k.seconds:g}", _text(k.best_known), k.agent, proved, digest]
        )
    write_atomic(path, text.getvalue().encode())


def bounded(known: Known, scenario: Scenario, upper_bound: float, method: str, seconds: float) -> Known:
    """Return what is known after a bound was computed anew; the lower of the old and the new bound is kept."""
    better = not known.upper_bound <= upper_bound  # so that NaN is worse than any
    changed = replace(known, upper_bound=upper_bound, method=method) if better else known
    return _proved(replace(changed, seconds=max(known.seconds, seconds)), scenario)


def improved(known: Reference, scenario: Scenario, results: Iterable[Result]) -> Reference:
    """Return what is known, with higher scores that results have reached; every result is replayed first.

    Raises
    ------
    ResultError
        When a result is not of this scenario's test episodes, or is not reproduced by its actions.
    """
    known = dict(known)
    for result in results:
        check_result(result, scenario)
        wrong = replay(result, str(scenario.path))
        if wrong:
            raise ResultError(f"{result.folder} is not reproduced: {wrong[0]}")
        table = result.episodes()
        for number, cral in zip(table["episode"].tolist(), table["cral"].tolist(), strict=True):
            old = known.get(number, Known(number))
            if not cral <= old.best_known + tolerance(scenario):  # so that any is better than NaN
                known[number] = _proved(replace(old, best_known=cral, agent=result.summary["agent"]), scenario)
    return known


def check_result(result: Result, scenario: Scenario) -> None:
    """Raise a ResultError if a result is not of the scenario's test episodes."""
    for field, value in {"scenario": scenario.id, "scenario_digest": scenario.digest, "split": SPLIT}.items():
        if result.summary[field] != value:
            raise ResultError(f"{result.folder}: {field}: {result.summary[field]}, expected {value}")


def gaps(result: Result, scenario: Scenario) -> Gaps | None:
    """Return how far a result on ``scenario`` is from what is known, or None if nothing is known about its episodes.

    Raises
    ------
    ResultError
        When the reference is damaged or of another scenario.
    """
    table = result.episodes()
    return gaps_of(scenario, table) if result.summary["split"] == SPLIT else None


def gaps_of(scenario: Scenario, table: Any) -> Gaps | None:
    """Return the same as `gaps` for a table of test episodes with the columns ``episode`` and ``cral``."""
    known = load_reference(reference_path(scenario), scenario)
    rows = [
        (number, known[number], cral)
        for number, cral in zip(table["episode"].tolist(), table["cral"].tolist(), strict=True)
        if number in known
    ]
    bound = np.array([k.upper_bound - cral for _, k, cral in rows])
    best = np.array([k.best_known - cral for _, k, cral in rows])
    cities = city_numbers(scenario, SPLIT, np.array([number for number, _, _ in rows], dtype=np.int64))
    if not rows or np.isnan([bound, best]).all():
        return None
    return Gaps(
        to_bound=mean_known(bound, cities),
        to_best=mean_known(best, cities),
        bounded=int((~np.isnan(bound)).sum()),
        compared=int((~np.isnan(best)).sum()),
        optimal=int((bound <= 0.0).sum()) if scenario.mission.exact else 0,
        better=int((best < -tolerance(scenario)).sum()),
    )


def mean_known(values: NDArray[np.float64], cities: NDArray[np.int64] | None) -> Interval | None:
    """Return the mean of the values that are not NaN, or None if there are none; ``cities`` are those of the episodes."""
    there = ~np.isnan(values)
    return mean_interval(values[there], clusters=None if cities is None else cities[there]) if there.any() else None


def _proved(known: Known, scenario: Scenario) -> Known:
    """Return what is known, with ``proved_optimal`` updated."""
    return replace(known, proved_optimal=scenario.mission.exact and known.best_known >= known.upper_bound)


def _fraction(text: str) -> float:
    """Read a fraction in [0, 1]; an empty text is NaN."""
    value = float(text) if text else math.nan
    if text and not 0.0 <= value <= 1.0:
        raise ValueError(f"{text} is not in [0, 1]")
    return value


def _text(value: float) -> str:
    """Write a fraction so that reading it gives the same bits; NaN is an empty text."""
    return "" if math.isnan(value) else repr(float(value))
