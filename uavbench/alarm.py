"""A time limit on a call, as far as the platform has one.

An alarm is a timer signal, which Python delivers to the main thread only and Windows does not have. Without it a call that
took too long goes on until it ends, and its caller must look at the clock.
"""

import contextlib
import signal
import threading
from collections.abc import Generator
from typing import Any


class TimeUpError(BaseException):
    """The time is up; no ``Exception``, so that an ``except Exception`` in what was called does not swallow it."""


def _ring(_signal: int, _frame: Any) -> None:
    raise TimeUpError


@contextlib.contextmanager
def alarm() -> Generator[None]:
    """Let `set_alarm` work in the block, where it can."""
    global _armed
    if not hasattr(signal, "SIGALRM") or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGALRM, _ring)
    _armed = True
    try:
        yield
    finally:
        _armed = False
        signal.signal(signal.SIGALRM, before)


_armed = False
_LONGEST = 1e9  # seconds: the timer takes no infinity


def set_alarm(seconds: float | None) -> None:
    """Raise `TimeUpError` after ``seconds``; None for never."""
    if _armed:
        signal.setitimer(signal.ITIMER_REAL, min(seconds or 0, _LONGEST))
