"""An evaluation from beginning to end, which may be interrupted and resumed.

Finished episodes are kept in ``<agent>.partial`` beside the result's folder; `run` with ``resume`` continues from there and
gives the same result as a run that was not interrupted.
"""

import contextlib
import json
import math
import shutil
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uavbench.agents.agent import AgentSource
from uavbench.errors import one_line
from uavbench.evaluation.evaluate import EpisodeRecord, Job, evaluate
from uavbench.evaluation.metrics import ROUNDING
from uavbench.evaluation.replay import fly_recorded
from uavbench.evaluation.results import Result, ResultError, identity, load_result, publish
from uavbench.world.episode import Columns, check_split, split_size
from uavbench.world.files import (
    ARRAYS_BYTES,
    FileError,
    check_writable,
    pack_arrays,
    read_bounded,
    unpack_arrays,
    write_atomic,
)
from uavbench.world.resources import scenario_paths
from uavbench.world.scenario import load_scenario

_CHECKPOINT_SECONDS = 10.0
_KINDS: dict[Any, str] = {int: "i", float: "f", bool: "b"}  # NumPy's kinds of the types of a record's fields
#: How many episodes of the train split are flown by default.
TRAIN_EPISODES = 1000


class Planned(NamedTuple):
    """A planned evaluation.

    Attributes
    ----------
    job : Job
    episodes : int
        Number of episodes.
    optional : bool
        Whether it is left out if the agent refuses the scenario; true if the user named it only as part of ``"all"``.
    """

    job: Job
    episodes: int
    optional: bool


def jobs(
    source: AgentSource,
    scenarios: Sequence[str] | None,
    split: str,
    episodes: int | None,
    decision_timeout: float | None,
) -> list[Planned]:
    """Plan one evaluation for each scenario; ``"all"`` stands for all shipped ones, None for the one the agent was trained on.

    Raises
    ------
    ScenarioError, ResultError
        When a scenario, the split or the number of episodes does not exist.
    AgentLoadError
        When the agent cannot be loaded.
    """
    planned: list[Planned] = []
    names = [each for name in scenarios or [source.trained_on] for each in (scenario_paths() if name == "all" else [name])]
    source.load()
    for name in dict.fromkeys(names):
        # What weights name is a stranger's word, and a scenario may name code: only a user runs it.
        scenario = load_scenario(name, run_code=scenarios is not None)
        try:
            checked = check_split(split)
        except ValueError as error:
            raise ResultError(f"--{error}") from None
        size = split_size(scenario, checked)
        count = episodes or min(size, TRAIN_EPISODES)
        if count > size:
            raise ResultError(f"--episodes: {count}, but {scenario.id} has {size} {split} episodes")
        optional = scenarios is not None and name not in scenarios
        planned.append(Planned(Job(source, scenario, checked, decision_timeout), count, optional))
    return planned


