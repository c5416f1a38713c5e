"""An evaluation from beginning to end, that may be interrupted in between.

What is finished is kept in ``<agent>.partial`` beside the result's folder; `run` with ``resume`` goes on from there and ends
in the same result as a run that was not interrupted.
"""

import contextlib
import json
import shutil
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uavbench.agent import AgentSource
from uavbench.episode import check_split, split_size
from uavbench.evaluate import EpisodeRecord, Job, evaluate
from uavbench.files import check_writable, pack_arrays, unpack_arrays, write_whole
from uavbench.resources import scenario_paths
from uavbench.results import Result, ResultError, identity, load_result, publish
from uavbench.scenario import load_scenario

_CHECKPOINT_SECONDS = 10.0
_TRAIN_EPISODES = 1000  # of the train split, when no number is asked for


class Planned(NamedTuple):
    """An evaluation to come.

    Attributes
    ----------
    job : Job
    episodes : int
        How many.
    optional : bool
        Whether it is left out when the agent declines the scenario, because nobody named the scenario.
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
    """Plan evaluations, one for each scenario: ``"all"`` are all that are shipped, None is what the agent was trained on.

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
        scenario = load_scenario(name)
        try:
            checked = check_split(split)
        except ValueError as error:
            raise ResultError(f"--{error}") from None
        size = split_size(scenario, checked)
        count = episodes or min(size, _TRAIN_EPISODES)
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
        How many episodes of the job's split: 0 to ``episodes`` − 1.
    out : Path
        The folder of all results.
    workers : int
        Processes.
    resume : bool
        Go on from an interrupted run; there need not be one. A finished one is returned as it is.
    overwrite : bool
        Replace a finished result even by one of another split, of fewer episodes, or of another agent of the same name; and
        an interrupted run of others.
    on_start : callable
        Called once, when all is checked and the first episode is about to be flown.
    on_record : callable
        Called with every record, those of the interrupted run first.

    Raises
    ------
    ResultError
        When ``out`` cannot be written; when an interrupted run is there, and ``resume`` is not given or it is of something
        else; when a finished result of another split, of more episodes or of another agent of that name, or an interrupted run
        of others, is there and ``overwrite`` is not given; or when the agent's files have changed meanwhile: nothing of what it
        flew is kept then.
    AgentError, KeyboardInterrupt
        When the agent fails or the user interrupts; what was finished is kept.
    """
    folder = out.absolute() / job.scenario.id / job.source.name
    sought = identity(job, episodes)
    job = replace(job, agent_sha256=sought["agent_sha256"])
    with _saying_where(folder.parent):
        check_writable(folder.parent)
    partial = _Partial(folder.with_name(folder.name + ".partial"), sought)
    records, spent = partial.load(resume, overwrite)
    finished = _finished(folder)
    if finished and resume and not records and all(finished.summary.get(name) == value for name, value in sought.items()):
        return finished
    if finished and not overwrite and (finished.summary["split"] != job.split or finished.summary["episodes"] > episodes):
        raise ResultError(
            f"{folder} holds a result of {finished.summary['episodes']} {finished.summary['split']} episodes: "
            "give another --out, or --overwrite"
        )
    if finished and not overwrite and _is_of_another(finished.summary, sought):
        raise ResultError(
            f"{folder} holds a result of another agent that is called {job.source.name} ({_agent_file(finished.summary)}): "
            "give this one another name with --name NAME, give another --out, or --overwrite"
        )
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
            folder.parent.rmdir()  # if nothing is in it
        raise
    partial.remove()
    return result


class _ChangedError(ResultError):
    """The files of an agent changed while it flew: nobody knows which episodes were flown by which."""


def _check_unchanged(job: Job, episodes: int, sought: dict[str, Any]) -> None:
    """Refuse to go on with an agent whose files are not those that began."""
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
    """Say whether what is there is of another agent than the one sought, and not of the same file as it was before an edit."""
    return found.get("agent_sha256") != sought["agent_sha256"] and found.get("agent_file") != sought.get("agent_file")


def _agent_file(found: dict[str, Any]) -> str:
    """Return where an agent's file was, or its digest."""
    return str(found.get("agent_file") or f"SHA-256 {_short(found.get('agent_sha256'))}")


@contextlib.contextmanager
def _saying_where(folder: Path) -> Generator[None]:
    """Say that it is ``--out`` that cannot be written."""
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
    """Return a digest's beginning, or a value as it is."""
    text = str(value)
    return text[:12] + "…" if len(text) == 64 else text


class _Partial:
    """What an interrupted run has finished."""

    def __init__(self, folder: Path, identity: dict[str, Any]) -> None:
        self._path = folder / "records.npz"
        self._identity = identity

    def load(self, resume: bool, overwrite: bool) -> tuple[dict[int, EpisodeRecord], float]:
        """Return the finished records and the time they took."""
        if not self._path.is_file():
            return {}, 0.0
        try:
            columns = unpack_arrays(self._path.read_bytes())
            identity = json.loads(str(columns["identity"]))
            parts = np.split(columns["actions"], np.cumsum(columns["lengths"])[:-1])
        except (OSError, ValueError, KeyError) as error:
            raise ResultError(f"{self._path}: damaged ({error}); delete its folder to start over") from None
        differ = {name for name, value in self._identity.items() if identity.get(name) != value}
        where = f"{self._path.parent} holds an unfinished run of {identity['agent']} on {identity['scenario']}"
        if not resume and not overwrite and _is_of_another(identity, self._identity):
            raise ResultError(
                f"{where}, of another agent of that name ({_agent_file(identity)}): finish it first, give this one another "
                "name with --name NAME, give another --out, or --overwrite"
            )
        if not resume and (differ - {"split", "episodes"} or (differ and overwrite)):
            return {}, 0.0  # an agent or scenario edited since: a new run
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
        names = [field.name for field in fields(EpisodeRecord) if field.name != "actions"]
        rows = zip(*(columns[name].tolist() for name in names), strict=True)
        records = [
            EpisodeRecord(**dict(zip(names, row, strict=True)), actions=part) for row, part in zip(rows, parts, strict=True)
        ]
        return {record.episode: record for record in records}, float(columns["spent"])

    def save(self, records: dict[int, EpisodeRecord], spent: float) -> None:
        """Keep the finished records, whole or not at all."""
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
            write_whole(self._path, pack_arrays(columns))

    def remove(self) -> None:
        """Forget the unfinished run: it is finished."""
        shutil.rmtree(self._path.parent, ignore_errors=True)
