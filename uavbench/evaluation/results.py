"""A result on disk: ``summary.json``, ``episodes.csv`` and ``actions.npz`` in ``OUT/<scenario>/<agent>``.

The files of a result are written all together, or not at all.
"""

import csv
import errno
import json
import os
import platform
import shutil
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from uavbench.errors import UavbenchError, one_line
from uavbench.evaluation.actions_file import ACTIONS, ACTIONS_BYTES, pack_actions, read_actions
from uavbench.evaluation.cities import Spread, spread_over_cities
from uavbench.evaluation.evaluate import EpisodeRecord, Job
from uavbench.evaluation.metrics import CONFIDENCE, METRICS, ROUNDING, Interval, summarise
from uavbench.world.cities import city_numbers
from uavbench.world.files import (
    TABLE_BYTES,
    FileError,
    NoFileError,
    check_plain,
    finish_moves,
    make_folder,
    moved_together,
    read_text,
    write_together,
)
from uavbench.world.resources import scenario_paths
from uavbench.world.scenario import Scenario, SplitName, load_scenario

if TYPE_CHECKING:
    import pandas as pd

#: Columns of ``episodes.csv`` and the fields of `EpisodeRecord` that they hold.
COLUMNS = {
    "episode": "episode",
    "uavs": "uavs",
    "budget": "budget",
    "steps": "steps",
    "landed": "landed",
    "cr": "cr",
    "cral": "cral",
    "blocked": "blocked",
    "return": "total_reward",
}
_SUMMARY_BYTES = 2**20


class ResultError(UavbenchError, ValueError):
    """A result cannot be used; the message names the file and the reason."""


@dataclass(frozen=True)
class Result:
    """A finished evaluation.

    Attributes
    ----------
    folder : Path
        The folder that holds it.
    summary : dict
        The content of ``summary.json``.
    given_scenario : Scenario, optional
        The scenario, where it is one in memory that no file holds.
    """

    folder: Path
    summary: dict[str, Any]
    given_scenario: Scenario | None = None

    @property
    def metrics(self) -> dict[str, Interval]:
        """Landed, CR and CRAL with their intervals."""
        return {name: Interval(**self.summary["metrics"][name]) for name in METRICS}

    @property
    def scenario(self) -> Scenario:
        """The result's scenario: a shipped one, or a user's own, from the path that it had then."""
        if self.given_scenario is not None:
            return self.given_scenario
        return load_scenario(self.summary.get("scenario_file") or self.summary["scenario"], run_code=False)

    def episodes(self) -> "pd.DataFrame":
        """Return ``episodes.csv`` as a table.

        Raises
        ------
        ResultError
            When the file is damaged.
        """
        import pandas as pd

        path = self.folder / "episodes.csv"
        kinds = [float if name in ("cr", "cral", "return") else int for name in COLUMNS]
        try:
            head, *rows = csv.reader(read_text(path, TABLE_BYTES).splitlines(), strict=True)
            if head != list(COLUMNS):
                raise ValueError(f"its columns are not {','.join(COLUMNS)}")
            # Python's float() reads exactly the number that was written; pandas' own parser may not.
            values = [[kind(_digits(cell)) for kind, cell in zip(kinds, row, strict=True)] for row in rows]
            return pd.DataFrame(values, columns=list(COLUMNS)).astype(dict(zip(COLUMNS, kinds, strict=True)))
        except FileError as error:
            raise ResultError(str(error)) from None
        except (ValueError, OverflowError, csv.Error) as error:
            raise ResultError(f"{path}: damaged: {one_line(error)}") from None

    def scores(self) -> "pd.DataFrame":
        """Return `episodes` after checking that the scores are possible and agree with the summary; nothing is replayed.

        Raises
        ------
        ResultError
            When they are not possible or do not agree, or the file is damaged.
        """
        path, table = self.folder / "episodes.csv", self.episodes()
        if not numbered(table["episode"], self.summary["episodes"]):
            raise ResultError(f"{path}: does not hold the {self.summary['episodes']} episodes, each once and in order")
        for name, said in self.metrics.items():
            strange = table.loc[~table[name].between(0, 1 + ROUNDING), ["episode", name]]
            if len(strange):
                number, value = strange.iloc[0]
                raise ResultError(f"{path}: episode {number:.0f}: {name} is {value:g}, which is not in [0, 1]")
            if not abs(table[name].mean() - said.mean) <= ROUNDING:
                where = self.folder / "summary.json"
                raise ResultError(f"{where}: metrics.{name}: mean is {said.mean:g}, in episodes.csv {table[name].mean():g}")
        return table

    def actions(self) -> dict[int, NDArray[np.uint8]]:
        """Return the actions of each episode, by its number, as in `EpisodeRecord`.

        Raises
        ------
        ResultError
            When the file is damaged.
        """
        try:
            return read_actions(self.folder / ACTIONS, self.summary["episodes"])
        except FileError as error:
            raise ResultError(str(error)) from None