def run(
    job: Job,
    episodes: int,
    out: Path,
    *,
    workers: int = 1,
    resume: bool = False,
    overwrite: bool = False,
    on_start: Callable[[], None] = lambda: None,
    on_record: Callable[[EpisodeRecord], None] = lambda record: None,
) -> Result:
    """Evaluate an agent and write the result to ``out``/<scenario>/<agent>.

    Parameters
    ----------
    job : Job
        What is flown.
    episodes : int
        Number of episodes of the job's split that are flown: 0 to ``episodes`` − 1.
    out : Path
        The folder of all results.
    workers : int
        Number of worker processes, as in `evaluate`.
    resume : bool
        Continue an interrupted run, if there is one. A finished result of the same evaluation is returned as it is.
    overwrite : bool
        Replace a finished result even if it is of another split, of more episodes, or of another agent with the same name;
        and an interrupted run of another split, number of episodes, or agent.
    on_start : callable
        Called once, after all checks and before the first episode is flown.
    on_record : callable
        Called with every record, first with those of the interrupted run.

    Raises
    ------
    ResultError
        When ``out`` cannot be written; when there is an interrupted run of the same evaluation and ``resume`` is not given, or
        with ``resume`` one of another evaluation; when ``overwrite`` is needed to replace what is there, but not given; when
        the saved episodes are damaged; or when the agent's files have changed meanwhile: then nothing that it flew is kept.
    AgentError, KeyboardInterrupt
        When the agent fails or the user interrupts the run; finished episodes are kept.
    """
    folder = out.absolute() / job.scenario.id / job.source.name
    sought = identity(job, episodes)
    job = replace(job, agent_sha256=sought["agent_sha256"])
    with _saying_where(folder.parent):
        check_writable(folder.parent)
    partial = _Partial(folder.with_name(folder.name + ".partial"), sought, job)
    records, spent = partial.load(resume, overwrite)
    finished = _finished(folder)
    if finished and resume and not records and all(finished.summary.get(name) == value for name, value in sought.items()):
        return finished
    if finished and not overwrite:
        _check_replaceable(finished, job, episodes, sought)
    on_start()
    for record in records.values():
        on_record(record)
    missing = [number for number in range(episodes) if number not in records]
    started = saved = time.perf_counter()
    try:
        for record in evaluate(job, missing, workers) if missing else ():
            records[record.episode] = record
            on_record(record)
            if time.perf_counter() - saved > _CHECKPOINT_SECONDS:
                _check_unchanged(job, episodes, sought)
                partial.save(records, spent + time.perf_counter() - started)
                saved = time.perf_counter()
        wall_time = spent + time.perf_counter() - started
        _check_unchanged(job, episodes, sought)
        with _saying_where(folder):
            result = publish(folder, job, [records[number] for number in range(episodes)], wall_time, workers)
    except BaseException as error:
        try:
            _check_unchanged(job, episodes, sought)
            partial.save(records, spent + time.perf_counter() - started)
        except _ChangedError as changed:
            partial.remove()
            if not isinstance(error, _ChangedError):
                raise changed from error
        except ResultError as full:
            if str(full) != str(error):
                error.add_note(str(full))
        else:
            if records:
                error.add_note(f"finished episodes are kept in {out}; --resume goes on, if the agent's files are as they were")
        with contextlib.suppress(OSError):
            folder.parent.rmdir()  # only if it is empty
        raise
    partial.remove()
    return result


def _check_replaceable(finished: Result, job: Job, episodes: int, sought: dict[str, Any]) -> None:
    """Raise a ResultError if a finished result would be replaced by one of something else or of fewer episodes."""
    if finished.summary["split"] != job.split or finished.summary["episodes"] > episodes:
        raise ResultError(
            f"{finished.folder} holds a result of {finished.summary['episodes']} {finished.summary['split']} episodes: "
            "give another --out, or --overwrite"
        )
    if _is_of_another(finished.summary, sought):
        raise ResultError(
            f"{finished.folder} holds a result of another agent that is called {job.source.name} "
            f"({_agent_file(finished.summary)}): "
            "give this one another name with --name NAME, give another --out, or --overwrite"
        )


class _ChangedError(ResultError):
    """The files of an agent changed while it flew, so that nobody knows which episodes were flown by which version."""


def _check_unchanged(job: Job, episodes: int, sought: dict[str, Any]) -> None:
    """Raise a _ChangedError if the agent's files are not the same as at the beginning."""
    try:
        if identity(job, episodes) == sought:
            return
    except OSError:  # a file is gone
        pass
    raise _ChangedError(
        f"{job.source.name}: its files or weights changed while it flew, so nothing that it flew is kept: copy them, and start "
        "over"
    )


def _is_of_another(found: dict[str, Any], sought: dict[str, Any]) -> bool:
    """Return whether two identities have different agents; a file and an edited version of it are not different agents."""
    return found.get("agent_sha256") != sought["agent_sha256"] and found.get("agent_file") != sought.get("agent_file")


def _agent_file(found: dict[str, Any]) -> str:
    """Return the path that an agent's file had, or its digest."""
    return str(found.get("agent_file") or f"SHA-256 {_short(found.get('agent_sha256'))}")


@contextlib.contextmanager
def _saying_where(folder: Path) -> Generator[None]:
    """Turn an OSError in the block into a ResultError that says that ``--out`` cannot be written."""
    try:
        yield
    except OSError as error:
        raise ResultError(f"--out: cannot write {error.filename or folder}: {error.strerror}") from None


