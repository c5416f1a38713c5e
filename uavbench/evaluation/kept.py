"""The file that keeps finished episodes: of an evaluation that is not finished yet, or of one of its shards."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from uavbench.errors import one_line
from uavbench.evaluation.evaluate import EpisodeRecord
from uavbench.evaluation.metrics import ROUNDING
from uavbench.evaluation.replay import fly_together
from uavbench.evaluation.results import ResultError
from uavbench.world.episode import Columns
from uavbench.world.files import ARRAYS_BYTES, FileError, pack_arrays, read_bounded, unpack_arrays, write_atomic
from uavbench.world.scenario import Scenario, SplitName

#: The name of the file in its folder.
FILE = "records.npz"
_KINDS: dict[Any, str] = {int: "i", float: "f", bool: "b"}  # NumPy's kinds of the types of a record's fields


@dataclass
class Kept:
    """Finished episodes.

    Attributes
    ----------
    identity : dict
        The facts that identify the evaluation, as `uavbench.evaluation.results.identity` gives them, and its shard.
    records : dict of int to EpisodeRecord
        The episodes, by their numbers.
    spent : float
        Seconds that they took.
    """

    identity: dict[str, Any]
    records: dict[int, EpisodeRecord] = field(default_factory=dict[int, EpisodeRecord])
    spent: float = 0.0


def write_kept(folder: Path, kept: Kept) -> None:
    """Write finished episodes, completely or not at all, to a folder, which is made if it is not there.

    Raises
    ------
    OSError
        When it cannot be written.
    """
    done = list(kept.records.values())
    names = [each.name for each in fields(EpisodeRecord) if each.name != "actions"]
    columns = {name: np.array([getattr(record, name) for record in done]) for name in names}
    columns["actions"] = np.concatenate([record.actions for record in done])
    columns["lengths"] = np.array([len(record.actions) for record in done])
    columns["identity"] = np.array(json.dumps(kept.identity))
    columns["spent"] = np.array(kept.spent)
    write_atomic(folder / FILE, pack_arrays(columns))


def read_kept(folder: Path) -> Kept | None:
    """Return the finished episodes in a folder; None if there are none.

    Raises
    ------
    ResultError
        When they are damaged.
    """
    path = folder / FILE
    if not path.exists():
        return None
    try:
        columns = unpack_arrays(read_bounded(path, ARRAYS_BYTES))
        return Kept(_read_identity(columns), _read_records(columns), _read_spent(columns))
    except FileError as error:
        raise ResultError(f"{error}; delete its folder to start over") from None
    except (ValueError, TypeError, KeyError, RecursionError, OverflowError) as error:
        raise ResultError(f"{path}: damaged ({one_line(error)}); delete its folder to start over") from None


def check_kept(folder: Path, kept: Kept, scenario: Scenario, split: SplitName) -> None:
    """Fly the recorded actions again: otherwise a damaged file would become a result that no replay reproduces.

    Raises
    ------
    ResultError
        When an episode has other numbers than its actions lead to.
    """
    records, episodes = kept.records.values(), kept.identity["episodes"]
    unknown = [record for record in records if record.episode >= episodes]
    flown = [record for record in records if record.episode < episodes]
    again = fly_together(scenario, split, [record.episode for record in flown], [record.actions for record in flown])
    wrong = [record for record, found in zip(flown, again, strict=True) if found is None or not _alike(record, found)]
    if broken := wrong + unknown:
        raise ResultError(
            f"{folder / FILE}: damaged (the numbers of episode {broken[0].episode} do not follow from its actions); "
            "delete its folder to start over"
        )


def different(found: Mapping[str, Any], sought: Mapping[str, Any]) -> list[str]:
    """Return the names of the facts that differ between two identities; those that only the first has do not count."""
    return [name for name, value in sought.items() if found.get(name) != value]


def _read_identity(columns: Columns) -> dict[str, Any]:
    """Return the identity of an evaluation: a dictionary with at least the entries that messages quote."""
    identity: Any = json.loads(str(columns["identity"]))
    if not isinstance(identity, dict) or not {"agent", "scenario", "split", "episodes"} <= identity.keys():
        raise ValueError("its identity does not name a run")
    return {str(name): value for name, value in identity.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]


def _read_spent(columns: Columns) -> float:
    """Return the seconds that the episodes took."""
    spent = float(columns["spent"].astype(np.float64, casting="same_kind"))
    if not 0.0 <= spent < math.inf:
        raise ValueError(f"spent is {spent}")
    return spent


def _read_records(columns: Columns) -> dict[int, EpisodeRecord]:
    """Return the records by their episodes' numbers; raise a ValueError if one occurs twice or has impossible values."""
    kinds = {field.name: _KINDS[field.type] for field in fields(EpisodeRecord) if field.name != "actions"}
    lengths, actions = columns["lengths"], columns["actions"]
    count = len(lengths)
    for name in ("lengths", *kinds):
        if columns[name].shape != (count,) or columns[name].dtype.kind != kinds.get(name, "i"):
            raise ValueError(f"{name}: {columns[name].dtype} of shape {columns[name].shape}")
    if actions.ndim != 2 or actions.dtype != np.uint8 or (lengths < 1).any() or int(lengths.sum()) != len(actions):
        raise ValueError("its lengths do not cut the actions into episodes")
    if count != len(np.unique(columns["episode"])) or (columns["episode"] < 0).any():
        raise ValueError("an episode is there twice, or its number is negative")
    for name in kinds:
        if not np.isfinite(columns[name]).all():
            raise ValueError(f"{name} is not finite")
    rows = zip(*(columns[name].tolist() for name in kinds), strict=True)
    parts = np.split(actions, np.cumsum(lengths)[:-1])
    records = [EpisodeRecord(**dict(zip(kinds, row, strict=True)), actions=part) for row, part in zip(rows, parts, strict=True)]
    return {record.episode: record for record in records}


def _alike(record: EpisodeRecord, again: EpisodeRecord) -> bool:
    """Return whether two records agree, apart from the decision times and from differences of at most `ROUNDING`."""
    names = [field.name for field in fields(EpisodeRecord) if field.name not in ("actions", "seconds")]
    return all(abs(float(getattr(record, name)) - float(getattr(again, name))) <= ROUNDING for name in names)