def numbered(found: Collection[int], episodes: int) -> bool:
    """Return whether ``found`` is 0 to ``episodes`` − 1 in order; ``episodes`` comes from a file and may be any number."""
    return len(found) == episodes and all(number == k for k, number in enumerate(found))


def _digits(cell: str) -> str:
    """Refuse texts that Python reads as numbers but `publish` never writes: other scripts' digits, spaces, underscores."""
    if not cell.isascii() or set(cell) & {" ", "_"}:
        raise ValueError(f"{cell!r} is no number")
    return cell


def deliver(contents: Mapping[Path, bytes]) -> None:
    """Write files that are made from results: all of them, or none.

    Raises
    ------
    ResultError
        When one cannot be written.
    """
    try:
        write_together(contents)
    except OSError as error:
        path = error.filename if error.filename in map(str, contents) else next(iter(contents))
        raise ResultError(f"{path}: cannot write it: {error.strerror or error}") from None


def load_result(folder: str | Path) -> Result:
    """Load the result in ``folder``, which ``uavbench evaluate`` or `uavbench.evaluate` wrote.

    Raises
    ------
    ResultError
        When there is none, or its summary is damaged.

    Examples
    --------
    >>> import uavbench
    >>> result = uavbench.evaluate("random", "Block8-CPP-v0", episodes=3)
    >>> uavbench.load_result(result.folder).summary["episodes"]
    3
    """
    folder = Path(folder)
    path = folder / "summary.json"
    if not folder.exists():
        finish_moves(folder.parent)
    try:
        summary = json.loads(read_text(path, _SUMMARY_BYTES))
        for name, most in {"episodes.csv": TABLE_BYTES, ACTIONS: ACTIONS_BYTES}.items():
            check_plain(folder / name, most)
        return checked_result(folder, summary)
    except NoFileError as error:
        raise ResultError(f"{error}; give a folder that uavbench evaluate wrote") from None
    except FileError as error:
        raise ResultError(str(error)) from None
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ResultError(f"{path}: not a summary that uavbench evaluate wrote ({one_line(repr(error))})") from None


def checked_result(folder: Path, summary: dict[str, Any]) -> Result:
    """Return the result with a summary, after checking the entries that are used.

    Raises
    ------
    KeyError, TypeError, ValueError
        When an entry is missing, of a wrong type or impossible; the message names it.
    """
    result = Result(folder, summary)
    for interval in result.metrics.values():
        if not all(isinstance(value, float | int) for value in asdict(interval).values()):
            raise TypeError("metrics")
    if "cral_over_cities" in summary:
        spread = asdict(Spread(**summary["cral_over_cities"]))
        if not all(isinstance(value, float | int) for value in spread.values()):
            raise TypeError("cral_over_cities")
    kinds = {str: ("agent", "agent_sha256", "scenario", "scenario_digest", "split", "track"), int: ("episodes", "decisions")}
    for kind, names in {**kinds, float: ("decisions_per_second",)}.items():
        for name in names:
            if not isinstance(summary[name], kind):
                raise TypeError(name)
    for name in ("agent", "scenario"):  # they are used in names of files
        if not summary[name].isprintable() or set(summary[name]) & {"/", "\\"}:
            raise ValueError(f"{name}: {summary[name]!r} is no name")
    if summary["episodes"] < 1:
        raise ValueError("episodes: there are none")
    return result


