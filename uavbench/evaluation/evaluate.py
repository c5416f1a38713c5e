"""Flying episodes with an agent on a scenario and a split, and recording them.

The records do not depend on the batch size, the number of workers, or whether the agent decides for one UAV at a time (``act``)
or for many episodes at once (``act_batch``): noise and episodes are keyed, and so is the seed that an agent is given. All UAVs
of a team decide by what they see before the step, whether the agent is called for one after the other or once (``act_team``).
"""

import itertools
import traceback
from collections.abc import Callable, Generator, Iterator, Mapping, MutableSequence, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.agents.agent import AgentSource
from uavbench.agents.apart import ApartError
from uavbench.errors import UavbenchError, one_line
from uavbench.evaluation.decision_clock import DecisionClock, shown_call
from uavbench.evaluation.processes import WorkerDiedError, WorkerLateError, work_apart
from uavbench.simulation.memory import episodes_at_once
from uavbench.simulation.observation import Observation, Observer
from uavbench.simulation.simulator import Simulator
from uavbench.simulation.state_view import StateView
from uavbench.world.city import HOVER, NUM_ACTIONS
from uavbench.world.episode import episode_keys, fresh_keys
from uavbench.world.keyed import AGENT, stream
from uavbench.world.scenario import Scenario, SplitName

DEFAULT_BATCH = 250
_PIECE = 10  # episodes that a worker is given at once if its agent flies them one by one
#: Stands for an action in records where a UAV no longer flies, or where the episode does not have that UAV.
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
        Movement budget at the start, and number of actions taken, summed over all UAVs.
    landed : bool
        Whether every UAV landed.
    cr, cral : float
        In [0, 1].
    blocked : int
        How often the safety controller kept a UAV in place.
    total_reward : float
        The sum of the rewards.
    actions : ndarray of uint8, shape (T, U)
        The actions of T steps; U is the scenario's largest number of UAVs; 6 where a UAV does not exist or no longer flies.
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


class AgentDeclinedError(AgentError):
    """An agent refuses a scenario in its ``__init__``.

    Attributes
    ----------
    reason : str
        The message of the agent.
    """

    reason = ""


@dataclass(frozen=True)
class Job:
    """What is flown: everything that a worker must know.

    Attributes
    ----------
    source : AgentSource
    scenario : Scenario
    split : {"train", "validation", "test"}
    decision_timeout : float, optional
        Seconds that one call of the agent may take; None for no limit.
    batch_size : int
        Episodes that are flown at once, if the agent has ``act_batch``.
    agent_sha256 : str, optional
        The digest that the agent's files must have when they are loaded; None for any.
    fresh : int, optional
        A key from which unpublished episodes are drawn, to be flown instead of those of the split. The agent is given the
        numbers and seeds of the split's episodes, which reveal nothing about these.
    options : mapping, optional
        What is set by hand in each episode, as in `uavbench.simulation.simulator.Simulator.customise`.
    settings : mapping, optional
        Attributes of the agent, and the values that they are given once it is made.
    """

    source: AgentSource
    scenario: Scenario
    split: SplitName
    decision_timeout: float | None = 60.0
    batch_size: int = DEFAULT_BATCH
    agent_sha256: str | None = None
    fresh: int | None = None
    options: Mapping[str, Any] | None = None
    settings: Mapping[str, Any] | None = None


