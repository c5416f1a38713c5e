"""Flying episodes with an agent: agent × scenario × split → records.

The records do not depend on the batch size, the number of workers, or whether the agent decides one by one (``act``) or
for many episodes at once (``act_batch``): noise and episodes are keyed, and so is the seed that an agent is given. The UAVs
of a team decide at once, by what they see before the step, whether they are asked one by one or together (``act_team``).
"""

import contextlib
import signal
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import joblib  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numpy.typing import NDArray

from uavbench.agent import AgentSource
from uavbench.alarm import TimeUpError, alarm, set_alarm
from uavbench.city import HOVER, NUM_ACTIONS
from uavbench.errors import UavbenchError, one_line
from uavbench.keyed import AGENT, stream
from uavbench.memory import episodes_at_once
from uavbench.observation import Observation, Observer
from uavbench.scenario import Scenario, SplitName
from uavbench.simulator import Simulator
from uavbench.state_view import StateView

DEFAULT_BATCH = 250
#: In records, in place of an action: the UAV flies no more, or the episode has fewer.
NO_ACTION = NUM_ACTIONS


@dataclass(frozen=True)
class EpisodeRecord:
    """One finished episode.

    Attributes
    ----------
    episode : int
        Its number in the split.
    uavs : int
        How many UAVs flew.
    budget, steps : int
        Movement budget at the start, and actions taken, of all UAVs together.
    landed : bool
        Whether every UAV landed.
    cr, cral : float
        In [0, 1].
    blocked : int
        How often the safety controller kept a UAV in place.
    total_reward : float
        The sum of the rewards.
    actions : ndarray of uint8, shape (T, U)
        The actions of T steps, U the scenario's most UAVs; 6 where a UAV is not there or flies no more.
    seconds : float
        Time that the agent took to decide.
    """

    episode: int
    uavs: int
    budget: int
    steps: int
    landed: bool
    cr: float
    cral: float
    blocked: int
    total_reward: float
    actions: NDArray[np.uint8]
    seconds: float


class AgentError(UavbenchError):
    """An agent failed; the message says in which episode, at which step and why, with its traceback."""


@dataclass(frozen=True)
class Job:
    """What is flown: all that a worker must know.

    Attributes
    ----------
    source : AgentSource
    scenario : Scenario
    split : {"train", "validation", "test"}
    decision_timeout : float, optional
        Seconds that one call of the agent may take; None for any.
    batch_size : int
        Episodes at once, for an agent that decides for many.
    """

    source: AgentSource
    scenario: Scenario
    split: SplitName
    decision_timeout: float | None = 60.0
    batch_size: int = DEFAULT_BATCH


