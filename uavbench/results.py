"""A result on disk: ``summary.json``, ``episodes.csv`` and ``actions.npz`` in ``OUT/<scenario>/<agent>``.

The files of a result are put in their place together, or not at all.
"""

import csv
import json
import platform
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from uavbench.evaluate import EpisodeRecord, Job
from uavbench.files import pack_arrays, unpack_arrays, write_whole
from uavbench.metrics import CONFIDENCE, METRICS, Interval, summarise
from uavbench.resources import scenario_paths
from uavbench.scenario import Scenario, load_scenario

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


_MOST_BYTES = 2**26  # of a result's actions; those of the paper's scenarios take 0.2 MB


class ResultError(ValueError):
    """A result that cannot be used; the message names the file and the reason."""


@dataclass(frozen=True)
class Result:
    """A finished evaluation.

    Attributes
    ----------
    folder : Path
        Where it is.
    summary : dict
        What ``summary.json`` holds.
    """

    folder: Path
    summary: dict[str, Any]

    @property
    def metrics(self) -> dict[str, Interval]:
        """Landed, CR and CRAL with their intervals."""
        return {name: Interval(**self.summary["metrics"][name]) for name in METRICS}

    @property
    def scenario(self) -> Scenario:
        """Its scenario: one that is shipped, or a user's own, where it was."""
        return load_scenario(self.summary.get("scenario_file") or self.summary["scenario"])

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
            head, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines(), strict=True)
            if head != list(COLUMNS):
                raise ValueError(f"its columns are not {','.join(COLUMNS)}")
            # Python's float() reads back to the last bit what was written; pandas' own parser need not.
            values = [[kind(cell) for kind, cell in zip(kinds, row, strict=True)] for row in rows]
            return pd.DataFrame(values, columns=list(COLUMNS)).astype(dict(zip(COLUMNS, kinds, strict=True)))
        except (OSError, ValueError, OverflowError, csv.Error) as error:
            raise ResultError(f"{path}: damaged: {error}") from None

    def actions(self) -> dict[int, NDArray[np.uint8]]:
        """Return the actions of each episode, by its number, as in `EpisodeRecord`.

        Raises
        ------
        ResultError
            When the file is damaged.
        """
        path = self.folder / "actions.npz"
        try:
            table = unpack_arrays(path.read_bytes(), _MOST_BYTES)
            episodes: int = self.summary["episodes"]
            if table["episodes"].shape != (episodes,) or table["offsets"].shape != (episodes + 1,):
                raise ValueError(f"does not hold the episodes 0 to {episodes - 1}")
            actions, offsets = (
                table["actions"].astype(np.uint8, casting="equiv"),
                table["offsets"].astype(np.int64, casting="same_kind"),
            )
            if offsets[0] != 0 or offsets[-1] != len(actions) or (np.diff(offsets) < 0).any():
                raise ValueError("its offsets do not cut the actions into episodes")
            parts = np.split(actions, offsets[1:-1])
            return dict(zip(table["episodes"].tolist(), parts, strict=True))
        except (OSError, KeyError, ValueError, TypeError, IndexError) as error:
            raise ResultError(f"{path}: damaged: {error}") from None


def deliver(path: Path, content: bytes) -> None:
    """Write a file that is made of results: as a whole, or it stays as it was.

    Raises
    ------
    ResultError
        When it cannot be written.
    """
    try:
        write_whole(path, content)
    except OSError as error:
        raise ResultError(f"{path}: cannot write it: {error.strerror or error}") from None


def load_result(folder: Path) -> Result:
    """Load the result in ``folder``.

    Raises
    ------
    ResultError
        When there is none, or its summary is damaged.
    """
    path = folder / "summary.json"
    try:
        result = checked_result(folder, json.loads(path.read_text(encoding="utf-8")))
        for name in ("episodes.csv", "actions.npz"):
            (folder / name).stat()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise ResultError(f"{error.filename}: missing; give a folder that uavbench evaluate wrote") from None
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ResultError(f"{path}: not a summary that uavbench evaluate wrote ({error!r})") from None
    return result


def checked_result(folder: Path, summary: dict[str, Any]) -> Result:
    """Return the result of a summary, after a look at what is read from it.

    Raises
    ------
    KeyError, TypeError
        When something is missing, or of another type: the message is its name.
    """
    result = Result(folder, summary)
    for interval in result.metrics.values():
        if not all(isinstance(value, float | int) for value in asdict(interval).values()):
            raise TypeError("metrics")
    kinds = {str: ("agent", "agent_sha256", "scenario", "scenario_digest", "split", "track"), int: ("episodes", "decisions")}
    for kind, names in {**kinds, float: ("decisions_per_second",)}.items():
        for name in names:
            if not isinstance(summary[name], kind):
                raise TypeError(name)
    return result


def metrics_of(records: Sequence[EpisodeRecord]) -> dict[str, Interval]:
    """Return Landed, CR and CRAL over records."""
    landed, cr, cral = (np.array([getattr(record, name) for record in records]) for name in METRICS)
    return summarise(landed, cr, cral)


def table_of(records: Sequence[EpisodeRecord]) -> "pd.DataFrame":
    """Return what ``episodes.csv`` holds of records."""
    import pandas as pd

    table = pd.DataFrame({column: [getattr(r, field) for r in records] for column, field in COLUMNS.items()})
    return table.assign(landed=table["landed"].astype(int))


def identity(job: Job, episodes: int) -> dict[str, Any]:
    """Return what makes two evaluations the same; it stands in the summary."""
    return {
        "uavbench": metadata.version("uavbench"),
        "scenario": job.scenario.id,
        "scenario_digest": job.scenario.digest,
        "agent": job.source.name,
        "agent_sha256": job.source.digest(job.scenario),
        "track": job.source.track,
        "split": job.split,
        "episodes": episodes,
    }


def publish(folder: Path, job: Job, records: Sequence[EpisodeRecord], wall_time: float, workers: int) -> Result:
    """Write a result's files beside ``folder`` and then put them in its place, all at once."""
    decisions = sum(record.steps for record in records)
    shipped = scenario_paths().get(job.scenario.id) == job.scenario.path
    summary: dict[str, Any] = {
        **identity(job, len(records)),
        **({} if shipped else {"scenario_file": str(job.scenario.path)}),
        "metrics": {name: asdict(interval) for name, interval in metrics_of(records).items()},
        "confidence": CONFIDENCE,
        "decisions": decisions,
        "decisions_per_second": decisions / max(sum(record.seconds for record in records), 1e-9),
        "wall_time": wall_time,
        "workers": workers,
        "versions": {
            "python": platform.python_version(),
            "numpy": metadata.version("numpy"),
            "numba": metadata.version("numba"),
            "platform": platform.platform(),
        },
    }
    actions = {
        "actions": np.concatenate([record.actions for record in records]),
        "offsets": np.cumsum([0, *(len(record.actions) for record in records)]),
        "episodes": np.array([record.episode for record in records]),
    }
    new, old = (folder.with_name(f".{folder.name}.{kind}") for kind in ("new", "old"))
    if not folder.exists() and old.exists():
        old.replace(folder)  # the last run was killed between the two moves below
    for leftover in (new, old):
        shutil.rmtree(leftover, ignore_errors=True)
    new.mkdir(parents=True)
    (new / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    table_of(records).to_csv(new / "episodes.csv", index=False, lineterminator="\n")
    (new / "actions.npz").write_bytes(pack_arrays(actions, compress=True))
    if folder.exists():
        folder.replace(old)
    new.replace(folder)
    shutil.rmtree(old, ignore_errors=True)
    return Result(folder, summary)
