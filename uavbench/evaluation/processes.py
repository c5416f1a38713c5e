"""Doing work in worker processes, which can be killed without losing what they have finished.

Each result is sent back as soon as it is made, so that a worker that dies or hangs loses only what it was working on. A worker
ends when the process that started it ends, even if that process was killed.
"""

import contextlib
import ctypes
import faulthandler
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, MutableSequence, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import ModuleType
from typing import Any

from uavbench.errors import UavbenchError

#: How many numbers a worker shows while it works. The first is the time (`time.monotonic`) from which it is late; 0 for never.
SHOWN = 6
_LOOK_SECONDS = 0.1  # between two checks of the workers' times
_END_SECONDS = 10.0  # that a worker may take to end by itself when all work is done
_PARENT_DEATH_SIGNAL = 1  # prctl's PR_SET_PDEATHSIG

Work = Callable[[Any, MutableSequence[float]], Iterable[Any]]


class WorkerDiedError(UavbenchError):
    """A worker process ended without an answer; the message says how."""


class WorkerLateError(UavbenchError):
    """A worker was late and has been killed.

    Attributes
    ----------
    shown : list of float
        The numbers that it showed.
    trace : str
        The stack of its main thread, as `faulthandler` writes it; empty on platforms without the signal for this.
    """

    def __init__(self, shown: Sequence[float], trace: str) -> None:
        super().__init__("a worker process took too long")
        self.shown, self.trace = list(shown), trace


def work_apart(work: Work, pieces: Iterable[Any], workers: int) -> Generator[Any]:
    """Do pieces of work in worker processes, and yield each result as it is made.

    Parameters
    ----------
    work : callable
        ``work(piece, shown)`` yields the results of a piece. It is pickled once for each worker, where it may keep objects
        that are expensive to make. ``shown`` is shared memory for `SHOWN` numbers.
    pieces : iterable
        The work; a worker gets one piece at a time.
    workers : int
        How many processes.

    Raises
    ------
    WorkerDiedError, WorkerLateError
        When a worker ends, or is late by the time that it shows. Every worker is killed then.
    Exception
        Whatever ``work`` raises. Every worker is killed then.
    """
    waiting = deque(pieces)
    team: list[_Worker] = []
    with tempfile.TemporaryDirectory(prefix="uavbench-") as folder:
        try:
            team = [_Worker(work, Path(folder) / str(k)) for k in range(min(workers, len(waiting)))]
            busy = {worker.connection: worker for worker in team}
            for worker in team:
                worker.connection.send(waiting.popleft())
            while busy:
                for ready in wait(list(busy), _LOOK_SECONDS):
                    kind, content = busy[ready].receive()  # pyright: ignore[reportArgumentType]
                    if kind == "result":
                        yield content
                    elif waiting:
                        ready.send(waiting.popleft())  # pyright: ignore[reportAttributeAccessIssue, reportUnknownMemberType]
                    else:
                        del busy[ready]  # pyright: ignore[reportArgumentType]
                for worker in busy.values():
                    worker.check_time()
            for worker in team:
                worker.finish()
        finally:
            for worker in team:
                worker.kill()


class _Worker:
    """A worker process, seen from the one that started it."""

    def __init__(self, work: Work, trace: Path) -> None:
        context = multiprocessing.get_context("spawn")  # a fork of a process with threads may hang
        self.connection, theirs = context.Pipe()
        self._shown: Any = context.RawArray("d", SHOWN)
        self._trace = trace
        self._process = context.Process(target=_serve, args=(work, theirs, self._shown, trace), daemon=True)
        with _interrupt_held_back(), _main_left_out():
            self._process.start()
        theirs.close()

    def receive(self) -> tuple[str, Any]:
        """Return what the worker sends, ``("result", value)`` or ``("done", None)``; raise what its work raised."""
        try:
            kind, content = self.connection.recv()
        except (EOFError, OSError):
            self._process.join(_END_SECONDS)
            raise WorkerDiedError(f"its process {_ending(self._process.exitcode)}") from None
        if kind == "raised":
            raise content
        return kind, content

    def check_time(self) -> None:
        """Raise a `WorkerLateError` when the worker is late."""
        late = self._shown[0]
        if not late or time.monotonic() < late:
            return
        with contextlib.suppress(OSError, AttributeError):  # AttributeError: Windows has no such signal
            os.kill(self._process.pid or 0, signal.SIGUSR1)
            time.sleep(_LOOK_SECONDS)
        text = self._trace.read_text(encoding="utf-8", errors="replace") if self._trace.exists() else ""
        raise WorkerLateError(self._shown, text)

    def finish(self) -> None:
        """Let the worker end by itself, so that it flushes what it has printed."""
        with contextlib.suppress(OSError):
            self.connection.send(None)
        self._process.join(_END_SECONDS)

    def kill(self) -> None:
        """Kill the worker, if it still runs, with the processes that it has started."""
        if self._process.is_alive():
            with contextlib.suppress(OSError, AttributeError):  # AttributeError: Windows has no process groups
                os.killpg(self._process.pid or 0, signal.SIGKILL)
            self._process.kill()
        self._process.join()
        self.connection.close()


def _ending(status: int | None) -> str:
    """Say how a process ended."""
    if status is not None and status < 0:
        return f"was killed by the signal {signal.Signals(-status).name} (out of memory, or a crash?)"
    return f"ended itself with the exit status {status}"


@contextlib.contextmanager
def _interrupt_held_back() -> Generator[None]:
    """Block Ctrl-C in processes that are started in the block: a terminal sends it to all. This process gets it afterwards."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _main_left_out() -> Generator[None]:
    """Let processes that are started in the block not import the main program, which may not be safe to import again."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _serve(work: Work, connection: "Connection[Any, Any]", shown: Any, trace: Path) -> None:
    """Do pieces of work in a worker process until there are none left."""
    multiprocessing.current_process()._config["daemon"] = False  # pyright: ignore  # work may start processes, too
    if hasattr(os, "setpgrp"):
        os.setpgrp()  # a process group, to kill them together
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a batch system sends it to all processes; the parent handles it
    _end_with_parent()
    with trace.open("w", encoding="utf-8") as file:
        if hasattr(signal, "SIGUSR1"):
            faulthandler.register(signal.SIGUSR1, file=file, all_threads=False)
        try:
            while (piece := connection.recv()) is not None:
                for result in work(piece, shown):
                    connection.send(("result", result))
                connection.send(("done", None))
        except EOFError:  # the parent has ended
            return
        except BaseException as error:
            if not isinstance(error, UavbenchError | KeyboardInterrupt):
                error.add_note(traceback.format_exc())
            try:
                connection.send(("raised", error))
            except Exception:  # it cannot be pickled
                connection.send(("raised", RuntimeError(traceback.format_exc())))


def _end_with_parent() -> None:
    """Make this process end when its parent ends, however busy it is."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    if sys.platform == "linux":  # a thread cannot run while compiled code holds the interpreter's lock
        ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL)

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
