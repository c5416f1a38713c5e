"""The best known flight of each test episode: ``best_known/<scenario>.csv`` and ``.npz`` beside ``submissions/``.

A flight that was better than all others when it was submitted stays here, with who submitted it and when, whatever becomes of
its submission. Scores are never read but computed from the actions; name, authors and date are what was recorded.
"""

import csv
import datetime
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from uavbench.evaluation.actions_file import pack_actions, read_actions
from uavbench.evaluation.evaluate import EpisodeRecord
from uavbench.evaluation.metrics import tolerance
from uavbench.evaluation.reference import DIGITS, SPLIT
from uavbench.evaluation.replay import fly_together
from uavbench.evaluation.spreadsheet import plain_cell
from uavbench.leaderboard.submission import Submission, SubmissionError
from uavbench.world.files import TABLE_BYTES, FileError, read_text
from uavbench.world.resources import scenario_paths
from uavbench.world.scenario import Scenario, load_scenario

#: The folder beside that of the submissions.
FOLDER = "best_known"
_COLUMNS = ("episode", "cral", "name", "authors", "date", "scenario_digest")


@dataclass(frozen=True)
class Best:
    """The best known flight of an episode.

    Attributes
    ----------
    record : EpisodeRecord
        What its actions lead to.
    name, authors : str
        Who submitted it.
    date : str
        When, as 2026-11-28.
    """

    record: EpisodeRecord
    name: str
    authors: str
    date: str


#: The best known flights of a scenario, by the numbers of their episodes.
BestKnown = dict[int, Best]


def load_best_known(folder: Path, scenario: Scenario) -> BestKnown:
    """Read the best known flights of a scenario, and fly them again; empty when there are none.

    Raises
    ------
    SubmissionError
        When a file is damaged or of another version of the scenario, or when an action or a score was changed.
    """
    table, actions = _paths(folder, scenario)
    if not table.exists() and not actions.exists():
        return {}
    try:
        rows = _read(table, scenario)
        flights = read_actions(actions, len(rows))
    except FileError as error:
        raise SubmissionError(str(error)) from None
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise SubmissionError(f"{table}: damaged ({error}): restore an earlier version of the file") from None
    if list(flights) != list(rows):
        raise SubmissionError(f"{actions}: does not hold the episodes of {table.name}: restore earlier versions of both")
    known: BestKnown = {}
    again = fly_together(scenario, SPLIT, list(flights), list(flights.values()))
    for (number, row), record in zip(rows.items(), again, strict=True):
        if record is None or not abs(record.cral - float(row["cral"])) <= tolerance(scenario):
            raise SubmissionError(f"{table}: damaged (episode {number}: its actions do not give its cral): restore both files")
        known[number] = Best(record, row["name"], row["authors"], row["date"])
    return known


def _read(table: Path, scenario: Scenario) -> dict[int, dict[str, str]]:
    """Return the rows of a table by their episodes; raise a ValueError if one is impossible."""
    reader = csv.DictReader(read_text(table, TABLE_BYTES).splitlines(), strict=True)
    if tuple(reader.fieldnames or ()) != _COLUMNS:
        raise ValueError(f"its columns are not {', '.join(_COLUMNS)}")
    rows: dict[int, dict[str, str]] = {}
    for row in reader:
        number = int(row["episode"])
        if None in row or None in row.values():
            raise ValueError(f"line {reader.line_num} has too few or too many cells")
        if row["scenario_digest"] != scenario.digest[:DIGITS]:
            raise ValueError(f"scenario_digest: it is of another version of {scenario.id}")
        if number in rows or not 0 <= number < scenario.splits.test.episodes:
            raise ValueError(f"episode {number} is there twice, or is no test episode")
        float(row["cral"])
        datetime.date.fromisoformat(row["date"])
        rows[number] = row
    return rows


def improved(known: Mapping[int, Best], submission: Submission, flown: Iterable[EpisodeRecord], date: str) -> BestKnown:
    """Return the best known flights after a submission, whose flights take the places of worse ones, but not of equal ones.

    Parameters
    ----------
    known : mapping
        The best known flights before.
    submission : Submission
    flown : iterable of EpisodeRecord
        What the replay of the submission gave.
    date : str
        When it was submitted.
    """
    manifest, scenario = submission.manifest, submission.scenario
    authors, found = ", ".join(manifest.authors), dict(known)
    for record in flown:
        before = known.get(record.episode)
        if before is None or record.cral > before.record.cral + tolerance(scenario):
            found[record.episode] = Best(record, manifest.name, authors, date)
    return dict(sorted(found.items()))


def changes(before: BestKnown, after: BestKnown) -> int:
    """Return how many of the best known flights are others than before."""
    return sum(before.get(number) is not best for number, best in after.items())


def best_known_files(folder: Path, scenario: Scenario, known: BestKnown) -> dict[Path, bytes]:
    """Return the contents of a scenario's files."""
    table, actions = _paths(folder, scenario)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for number, best in known.items():
        who = plain_cell(best.name), plain_cell(best.authors)
        writer.writerow([number, repr(best.record.cral), *who, best.date, scenario.digest[:DIGITS]])
    packed = pack_actions(list(known), [best.record.actions for best in known.values()])
    return {table: text.getvalue().encode(), actions: packed}


def today() -> str:
    """Return the date, in UTC."""
    return datetime.datetime.now(datetime.UTC).date().isoformat()


def load_all(folder: Path, scenarios: Iterable[Scenario]) -> dict[str, tuple[Scenario, BestKnown]]:
    """Read the best known flights of scenarios, and of all others that have files.

    Returns
    -------
    dict
        By the scenario's id: the scenario, and its best known flights.

    Raises
    ------
    SubmissionError
        As `load_best_known`; also when a file is of no scenario that comes with uavbench.
    """
    there = {scenario.id: scenario for scenario in scenarios}
    for path in sorted(folder.glob("[!.]*")):
        if path.stem not in scenario_paths():
            raise SubmissionError(f"{path}: no scenario that comes with uavbench is called {path.stem}: move it away")
        there.setdefault(path.stem, load_scenario(path.stem))
    return {name: (there[name], load_best_known(folder, there[name])) for name in sorted(there)}


def _paths(folder: Path, scenario: Scenario) -> tuple[Path, Path]:
    """Return the files of a scenario."""
    return folder / f"{scenario.id}.csv", folder / f"{scenario.id}.npz"
