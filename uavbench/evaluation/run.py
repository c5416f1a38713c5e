"""An evaluation from beginning to end, or one shard of it, which may be interrupted and resumed.

Finished episodes are kept in ``<agent>.partial`` beside the result's folder; `run` with ``resume`` continues from there and
gives the same result as a run that was not interrupted.
"""

import contextlib
import shutil
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from uavbench.agents.agent import AgentSource
from uavbench.evaluation.crew import Crew, crew_size, evaluate_with
from uavbench.evaluation.evaluate import EpisodeRecord, Job
from uavbench.evaluation.kept import Kept, check_kept, different, read_kept, write_kept
from uavbench.evaluation.results import Result, ResultError, identity, load_result, publish
from uavbench.evaluation.shards import Shard, write_shard
from uavbench.world.episode import check_split, split_size
from uavbench.world.files import check_writable
from uavbench.world.locks import BusyError, held
from uavbench.world.resources import scenario_paths
from uavbench.world.scenario import load_scenario

_Written = TypeVar("_Written")

_CHECKPOINT_SECONDS = 10.0
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
    workers: Crew = 1,
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
    workers : int or Cluster
        Number of worker processes, as in `evaluate`, or a cluster.
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
        When ``out`` cannot be written; when another process runs the same evaluation into it; when there is an interrupted run
        of the same evaluation and ``resume`` is not given, or with ``resume`` one of another evaluation; when ``overwrite`` is
        needed to replace what is there, but not given; when the saved episodes are damaged; or when the agent's files have
        changed meanwhile: then nothing that it flew is kept.
    AgentError, KeyboardInterrupt
        When the agent fails or the user interrupts the run; finished episodes are kept.
    """
    flying = _Flying(job, episodes, out)
    with flying.alone():
        kept, finished = flying.load(resume, overwrite), _finished(flying.folder)
        if finished and resume and not kept.records and not different(finished.summary, flying.sought):
            return finished
        if finished and not overwrite:
            _check_replaceable(finished, job, episodes, flying.sought)
        on_start()

        def write() -> Result:
            records = [kept.records[number] for number in range(episodes)]
            return publish(flying.folder, flying.sought, job.scenario, records, kept.spent, crew_size(workers))

        return flying.fly(kept, range(episodes), workers, on_record, write)


def run_shard(
    job: Job,
    shard: Shard,
    out: Path,
    *,
    workers: Crew = 1,
    resume: bool = False,
    overwrite: bool = False,
    on_start: Callable[[], None] = lambda: None,
    on_record: Callable[[EpisodeRecord], None] = lambda record: None,
) -> Path:
    """Fly one shard of an evaluation, and keep it in the folder ``out``/<scenario>/<agent>.shard-K-of-N, which is returned.

    `uavbench.evaluation.shards.merge` makes a result of all shards. The parameters and errors are those of `run`. A finished
    shard of the same evaluation is returned as it is with ``resume``, and replaced without.
    """
    flying = _Flying(job, shard.episodes, out, shard)
    with flying.alone():
        kept, finished = flying.load(resume, overwrite), read_kept(flying.folder)
        differ = different(finished.identity, flying.sought) if finished else []
        if finished and resume and not kept.records and not differ:
            return flying.folder
        if differ and not overwrite:
            raise ResultError(
                f"{flying.folder} holds a shard of another evaluation (its {differ[0]} is another one): give another --out, or "
                "--overwrite"
            )
        on_start()
        return flying.fly(kept, shard.numbers, workers, on_record, lambda: write_shard(flying.folder, job.scenario, kept))


class _Flying:
    """An evaluation into a folder of results, whose finished episodes are kept beside it until it is written.

    Parameters
    ----------
    job : Job
    episodes : int
        The number of episodes of the whole evaluation.
    out : Path
        The folder of all results.
    shard : Shard, optional
        The part of it that is flown, if it is not the whole.

    Attributes
    ----------
    sought : dict
        The facts that identify the evaluation.
    folder : Path
        The folder for it.
    """

    def __init__(self, job: Job, episodes: int, out: Path, shard: Shard | None = None) -> None:
        name = shard.folder_name(job.source.name) if shard else job.source.name
        self._out = out
        self.folder = out.absolute() / job.scenario.id / name  # before the agent may change the current folder
        self._partial = self.folder.with_name(name + ".partial")
        self.sought = {**identity(job, episodes), **({"shard": str(shard)} if shard else {})}
        self._job = replace(job, agent_sha256=self.sought["agent_sha256"])

    @contextlib.contextmanager
    def alone(self) -> Generator[None]:
        """Let no other process run the same evaluation into the same folder in the block."""
        with _saying_where(self.folder.parent):
            check_writable(self.folder.parent)
        try:
            with held(self._partial):
                yield
        except BusyError:
            raise ResultError(
                f"{self._partial} is in use: another process runs this evaluation now. Wait until it has ended, or give "
                "another --out"
            ) from None
        finally:
            with contextlib.suppress(OSError):
                self.folder.parent.rmdir()  # only if it is empty

    def load(self, resume: bool, overwrite: bool) -> Kept:
        """Return what an interrupted run has finished; nothing if there is none or a new run replaces it."""
        kept = read_kept(self._partial)
        if kept is None:
            return Kept(self.sought)
        found, differ = kept.identity, different(kept.identity, self.sought)
        where = f"{self._partial} holds an unfinished run of {found['agent']} on {found['scenario']}"
        if not resume and not overwrite and _is_of_another(found, self.sought):
            raise ResultError(
                f"{where}, of another agent of that name ({_agent_file(found)}): finish it first, give this one another "
                "name with --name NAME, give another --out, or --overwrite"
            )
        if not resume and (set(differ) - {"split", "episodes"} or (differ and overwrite)):
            return Kept(self.sought)  # the agent or scenario has been edited: a new run
        if not resume and differ:
            raise ResultError(
                f"{where}, {len(kept.records)} of {found['episodes']} {found['split']} episodes done: "
                "finish it first, give another --out, or --overwrite"
            )
        if not resume:
            raise ResultError(
                f"{where}, {len(kept.records)} of {found['episodes']} episodes done: "
                "finish it with --resume, or delete the folder to start over"
            )
        if differ:
            name = differ[0]
            raise ResultError(
                f"{where}, but its {name} is {_short(found.get(name))}, not {_short(self.sought[name])}: "
                "run without --resume, with --overwrite, to start over"
            )
        check_kept(self._partial, kept, self._job.scenario, self._job.split)
        return kept

    def fly(
        self,
        kept: Kept,
        numbers: Sequence[int],
        workers: Crew,
        on_record: Callable[[EpisodeRecord], None],
        write: Callable[[], _Written],
    ) -> _Written:
        """Fly the episodes that are missing, and return what ``write`` makes of all; if something fails, keep what is done."""
        records = kept.records
        for record in records.values():
            on_record(record)
        missing = [number for number in numbers if number not in records]
        started = saved = time.perf_counter()
        before = kept.spent
        try:
            for record in evaluate_with(workers, self._job, missing) if missing else ():
                records[record.episode] = record
                on_record(record)
                kept.spent = before + time.perf_counter() - started
                if time.perf_counter() - saved > _CHECKPOINT_SECONDS:
                    self._save(kept)
                    saved = time.perf_counter()
            self._check_unchanged()
            with _saying_where(self.folder):
                written = write()
        except BaseException as error:
            self._save_after(error, kept)
            raise
        shutil.rmtree(self._partial, ignore_errors=True)
        return written

    def _save(self, kept: Kept) -> None:
        """Keep what has been finished so far."""
        self._check_unchanged()
        if kept.records:
            with _saying_where(self._partial):
                write_kept(self._partial, kept)

    def _save_after(self, error: BaseException, kept: Kept) -> None:
        """Keep what was finished before an error, and note in the error that it is kept."""
        try:
            self._save(kept)
        except _ChangedError as changed:
            shutil.rmtree(self._partial, ignore_errors=True)
            if not isinstance(error, _ChangedError):
                raise changed from error
        except ResultError as full:
            if str(full) != str(error):
                error.add_note(str(full))
        else:
            if kept.records:
                error.add_note(
                    f"finished episodes are kept in {self._out}; --resume goes on, if the agent's files are as they were"
                )

    def _check_unchanged(self) -> None:
        """Raise a _ChangedError if the agent's files are not the same as at the beginning."""
        name = self._job.source.name
        with contextlib.suppress(OSError):  # a file is gone
            if self._job.source.digest(self._job.scenario) == self.sought["agent_sha256"]:
                return
        raise _ChangedError(
            f"{name}: its files or weights changed while it flew, so nothing that it flew is kept: copy them, and start over"
        )


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
