"""An agent in a process of its own, which receives what the observation track allows, and nothing else.

In the same process an agent could reach the simulator, and with it the noise to come, through the garbage collector or the
frames of its callers. Here the agent's file is loaded and called in a child process. Observations are sent there through a
pipe, and actions come back as JSON, so that nothing the child sends is executed. This is no sandbox: the child may read files
and use the network like any program of the user.
"""

import contextlib
import json
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import traceback
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import IO, TYPE_CHECKING, Any, cast

import numpy as np

from uavbench.agents.agent import AgentSource, Call, Track
from uavbench.errors import UavbenchError

if TYPE_CHECKING:  # a child starts in half the time without Numba
    from uavbench.simulation.observation import Observation
    from uavbench.world.scenario import Scenario

#: The parts of ``info`` that an agent on the observation track receives.
TOLD = ("action_mask", "safe_action_mask", "split", "episode", "seed", "uav")
_START = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from uavbench.agents.apart import serve; serve()"
_LONGEST_ANSWER = 2**20  # bytes; 250 actions take 1,000
_LENGTH = 4  # bytes that hold the length of a message


class ApartError(UavbenchError):
    """The agent's process failed; the message says what it raised, that it took too long, or how the process ended."""


@dataclass(frozen=True)
class ApartSource(AgentSource):
    """An agent's source whose code never runs in this process.

    Attributes
    ----------
    decision_timeout : float, optional
        Seconds that one call of the agent may take before its process is killed; None for no limit.
    """

    decision_timeout: float | None = None

    @classmethod
    def of(cls, source: AgentSource, decision_timeout: float | None) -> "ApartSource":
        """Return the source of the same agent that runs it in a process of its own."""
        given = {field.name: getattr(source, field.name) for field in fields(AgentSource)}
        return cls(**given, decision_timeout=decision_timeout)

    @cached_property
    def _said(self) -> dict[str, Any]:
        """The track, the mask and the methods of the agent's class, as the child process reports them."""
        return _Child(self, None).said

    @property
    def track(self) -> Track:
        """What the agent may see."""
        return self._said["track"]

    @property
    def safe_mask(self) -> bool:
        """Whether the agent is told which actions are safe."""
        return self._said["safe_mask"]

    @property
    def calls(self) -> tuple[Call, ...]:
        """The methods by which the agent decides."""
        return tuple(self._said["calls"])

    def make(self, scenario: "Scenario") -> Any:
        """Start a process with a new agent for ``scenario``.

        Raises
        ------
        ApartError
            When the agent cannot be made.
        """
        return AgentApart(self, scenario)


class AgentApart:
    """Stands for the agent in the process that flies the episodes, and passes calls on to the agent's own process."""

    def __init__(self, source: ApartSource, scenario: "Scenario") -> None:
        self._child = _Child(source, scenario)
        self._limit = source.decision_timeout
        self.reset = self._reset if self._child.said["reset"] else None

    def act(self, observation: "Observation", info: Mapping[str, Any]) -> Any:
        """Ask for one UAV's action."""
        return self._child.ask("act", (observation, _told(info)), self._limit)

    def act_batch(self, observations: "Observation", infos: Sequence[Mapping[str, Any]]) -> Any:
        """Ask for the actions of many UAVs."""
        return self._child.ask("act_batch", (observations, [_told(info) for info in infos]), self._limit)

    def _reset(self, info: Mapping[str, Any]) -> None:
        self._child.ask("reset", (_told(info),), self._limit)


def _told(info: Mapping[str, Any]) -> dict[str, Any]:
    return {name: info[name] for name in TOLD if name in info}


