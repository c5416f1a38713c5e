"""Handling Ctrl-C and SIGTERM, which batch systems send when a job's time is up: both become a KeyboardInterrupt."""

import contextlib
import signal
import threading
from collections.abc import Generator
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def terminating_interrupts() -> Generator[None]:
    """Let SIGTERM raise a KeyboardInterrupt in the block, so that the same is saved as after Ctrl-C.

    Outside the main thread, where signals cannot be caught, nothing changes.
    """

    def interrupt(_signal: int, _frame: Any) -> None:
        raise KeyboardInterrupt

    with _handling((signal.SIGTERM,), interrupt):
        yield


@contextlib.contextmanager
def interrupt_waits() -> Generator[list[bool]]:
    """Yield a list to which the first interrupt in the block appends True instead of raising; the second interrupt raises.

    Outside the main thread, where signals cannot be caught, nothing changes.
    """
    interrupted: list[bool] = []

    def interrupt(_signal: int, _frame: Any) -> None:
        if interrupted:
            raise KeyboardInterrupt
        interrupted.append(True)

    with _handling(_SIGNALS, interrupt):
        yield interrupted


def ignore_interrupts() -> None:
    """Ignore Ctrl-C and SIGTERM from here on: for a process that was interrupted and ends now, as it has told its user.

    A second signal could otherwise kill the process while Python shuts down, so that its exit status would be another one.
    Outside the main thread nothing changes.
    """
    if threading.current_thread() is threading.main_thread():
        for each in _SIGNALS:
            signal.signal(each, signal.SIG_IGN)


@contextlib.contextmanager
def _handling(signals: tuple[signal.Signals, ...], handler: Any) -> Generator[None]:
    """Handle signals by ``handler`` in the block, if this is the main thread; what the block itself sets stays."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {each: signal.signal(each, handler) for each in signals}
    try:
        yield
    finally:
        for each, old in before.items():
            if signal.getsignal(each) is handler:
                signal.signal(each, old)