def evaluate(job: Job, numbers: Sequence[int], workers: int = 0) -> Generator[EpisodeRecord]:
    """Fly the episodes ``numbers``, yielding the record of each as it ends.

    Parameters
    ----------
    job : Job
        What is flown.
    numbers : sequence of int
        Which episodes.
    workers : int
        Number of worker processes, in which the agent cannot harm this process and is killed when it takes too long. With 0 it
        flies in this process, where a call that takes too long is noticed only when it returns.

    Raises
    ------
    AgentDeclinedError
        When the agent refuses this scenario.
    AgentError
        When the agent fails. The episodes that were finished have been yielded before.
    """
    if workers == 0:
        yield from _Flyer(job)(numbers)
        return
    size = min(job.batch_size, episodes_at_once(job.scenario)) if job.source.call(job.scenario) == "act_batch" else _PIECE
    size = max(1, min(size, -(-len(numbers) // workers)))
    try:
        yield from work_apart(_Flyer(job), (numbers[k : k + size] for k in range(0, len(numbers), size)), workers)
    except WorkerLateError as late:
        call = shown_call(late.shown)
        infos = [{"episode": number, "uav": call.uav} for number in (call.first_episode, call.last_episode)]
        infos = infos[:1] if call.method in ("act()", "reset()") else infos
        reason = f"{call.method} took longer than {job.decision_timeout:g} s\n{_agents_frames(late.trace)}".rstrip()
        raise _complaint(job, (infos, call.step), reason) from None
    except WorkerDiedError as died:
        raise _complaint(job, None, str(died)) from None


@dataclass
class _Flyer:
    """Flies episodes with one agent, which is made at the first call: until then this can be pickled for another process."""

    job: Job
    _flight: "_Flight | None" = field(default=None, init=False)

    def __call__(self, numbers: Sequence[int], shown: MutableSequence[float] | None = None) -> Iterator[EpisodeRecord]:
        """Fly the episodes ``numbers``; the agent's clock is shown in ``shown``."""
        job = self.job
        with DecisionClock(job.decision_timeout, shown) as clock:
            if self._flight is None:
                self._flight = _Flight(job, _made(job, clock))
            size = min(job.batch_size, episodes_at_once(job.scenario)) if self._flight.call == "act_batch" else 1
            for k in range(0, len(numbers), size):
                yield from self._flight.fly(numbers[k : k + size], clock)


def _made(job: Job, clock: DecisionClock) -> Any:
    """Return a new agent for a job; raise an AgentError if this fails or its files are not those of the job."""
    clock.start("__init__()", (), 0, limited=False)  # loading weights may take long
    try:
        agent = job.source.make(job.scenario)
    except ApartError as error:
        raise _complaint(job, None, f"__init__() {error}") from None
    except (Exception, SystemExit) as error:
        if isinstance(error, Exception) and job.source.meant(error):
            reason = one_line(error)
            declined = AgentDeclinedError(f"{job.source.name} on {job.scenario.id}: {reason}")
            declined.reason = reason
            raise declined from None
        raise _complaint(job, None, f"__init__() raised {_said(error)}\n{_trace()}") from error
    finally:
        clock.stop()
    if job.agent_sha256 is not None and job.source.digest(job.scenario) != job.agent_sha256:
        raise _complaint(job, None, "its files changed while it was loaded: start again")
    for name, value in (job.settings or {}).items():
        if not hasattr(agent, name):
            raise _complaint(job, None, f"it has no setting {name}")
        setattr(agent, name, value)
    return agent


class _Flight:
    """An agent, a simulator, and what passes between them. In ``running``, UAV u of slot i has the number i · U + u."""

    def __init__(self, job: Job, agent: Any) -> None:
        self._job = job
        self._agent = agent
        self._state_track = job.source.track == "state"
        self._shows_safe = job.source.safe_mask
        self.call = job.source.call(job.scenario)

    def fly(self, numbers: Sequence[int], clock: DecisionClock) -> Iterator[EpisodeRecord]:
        """Fly ``numbers`` side by side, yielding each as it ends; ``clock`` measures the agent's calls."""
        job, count, most = self._job, len(numbers), self._job.scenario.max_uavs
        simulator = self._simulator(count)
        state = simulator.state
        if job.fresh is None:
            simulator.reset(np.arange(count), job.split, numbers)
        else:
            simulator.sample(np.arange(count), fresh_keys(job.fresh, numbers))
        for i in range(count if job.options else 0):
            simulator.customise(i, job.options or {})
        fixed = [self._fixed_info(simulator, i, u, number) for i, number in enumerate(numbers) for u in range(most)]
        actions = np.full((count, int(state.budget.max()), most), NO_ACTION, dtype=np.uint8)
        seconds, rewards = np.zeros(count), np.zeros(count)
        running, step = np.flatnonzero(~state.done), 0
        infos = self._infos(simulator, running, fixed)
        if callable(getattr(self._agent, "reset", None)):
            for info in infos:
                if info["uav"] == 0:
                    self._ask(clock, "reset()", [info], 0, lambda info=info: self._agent.reset(info))
        while len(running):
            observations = self._observe(simulator, running)
            slots, uavs = np.divmod(running, most)
            chosen, spent = self._decide(clock, observations, infos, step)
            seconds += np.bincount(slots, minlength=count) * (spent / len(running))
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
        """Return a simulator for ``count`` episodes; the last one is used again if it has this size."""
        if getattr(self, "_last", None) is None or self._last.num_envs != count:
            self._last = Simulator(self._job.scenario, count)
            self._observer = Observer(self._job.scenario)
        return self._last

    def _fixed_info(self, simulator: Simulator, i: int, uav: int, number: int) -> dict[str, Any]:
        """Return the part of ``info`` that is the same at every step of a UAV."""
        fresh = self._job.fresh is not None
        key = episode_keys(self._job.split, np.array([number]))[0] if fresh else simulator.state.key[i]
        seed = int(stream(key, AGENT)) >> 1
        info: dict[str, Any] = {"split": self._job.split, "episode": int(number), "seed": seed, "uav": uav}
        if self._state_track:
            info["state"] = StateView(simulator, i, uav)
        return info

    def _infos(self, simulator: Simulator, running: NDArray[np.int64], fixed: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return a new ``info`` for each UAV that flies."""
        masks = {"action_mask": simulator.action_mask()}
        if self._shows_safe:
            masks["safe_action_mask"] = simulator.safe_action_mask()
        rows = {name: mask.reshape(-1, NUM_ACTIONS)[running] for name, mask in masks.items()}
        return [{**fixed[i], **{name: mask[k] for name, mask in rows.items()}} for k, i in enumerate(running.tolist())]

    def _observe(self, simulator: Simulator, running: NDArray[np.int64]) -> Observation:
        """Return the observations of the UAVs that fly, batch first."""
        whole = simulator.num_envs * self._job.scenario.max_uavs
        batch = self._observer.empty(whole)
        self._observer.write(simulator.state, running, batch)
        if len(running) == whole:
            return batch
        return {name: values[running] for name, values in batch.items()}

    def _decide(
        self, clock: DecisionClock, observations: Observation, infos: list[dict[str, Any]], step: int
    ) -> tuple[NDArray[np.int64], float]:
        """Return the agent's actions, and the seconds that it took; raise an AgentError if they are no actions."""
        agent, call = self._agent, f"{self.call}()"
        if self.call == "act_batch":
            return self._ask(clock, call, infos, step, lambda: agent.act_batch(observations, infos), (len(infos),))
        rows = [{name: values[k] for name, values in observations.items()} for k in range(len(infos))]
        if self.call == "act":
            chosen, spent = np.empty(len(infos), dtype=np.int64), 0.0
            for k, (observation, info) in enumerate(zip(rows, infos, strict=True)):
                chosen[k], seconds = self._ask(clock, call, [info], step, lambda o=observation, i=info: agent.act(o, i), ())
                spent += seconds
            return chosen, spent
        return self._ask(clock, call, infos, step, lambda: agent.act_team(rows, infos), (len(infos),))

    def _ask(
        self,
        clock: DecisionClock,
        call: str,
        infos: list[dict[str, Any]],
        step: int,
        function: Callable[[], Any],
        shape: tuple[int, ...] | None = None,
    ) -> tuple[Any, float]:
        """Call the agent; return its actions, which must be of ``shape``, and the seconds that it took.

        Whatever goes wrong becomes an `AgentError`: an exception, an answer that is no action, or a call that takes too long.
        Everything that may run the agent's code, reading its answer included, is done while the clock runs.
        """
        job, where, answer, answered = self._job, (infos, step), None, False
        clock.start(call, infos, step)
        try:
            answer, answered = function(), True
            actions = None if shape is None else _actions(job, answer, call, where, shape)
        except AgentError:
            raise
        except ApartError as error:
            raise _complaint(job, where, f"{call} {error}") from None
        except (Exception, SystemExit) as error:
            if answered:
                reason = f"{call} returned {one_line(answer, repr)}, which is no array of integers: {_said(error)}"
                raise _complaint(job, where, reason) from None
            raise _complaint(job, where, f"{call} raised {_said(error)}\n{_trace()}") from error
        finally:
            seconds = clock.stop()
        if job.decision_timeout is not None and seconds > job.decision_timeout:
            raise _complaint(job, where, f"{call} took {seconds:.1f} s, longer than {job.decision_timeout:g} s")
        return actions, seconds


_Where = tuple[list[dict[str, Any]], int] | None  # the infos that the agent was given, and the step


def _rows(columns: dict[str, NDArray[Any]]) -> Iterator[dict[str, Any]]:
    """Turn columns into rows of plain Python values."""
    for values in zip(*(column.tolist() for column in columns.values()), strict=True):
        yield dict(zip(columns, values, strict=True))


def _actions(job: Job, answer: Any, call: str, where: _Where, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return an agent's answer as actions of a shape; raise an AgentError if it is something else."""
    actions = np.asarray(answer)
    if shape and actions.shape != shape:
        raise _complaint(job, where, f"{call} returned shape {actions.shape}, expected {shape}")
    if actions.shape != shape or actions.dtype.kind not in "iu":
        found = f"{actions.dtype} of shape {actions.shape}" if actions.shape else str(actions.dtype)
        raise _complaint(job, where, f"{call} returned {one_line(answer, repr)} ({found}), expected an integer from 0 to 5")
    wrong = (actions < 0) | (actions >= NUM_ACTIONS)
    if wrong.any():
        assert where is not None
        k = int(wrong.argmax())
        value = actions[k] if shape else answer
        info = where[0][k]
        raise _complaint(job, ([info], where[1]), f"{call} returned {one_line(value, repr)}, expected an integer from 0 to 5")
    return actions.astype(np.int64)


def _said(error: BaseException) -> str:
    """Return the class and the message of an exception."""
    return f"{type(error).__name__}: {one_line(error)}"


def _complaint(job: Job, where: _Where, reason: str) -> AgentError:
    """Return the error that says where an agent failed, and why."""
    place = f"{job.source.name} on {job.scenario.id}"
    if where is not None:
        infos, step = where
        episodes = {info["episode"] for info in infos}
        which = f"episode {min(episodes)}" if len(episodes) == 1 else f"episodes {min(episodes)} to {max(episodes)}"
        place += f", {job.split} {which}, step {step}"
        if job.scenario.team and len(infos) == 1:
            place += f", UAV {infos[0]['uav']}"
    return AgentError(f"{place}: {reason}")


def _agents_frames(trace: str) -> str:
    """Return the agent's frames from a trace by `faulthandler`, in the order of Python's tracebacks."""
    frames = list(itertools.takewhile(lambda line: __file__ not in line, trace.splitlines()[1:]))
    return "\n".join(["Traceback (most recent call last):", *reversed(frames)]) if frames else ""


def _trace() -> str:
    """Return the traceback of the exception that is being handled, without the frames of this file."""
    text = traceback.format_exc().splitlines()
    kept: list[str] = []
    skip = False
    for line in text:
        if line.startswith("  File "):
            skip = __file__ in line
        elif not line.startswith("    "):
            skip = False
        if not skip:
            kept.append(line)
    return "\n".join(kept)