def metrics_of(records: Sequence[EpisodeRecord], scenario: Scenario, split: SplitName) -> dict[str, Interval]:
    """Return Landed, CR and CRAL over records of episodes, with their intervals; episodes in one city count as dependent."""
    landed, cr, cral = (np.array([getattr(record, name) for record in records]) for name in METRICS)
    return summarise(landed, cr, cral, clusters=_cities(records, scenario, split))


def spread_of(records: Sequence[EpisodeRecord], scenario: Scenario, split: SplitName) -> Spread | None:
    """Return how CRAL differs between the cities of episodes; None if the scenario has one map."""
    cities = _cities(records, scenario, split)
    return None if cities is None else spread_over_cities(np.array([record.cral for record in records]), cities)


def _cities(records: Sequence[EpisodeRecord], scenario: Scenario, split: SplitName) -> NDArray[np.int64] | None:
    """Return the number of each record's city; None if the scenario has one map."""
    return city_numbers(scenario, split, np.array([record.episode for record in records], dtype=np.int64))


def table_of(records: Sequence[EpisodeRecord]) -> "pd.DataFrame":
    """Return the table of records that is written to ``episodes.csv``."""
    import pandas as pd

    table = pd.DataFrame({column: [getattr(r, field) for r in records] for column, field in COLUMNS.items()})
    return table.assign(landed=table["landed"].astype(int))


def identity(job: Job, episodes: int) -> dict[str, Any]:
    """Return the facts that identify an evaluation; they are part of its summary."""
    return {
        "uavbench": metadata.version("uavbench"),
        "scenario": job.scenario.id,
        "scenario_digest": job.scenario.digest,
        "agent": job.source.name,
        "agent_sha256": job.source.digest(job.scenario),
        **({"agent_file": str(job.source.file)} if job.source.file else {}),
        "track": job.source.track,
        **({"transfer": True} if job.source.transferred(job.scenario) else {}),
        "split": job.split,
        "episodes": episodes,
    }


def scenario_file(scenario: Scenario) -> dict[str, str]:
    """Return where the file of a user's own scenario is, as an entry of a summary; nothing for one that comes with uavbench."""
    shipped = scenario_paths().get(scenario.id) == scenario.path
    return {"scenario_file": str(scenario.path)} if scenario.path.suffix and not shipped else {}


def publish(
    folder: Path, facts: Mapping[str, Any], scenario: Scenario, records: Sequence[EpisodeRecord], seconds: float, workers: int
) -> Result:
    """Write a result's files to ``folder``, all at once; other files in the folder are kept.

    Parameters
    ----------
    folder : Path
    facts : mapping
        The `identity` of the evaluation.
    scenario : Scenario
    records : sequence of EpisodeRecord
        All its episodes, in the order of their numbers.
    seconds : float
        The time that they took.
    workers : int
        The processes that flew them.

    Raises
    ------
    OSError
        When they cannot be written; the folder is then unchanged.
    """
    decisions, spread = sum(record.steps for record in records), spread_of(records, scenario, facts["split"])
    summary: dict[str, Any] = {
        **facts,
        **scenario_file(scenario),
        "metrics": {name: asdict(each) for name, each in metrics_of(records, scenario, facts["split"]).items()},
        **({"cral_over_cities": asdict(spread)} if spread else {}),
        "confidence": CONFIDENCE,
        "decisions": decisions,
        "decisions_per_second": decisions / max(sum(record.seconds for record in records), 1e-9),
        "wall_time": seconds,
        "workers": workers,
        "versions": {
            "python": platform.python_version(),
            "numpy": metadata.version("numpy"),
            "numba": metadata.version("numba"),
            "platform": platform.platform(),
        },
    }
    actions = pack_actions([record.episode for record in records], [record.actions for record in records])
    make_folder(folder.parent)
    with moved_together(folder.parent) as staging:
        new = staging / folder.name
        if folder.is_dir():
            if not os.access(folder, os.W_OK):  # it could be moved away, but not deleted afterwards
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(folder))
            shutil.copytree(folder, new, symlinks=True)
        new.mkdir(exist_ok=True)
        (new / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
        table_of(records).to_csv(new / "episodes.csv", index=False, lineterminator="\n")
        (new / ACTIONS).write_bytes(actions)
    return Result(folder, summary)