def evaluate(job: Job, numbers: Sequence[int], workers: int = 1) -> Generator[EpisodeRecord, None, None]:
    """Fly the episodes ``numbers``, yielding the record of each as it ends.

    Parameters
    ----------
    job : Job
        What is flown.
    numbers : sequence of int
        Which episodes.
    workers : int
        Processes.

    Raises
    ------
    AgentError
        When the agent fails. What was finished has been yielded before.
    """
    if workers == 1:
        yield from _fly(job, numbers)
        return
    size = min(job.batch_size, episodes_at_once(job.scenario)) if job.source.call(job.scenario) == "act_batch" else 10
    size = max(1, min(size, -(-len(numbers) // workers)))
    chunks = [numbers[k : k + size] for k in range(0, len(numbers), size)]
    parallel: Any = joblib.Parallel(n_jobs=workers, return_as="generator_unordered", pre_dispatch="2*n_jobs")
    fly: Any = cast("Any", joblib).delayed(_fly_chunk)
    failed: str | None = None
    with tempfile.TemporaryDirectory(prefix="uavbench-") as folder, _interrupt_sets(Path(folder) / "stop") as stop:
        try:
            # After a failure or Ctrl-C the workers stop at their next episode's end, and what they have is still taken.
            for records, error in parallel(fly(job, chunk, stop) for chunk in chunks):
                yield from records
                if error:
                    failed = failed or error
                    stop.touch()
        except BrokenProcessPool as error:  # what loky's TerminatedWorkerError is
            raise _complaint(job, None, f"a worker process died (out of memory, or a crash of the agent?)\n{error}") from None
        if failed:
            raise AgentError(failed)
        if stop.exists():
            raise KeyboardInterrupt


@contextlib.contextmanager
def _interrupt_sets(stop: Path) -> Generator[Path]:
    """Let the first Ctrl-C in the block make the file ``stop`` instead of raising; the second raises."""
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def interrupt(_signal: int, _frame: Any) -> None:
        if stop.exists():
            raise KeyboardInterrupt
        stop.touch()

    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)


def _fly_chunk(job: Job, numbers: Sequence[int], stop: Path) -> tuple[list[EpisodeRecord], str | None]:
    """Fly episodes in a worker until ``stop`` is there; return what was finished, and what failed."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the parent decides
    records: list[EpisodeRecord] = []
    try:
        for record in _fly(job, () if stop.exists() else numbers):
            records.append(record)
            if stop.exists():
                break
    except AgentError as error:
        return records, str(error)
    return records, None


def _fly(job: Job, numbers: Sequence[int]) -> Iterator[EpisodeRecord]:
    """Fly episodes in this process."""
    with alarm():
        agent = _guard(job, "__init__()", None, lambda: job.source.make(job.scenario))
        flight = _Flight(job, agent)
        size = min(job.batch_size, episodes_at_once(job.scenario)) if flight.call == "act_batch" else 1
        for k in range(0, len(numbers), size):
            yield from flight.fly(numbers[k : k + size])


class _Flight:
    """An agent, a simulator, and what passes between them. UAV u of slot i is number i · U + u of ``running``."""

    def __init__(self, job: Job, agent: Any) -> None:
        self._job = job
        self._agent = agent
        self._state_track = job.source.track == "state"
        self.call = job.source.call(job.scenario)

    def fly(self, numbers: Sequence[int]) -> Iterator[EpisodeRecord]:
        """Fly ``numbers`` side by side, yielding each as it ends."""
        job, count, most = self._job, len(numbers), self._job.scenario.most_uavs
        simulator = self._simulator(count)
        state = simulator.state
        simulator.reset(np.arange(count), job.split, numbers)
        fixed = [self._fixed_info(simulator, i, u, number) for i, number in enumerate(numbers) for u in range(most)]
        actions = np.full((count, int(state.budget.max()), most), NO_ACTION, dtype=np.uint8)
        seconds, rewards = np.zeros(count), np.zeros(count)
        running, step = np.flatnonzero(~state.done), 0
        infos = self._infos(simulator, running, fixed)
        if callable(getattr(self._agent, "reset", None)):
            for info in infos:
                if info["uav"] == 0:
                    _guard(job, "reset()", ([info], 0), lambda info=info: self._agent.reset(info))
        while len(running):
            observations = self._observe(simulator, running)
            slots, uavs = np.divmod(running, most)
            started = time.perf_counter()
            chosen = self._decide(observations, infos, step)
            seconds += np.bincount(slots, minlength=count) * ((time.perf_counter() - started) / len(running))
            all_actions = np.full((count, most), HOVER)
            all_actions[slots, uavs] = actions[slots, step, uavs] = chosen
            simulator.step(all_actions if job.scenario.team else all_actions[:, 0])
            for u in range(most):
                rewards += state.reward[:, u]
            step += 1
            over: list[int] = np.unique(slots[state.done[slots].all(axis=1)]).tolist()
            outcomes = _rows(simulator.outcomes(over)) if over else ()
            for i, outcome in zip(over, outcomes, strict=True):
                there = int(state.uavs[i])
                yield EpisodeRecord(
                    episode=int(numbers[i]),
                    uavs=there,
                    budget=int(state.initial_budget[i, :there].sum()),
                    steps=int((actions[i, :step] != NO_ACTION).sum()),
                    total_reward=float(rewards[i]),
                    actions=actions[i, :step].copy(),
                    seconds=float(seconds[i]),
                    **outcome,
                )
            running = running[~state.done.reshape(-1)[running]]
            infos = self._infos(simulator, running, fixed)

    def _simulator(self, count: int) -> Simulator:
        """Return a simulator for ``count`` episodes, the last one if it fits."""
        if getattr(self, "_last", None) is None or self._last.num_envs != count:
            self._last = Simulator(self._job.scenario, count)
            self._observer = Observer(self._job.scenario)
        return self._last

    def _fixed_info(self, simulator: Simulator, i: int, uav: int, number: int) -> dict[str, Any]:
        """Return what an agent is told of an episode and a UAV at every step."""
        seed = int(stream(simulator.state.key[i], AGENT)) >> 1
        info: dict[str, Any] = {"split": self._job.split, "episode": int(number), "seed": seed, "uav": uav}
        if self._state_track:
            info["state"] = StateView(simulator, i, uav)
        return info

    @staticmethod
    def _infos(simulator: Simulator, running: NDArray[np.int64], fixed: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return fresh information for the UAVs that fly."""
        masks = simulator.action_mask().reshape(-1, NUM_ACTIONS)[running]
        return [{**fixed[i], "action_mask": mask} for i, mask in zip(running.tolist(), masks, strict=True)]

    def _observe(self, simulator: Simulator, running: NDArray[np.int64]) -> Observation:
        """Return the observations of the UAVs that fly, batch first."""
        whole = simulator.num_envs * self._job.scenario.most_uavs
        batch = self._observer.empty(whole)
        self._observer.write(simulator.state, running, batch)
        if len(running) == whole:
            return batch
        return {name: values[running] for name, values in batch.items()}

    def _decide(self, observations: Observation, infos: list[dict[str, Any]], step: int) -> NDArray[np.int64]:
        """Ask the agent, and refuse what is not an action."""
        job, agent, call = self._job, self._agent, f"{self.call}()"
        if self.call == "act":
            return np.array([self._act(observations, infos, k, step) for k in range(len(infos))])
        if self.call == "act_batch":
            answer = _guard(job, call, (infos, step), lambda: agent.act_batch(observations, infos))
        else:
            rows = [{name: values[k] for name, values in observations.items()} for k in range(len(infos))]
            answer = _guard(job, call, (infos, step), lambda: agent.act_team(rows, infos))
        chosen = _array(job, answer, call, (infos, step))
        if chosen.shape != (len(infos),):
            raise _complaint(job, (infos, step), f"{call} returned shape {chosen.shape}, expected ({len(infos)},)")
        return np.array([_action(job, each, call, ([info], step)) for each, info in zip(chosen, infos, strict=True)])

    def _act(self, observations: Observation, infos: list[dict[str, Any]], k: int, step: int) -> int:
        """Ask the agent for one UAV."""
        observation, info = {name: values[k] for name, values in observations.items()}, infos[k]
        answer = _guard(self._job, "act()", ([info], step), lambda: self._agent.act(observation, info))
        return _action(self._job, answer, "act()", ([info], step))


_Where = tuple[list[dict[str, Any]], int] | None  # what the agent was told, and the step


def _rows(columns: dict[str, NDArray[Any]]) -> Iterator[dict[str, Any]]:
    """Turn columns into rows of plain Python values."""
    for values in zip(*(column.tolist() for column in columns.values()), strict=True):
        yield dict(zip(columns, values, strict=True))


def _action(job: Job, answer: Any, call: str, where: _Where) -> int:
    """Return an agent's answer as an action, or complain."""
    value = _array(job, answer, call, where)
    if value.shape != () or value.dtype.kind not in "iu":
        shape = f" of shape {value.shape}" if value.shape else ""
        raise _complaint(
            job, where, f"{call} returned {one_line(answer, repr)} ({value.dtype}{shape}), expected an integer from 0 to 5"
        )
    if not 0 <= value < NUM_ACTIONS:
        raise _complaint(job, where, f"{call} returned {one_line(answer, repr)}, expected an integer from 0 to 5")
    return int(value)


def _array(job: Job, answer: Any, call: str, where: _Where) -> NDArray[Any]:
    """Return an agent's answer as an array, or complain."""
    try:
        return np.asarray(answer)
    except Exception as error:
        raise _complaint(
            job, where, f"{call} returned {one_line(answer, repr)}, which is no array of integers: {one_line(error)}"
        ) from None


def _complaint(job: Job, where: _Where, reason: str) -> AgentError:
    """Say where an agent failed, and why."""
    place = f"{job.source.name} on {job.scenario.id}"
    if where is not None:
        infos, step = where
        episodes = {info["episode"] for info in infos}
        which = f"episode {min(episodes)}" if len(episodes) == 1 else f"episodes {min(episodes)} to {max(episodes)}"
        place += f", {job.split} {which}, step {step}"
        if job.scenario.team and len(infos) == 1:
            place += f", UAV {infos[0]['uav']}"
    return AgentError(f"{place}: {reason}")


def _guard(job: Job, call: str, where: _Where, function: Callable[[], Any]) -> Any:
    """Call an agent; turn what it raises, or its taking too long, into an `AgentError` with its traceback."""
    limit = None if call == "__init__()" else job.decision_timeout  # weights may take their time to load
    started = time.perf_counter()
    try:
        set_alarm(limit)
        try:
            answer = function()
        finally:
            set_alarm(None)
    except TimeUpError:
        raise _complaint(job, where, f"{call} took longer than {limit:g} s\n{_trace()}") from None
    except (Exception, SystemExit) as error:
        if call == "__init__()" and isinstance(error, Exception) and job.source.meant(error):
            raise _complaint(job, where, one_line(error)) from None
        raise _complaint(job, where, f"{call} raised {type(error).__name__}: {one_line(error)}\n{_trace()}") from error
    if limit is not None and time.perf_counter() - started > limit:
        raise _complaint(job, where, f"{call} took {time.perf_counter() - started:.1f} s, longer than {limit:g} s")
    return answer


def _trace() -> str:
    """Return the traceback being handled, without the frames of this file."""
    text = traceback.format_exc().splitlines()
    kept: list[str] = []
    skip = False
    for line in text:
        if line.startswith("  File "):
            skip = __file__ in line or set_alarm.__code__.co_filename in line
        elif not line.startswith("    "):
            skip = False
        if not skip:
            kept.append(line)
    return "\n".join(kept)
