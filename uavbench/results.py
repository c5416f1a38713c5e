"""A result on disk: ``summary.json``, ``episodes.csv`` and ``actions.npz`` in ``OUT/<scenario>/<agent>``.

Files are written whole or not at all. A run that was interrupted leaves what it finished in ``<agent>.partial`` beside;
`run` with ``resume`` goes on from there and ends in the same result.
"""

import json
import platform
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from uavbench.agent import AgentSource
from uavbench.episode import check_split, split_size
from uavbench.evaluate import EpisodeRecord, Job, evaluate
from uavbench.files import pack_arrays, unpack_arrays, write_whole
from uavbench.metrics import CONFIDENCE, METRICS, Comparison, Interval, compare, summarise
from uavbench.resources import scenario_paths
from uavbench.scenario import Scenario, load_scenario
from uavbench.simulator import Simulator

if TYPE_CHECKING:
    import pandas as pd

_CHECKPOINT_SECONDS = 10.0
_TRAIN_EPISODES = 1000  # of the train split, when no number is asked for
#: Columns of ``episodes.csv`` and the fields of `EpisodeRecord` that they hold.
COLUMNS = {
    "episode": "episode",
    "budget": "budget",
    "steps": "steps",
    "landed": "landed",
    "cr": "cr",
    "cral": "cral",
    "blocked": "blocked",
    "return": "total_reward",
}


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
    metrics : dict of Interval
        ``landed``, ``cr`` and ``cral``.
    """

    folder: Path
    summary: dict[str, Any]

    @property
    def metrics(self) -> dict[str, Interval]:
        """Landed, CR and CRAL with their intervals."""
        return {name: Interval(**self.summary["metrics"][name]) for name in METRICS}

    def episodes(self) -> "pd.DataFrame":
        """Return ``episodes.csv`` as a table."""
        import pandas as pd

        # Python's float() reads back to the last bit what was written; pandas' own parser need not.
        return pd.read_csv(self.folder / "episodes.csv", converters=dict.fromkeys(("cr", "cral", "return"), float))

    def actions(self) -> dict[int, NDArray[np.uint8]]:
        """Return the actions of each episode, by its number."""
        table = unpack_arrays((self.folder / "actions.npz").read_bytes())
        parts = np.split(table["actions"], table["offsets"][1:-1])
        return dict(zip(table["episodes"].tolist(), parts, strict=True))


def jobs(
    source: AgentSource, scenarios: Sequence[str], split: str, episodes: int | None, decision_timeout: float | None
) -> list[tuple[Job, range]]:
    """Plan evaluations: a job and its episodes for each scenario, ``"all"`` being all that are shipped.

    Raises
    ------
    ScenarioError, ResultError
        When a scenario, the split or the number of episodes does not exist.
    AgentLoadError
        When the agent cannot be loaded.
    """
    planned: list[tuple[Job, range]] = []
    names = [each for name in scenarios for each in (scenario_paths() if name == "all" else [name])]
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
        planned.append((Job(source, scenario, checked, decision_timeout), range(count)))
    return planned


def run(
    job: Job,
    numbers: Sequence[int],
    out: Path,
    *,
    workers: int = 1,
    resume: bool = False,
    on_record: Callable[[EpisodeRecord], None] = lambda record: None,
) -> Result:
    """Evaluate an agent and write the result to ``out``/<scenario>/<agent>.

    Parameters
    ----------
    job : Job
        What is flown.
    numbers : sequence of int
        Which episodes of the job's split.
    out : Path
        The folder of all results.
    workers : int
        Processes.
    resume : bool
        Go on from an interrupted run; there need not be one.
    on_record : callable
        Called with every record, those of the interrupted run first.

    Raises
    ------
    ResultError
        When an interrupted run is there and ``resume`` is not given, or it is of something else.
    AgentError, KeyboardInterrupt
        When the agent fails or the user interrupts; what was finished is kept.
    """
    folder = out / job.scenario.id / job.source.name
    partial = _Partial(folder.with_name(folder.name + ".partial"), _identity(job, numbers))
    records, spent = partial.load(resume)
    for record in records.values():
        on_record(record)
    missing = [number for number in numbers if number not in records]
    started = saved = time.perf_counter()
    try:
        for record in evaluate(job, missing, workers) if missing else ():
            records[record.episode] = record
            on_record(record)
            if time.perf_counter() - saved > _CHECKPOINT_SECONDS:
                partial.save(records, spent + time.perf_counter() - started)
                saved = time.perf_counter()
    except BaseException:
        partial.save(records, spent + time.perf_counter() - started)
        raise
    ordered = [records[number] for number in numbers]
    summary = _summary(job, numbers, ordered, spent + time.perf_counter() - started, workers)
    _publish(folder, summary, ordered)
    partial.remove()
    return Result(folder, summary)


def load_result(folder: Path) -> Result:
    """Load the result in ``folder``.

    Raises
    ------
    ResultError
        When there is none, or its files are damaged.
    """
    path = folder / "summary.json"
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        result = Result(folder, summary)
        _ = result.metrics, summary["scenario"], summary["scenario_digest"], summary["split"]
        for name in ("episodes.csv", "actions.npz"):
            (folder / name).stat()
    except FileNotFoundError as error:
        raise ResultError(f"{error.filename}: missing; give a folder that uavbench evaluate wrote") from None
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ResultError(f"{path}: not a summary that uavbench evaluate wrote ({error!r})") from None
    return result


def replay(result: Result) -> list[str]:
    """Simulate the actions of a result again and compare every number.

    Returns
    -------
    list of str
        What differs, a line each; empty when every number is reproduced.

    Raises
    ------
    ResultError
        When the scenario's digest is not the result's, or a file is damaged.
    """
    scenario = load_scenario(result.summary.get("scenario_file") or result.summary["scenario"])
    if scenario.digest != result.summary["scenario_digest"]:
        raise ResultError(
            f"{result.folder}: scenario_digest: the result is of another {scenario.id} "
            f"({result.summary['scenario_digest'][:12]}…, this one is {scenario.digest[:12]}…)"
        )
    try:
        table, actions = result.episodes(), result.actions()
        rows = table.to_dict("records")
        absent = [name for name in COLUMNS if name not in table.columns]
    except (OSError, KeyError, ValueError) as error:
        raise ResultError(f"{result.folder}: damaged: {error}") from None
    if absent:
        raise ResultError(f"{result.folder / 'episodes.csv'}: column {absent[0]} is missing")
    wrong: list[str] = []
    flown: list[EpisodeRecord] = []
    for row in rows:
        number = int(row["episode"])
        if number not in actions:
            wrong.append(f"episode {number}: its actions are missing from actions.npz")
            continue
        record = _fly_again(scenario, result.summary["split"], number, actions[number])
        flown.append(record)
        for column, field in COLUMNS.items():
            value = getattr(record, field)
            # CPP is exact on any machine; DH but for the last digits of a platform's logarithm.
            if abs(float(value) - float(row[column])) > (0.0 if scenario.mission.kind == "coverage" else 1e-6):
                wrong.append(f"episode {number}: {column} is {value}, episodes.csv says {row[column]}")
    if len(rows) != result.summary["episodes"] or len(actions) != len(rows):
        wrong.append(
            f"summary.json counts {result.summary['episodes']} episodes, episodes.csv {len(rows)}, actions.npz {len(actions)}"
        )
    if flown:
        for name, interval in _metrics(flown).items():
            for part, value in asdict(interval).items():
                said = getattr(result.metrics[name], part)
                if abs(value - said) > 1e-9:
                    wrong.append(f"summary.json: metrics.{name}.{part} is {value}, it says {said}")
    return wrong


def compare_results(first: Result, second: Result) -> dict[str, Comparison]:
    """Compare two results on the same episodes, metric by metric.

    Raises
    ------
    ResultError
        When they are not of the same scenario, split and episodes.
    """
    for field in ("scenario", "scenario_digest", "split"):
        if first.summary[field] != second.summary[field]:
            raise ResultError(
                f"cannot compare: {field} is {first.summary[field]} in {first.folder}, "
                f"{second.summary[field]} in {second.folder}"
            )
    a, b = first.episodes().set_index("episode"), second.episodes().set_index("episode")
    if set(a.index) != set(b.index):
        raise ResultError(f"cannot compare: {first.folder} has {len(a)} episodes, {second.folder} others or {len(b)}")
    return {name: compare(a[name].to_numpy(np.float64), b.loc[a.index, name].to_numpy(np.float64)) for name in METRICS}


def _fly_again(scenario: Scenario, split: Any, number: int, actions: NDArray[np.uint8]) -> EpisodeRecord:
    """Simulate one episode with recorded actions; it ends with them, or when they end it."""
    simulator = Simulator(scenario, 1)
    simulator.reset([0], split, [number])
    state = simulator.state
    total, steps = 0.0, 0
    for action in actions.tolist():
        if state.done[0]:
            break
        simulator.step(np.array([action]))
        total += float(state.reward[0])
        steps += 1
    outcome = {name: values[0].item() for name, values in simulator.outcomes([0]).items()}
    if not state.done[0] or steps < len(actions):
        steps = -1  # not an episode's actions: no recorded number of steps equals this
    return EpisodeRecord(
        episode=number,
        budget=int(state.initial_budget[0]),
        steps=steps,
        total_reward=total,
        actions=actions,
        seconds=0.0,
        **outcome,
    )


def _metrics(records: Sequence[EpisodeRecord]) -> dict[str, Interval]:
    return summarise(
        np.array([r.landed for r in records]), np.array([r.cr for r in records]), np.array([r.cral for r in records])
    )


def _identity(job: Job, numbers: Sequence[int]) -> dict[str, Any]:
    """Return what makes two runs the same run."""
    return {
        "uavbench": metadata.version("uavbench"),
        "scenario": job.scenario.id,
        "scenario_digest": job.scenario.digest,
        "agent": job.source.name,
        "agent_sha256": job.source.sha256,
        "track": job.source.track,
        "split": job.split,
        "episodes": len(numbers),
        "first_episode": min(numbers),
    }


def _summary(
    job: Job, numbers: Sequence[int], records: Sequence[EpisodeRecord], wall_time: float, workers: int
) -> dict[str, Any]:
    """Return what ``summary.json`` holds."""
    decisions = sum(record.steps for record in records)
    shipped = scenario_paths().get(job.scenario.id) == job.scenario.path
    return {
        **_identity(job, numbers),
        **({} if shipped else {"scenario_file": str(job.scenario.path)}),
        "metrics": {name: asdict(interval) for name, interval in _metrics(records).items()},
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


def _publish(folder: Path, summary: dict[str, Any], records: Sequence[EpisodeRecord]) -> None:
    """Write a result's files beside ``folder`` and then put them in its place, all at once."""
    import pandas as pd

    table = pd.DataFrame({column: [getattr(r, field) for r in records] for column, field in COLUMNS.items()})
    table["landed"] = table["landed"].astype(int)
    new, old = (folder.with_name(f".{folder.name}.{kind}") for kind in ("new", "old"))
    if not folder.exists() and old.exists():
        old.replace(folder)  # the last run was killed between the two moves below
    for leftover in (new, old):
        shutil.rmtree(leftover, ignore_errors=True)
    new.mkdir(parents=True)
    (new / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    table.to_csv(new / "episodes.csv", index=False, lineterminator="\n")
    (new / "actions.npz").write_bytes(_pack_actions(records))
    if folder.exists():
        folder.replace(old)
    new.replace(folder)
    shutil.rmtree(old, ignore_errors=True)


def _pack_actions(records: Sequence[EpisodeRecord]) -> bytes:
    """Return the bytes of ``actions.npz``: all actions in a row, and where each episode's begin."""
    arrays = {
        "actions": np.concatenate([record.actions for record in records]),
        "offsets": np.cumsum([0, *(record.steps for record in records)]),
        "episodes": np.array([record.episode for record in records]),
    }
    return pack_arrays(arrays, compress=True)


class _Partial:
    """What an interrupted run has finished."""

    def __init__(self, folder: Path, identity: dict[str, Any]) -> None:
        self._path = folder / "records.npz"
        self._identity = identity

    def load(self, resume: bool) -> tuple[dict[int, EpisodeRecord], float]:
        """Return the finished records and the time they took."""
        if not self._path.is_file():
            return {}, 0.0
        try:
            columns = unpack_arrays(self._path.read_bytes())
            identity = json.loads(str(columns["identity"]))
        except (OSError, ValueError, KeyError) as error:
            raise ResultError(f"{self._path}: damaged ({error}); delete its folder to start over") from None
        where = f"{self._path.parent} holds an unfinished run of {identity['agent']} on {identity['scenario']}"
        if not resume:
            raise ResultError(
                f"{where}, {len(columns['episode'])} of {identity['episodes']} episodes done: "
                "finish it with --resume, or delete the folder to start over"
            )
        for name, value in self._identity.items():
            if identity.get(name) != value:
                raise ResultError(
                    f"{where}, but its {name} is {identity.get(name)}, not {value}: delete the folder to start over"
                )
        parts = np.split(columns["actions"], np.cumsum(columns["steps"])[:-1])
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
        columns["identity"] = np.array(json.dumps(self._identity))
        columns["spent"] = np.array(spent)
        write_whole(self._path, pack_arrays(columns))

    def remove(self) -> None:
        """Forget the unfinished run: it is finished."""
        shutil.rmtree(self._path.parent, ignore_errors=True)