def _finished(folder: Path) -> Result | None:
    """Return the result in ``folder``, if there is one."""
    try:
        return load_result(folder)
    except ResultError:
        return None


def _short(value: object) -> str:
    """Return the beginning of a digest, or any other value as text."""
    text = str(value)
    return text[:12] + "…" if len(text) == 64 else text


def _read_identity(columns: Columns) -> dict[str, Any]:
    """Return the identity of an interrupted run: a dictionary with at least the entries that messages quote."""
    identity: Any = json.loads(str(columns["identity"]))
    if not isinstance(identity, dict) or not {"agent", "scenario", "split", "episodes"} <= identity.keys():
        raise ValueError("its identity does not name a run")
    return {str(name): value for name, value in identity.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]


def _read_spent(columns: Columns) -> float:
    """Return the seconds that an interrupted run has taken so far."""
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


class _Partial:
    """The file that keeps the finished episodes of an interrupted run."""

    def __init__(self, folder: Path, identity: dict[str, Any], job: Job) -> None:
        self._job = job
        self._path = folder / "records.npz"
        self._identity = identity

    def load(self, resume: bool, overwrite: bool) -> tuple[dict[int, EpisodeRecord], float]:
        """Return the finished records and the seconds they took; nothing if there are none or a new run replaces them."""
        if not self._path.exists():
            return {}, 0.0
        try:
            columns = unpack_arrays(read_bounded(self._path, ARRAYS_BYTES))
            identity = _read_identity(columns)
            records, spent = _read_records(columns), _read_spent(columns)
        except FileError as error:
            raise ResultError(f"{error}; delete its folder to start over") from None
        except (ValueError, TypeError, KeyError, RecursionError, OverflowError) as error:
            raise ResultError(f"{self._path}: damaged ({one_line(error)}); delete its folder to start over") from None
        differ = {name for name, value in self._identity.items() if identity.get(name) != value}
        where = f"{self._path.parent} holds an unfinished run of {identity['agent']} on {identity['scenario']}"
        if not resume and not overwrite and _is_of_another(identity, self._identity):
            raise ResultError(
                f"{where}, of another agent of that name ({_agent_file(identity)}): finish it first, give this one another "
                "name with --name NAME, give another --out, or --overwrite"
            )
        if not resume and (differ - {"split", "episodes"} or (differ and overwrite)):
            return {}, 0.0  # the agent or scenario has been edited: a new run
        if not resume and differ:
            raise ResultError(
                f"{where}, {len(columns['episode'])} of {identity['episodes']} {identity['split']} episodes done: "
                "finish it first, give another --out, or --overwrite"
            )
        if not resume:
            raise ResultError(
                f"{where}, {len(columns['episode'])} of {identity['episodes']} episodes done: "
                "finish it with --resume, or delete the folder to start over"
            )
        for name in self._identity:
            if name in differ:
                raise ResultError(
                    f"{where}, but its {name} is {_short(identity.get(name))}, not {_short(self._identity[name])}: "
                    "run without --resume, with --overwrite, to start over"
                )
        for record in records.values():  # otherwise a damaged file would become a result that no replay reproduces
            known = record.episode < self._identity["episodes"]
            again = fly_recorded(self._job.scenario, self._job.split, record.episode, record.actions) if known else None
            if again is None or not _alike(record, again):
                raise ResultError(
                    f"{self._path}: damaged (the numbers of episode {record.episode} do not follow from its actions); "
                    "delete its folder to start over"
                )
        return records, spent

    def save(self, records: dict[int, EpisodeRecord], spent: float) -> None:
        """Save the finished records, completely or not at all."""
        if not records:
            return
        done = list(records.values())
        names = [field.name for field in fields(EpisodeRecord) if field.name != "actions"]
        columns = {name: np.array([getattr(record, name) for record in done]) for name in names}
        columns["actions"] = np.concatenate([record.actions for record in done])
        columns["lengths"] = np.array([len(record.actions) for record in done])
        columns["identity"] = np.array(json.dumps(self._identity))
        columns["spent"] = np.array(spent)
        with _saying_where(self._path):
            write_atomic(self._path, pack_arrays(columns))

    def remove(self) -> None:
        """Delete the saved records: they are no longer needed."""
        shutil.rmtree(self._path.parent, ignore_errors=True)