class _Child:
    """The process of an agent, as its parent sees it; it is killed when this object is no longer used."""

    def __init__(self, source: ApartSource, scenario: "Scenario | None") -> None:
        command = [sys.executable, "-c", _START, json.dumps(sys.path)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._end = weakref.finalize(self, _end, self._process)
        plain = AgentSource(**{field.name: getattr(source, field.name) for field in fields(AgentSource)})
        self.said: dict[str, Any] = self._exchange((plain, scenario), None)  # no limit: loading weights may take long

    def ask(self, method: str, arguments: tuple[Any, ...], limit: float | None) -> Any:
        """Return what a method of the agent returns; kill the process when that takes longer than ``limit`` seconds."""
        return self._exchange((method, arguments), limit)

    def _exchange(self, message: Any, limit: float | None) -> Any:
        late = threading.Event()
        timer = threading.Timer(min(limit or 0.0, threading.TIMEOUT_MAX), lambda: (late.set(), self._process.kill()))
        timer.daemon = True
        if limit is not None:
            timer.start()
        try:
            _write(cast("IO[bytes]", self._process.stdin), pickle.dumps(message))
            answer = json.loads(_read(cast("IO[bytes]", self._process.stdout), _LONGEST_ANSWER))
            if "error" in answer:
                raise ApartError(str(answer["error"]))
            return answer["value"]
        except (OSError, EOFError, ValueError, RecursionError, TypeError, KeyError) as error:
            self._process.kill()
            if late.is_set():
                raise ApartError(f"took longer than {limit:g} s") from None
            status = self._process.wait()
            why = f"ended with status {status}" if isinstance(error, OSError | EOFError) else f"sent no answer ({error})"
            raise ApartError(f"failed: the agent's process {why}") from None
        finally:
            timer.cancel()


def _end(process: "subprocess.Popen[bytes]") -> None:
    """Kill a process and close the pipes to it."""
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe:
            with contextlib.suppress(OSError):  # closing tries to write what is left
                pipe.close()


def _write(pipe: IO[bytes], content: bytes) -> None:
    pipe.write(len(content).to_bytes(_LENGTH, "little") + content)
    pipe.flush()


def _read(pipe: IO[bytes], most: int | None = None) -> bytes:
    """Read a message; raise an EOFError where the other side has ended, and a ValueError where it is too long."""
    head = pipe.read(_LENGTH)
    length = int.from_bytes(head, "little")
    if most is not None and length > most:
        raise ValueError(f"its answer has {length:,} bytes")
    content = pipe.read(length) if len(head) == _LENGTH else b""
    if len(head) < _LENGTH or len(content) < length:
        raise EOFError
    return content


def serve() -> None:
    """Load an agent and answer the parent's requests; this runs in the child process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the parent decides
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what an agent prints must not mix with the answers
    requests: queue.Queue[Any] = queue.Queue()
    threading.Thread(target=_listen, args=(requests,), daemon=True).start()
    agent: Any = None
    while True:
        first, second = requests.get()
        try:
            if isinstance(first, AgentSource):
                agent, value = _make(first, second)
            else:
                value = getattr(agent, first)(*second)
                value = None if first == "reset" else np.asarray(value).tolist()
            answer = json.dumps({"value": value})
        except BaseException as error:
            answer = json.dumps({"error": _reason(error)})
        _write(answers, answer.encode())


def _listen(requests: "queue.Queue[Any]") -> None:
    """Pass on what the parent sends; when the parent ends, end this process, whatever the agent is doing."""
    try:
        while True:
            requests.put(pickle.loads(_read(sys.stdin.buffer)))  # safe: it comes from our own parent
    finally:
        os._exit(1)


def _make(source: AgentSource, scenario: "Scenario | None") -> tuple[Any, dict[str, Any]]:
    """Return an agent, or None without a scenario, and what the parent needs to know of it."""
    agent = source.make(scenario) if scenario else None
    resets = callable(getattr(agent, "reset", None))
    said = {"track": source.track, "safe_mask": source.safe_mask, "calls": source.calls, "reset": resets}
    return agent, said


def _reason(error: BaseException) -> str:
    """Return what was raised, with its traceback, as the end of a sentence that begins with the method's name."""
    try:
        said = str(error)
    except BaseException:
        said = "an error that cannot be shown"
    if isinstance(error, UavbenchError):
        return f"failed: {said}"
    trace = "".join(traceback.format_tb(error.__traceback__)[-5:])
    return f"raised {type(error).__name__}: {said}\n{trace}"[:10_000]
