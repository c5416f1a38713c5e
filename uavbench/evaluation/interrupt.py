"""Ctrl-C, and SIGTERM, by which batch systems end a process when its time is up: both are a KeyboardInterrupt."""

import contextlib
import signal
import threading
from collections.abc import Generator
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def terminating_interrupts() -> Generator[None]:
    """Let SIGTERM raise a KeyboardInterrupt in the block, so that whatever Ctrl-C saves is saved.

    Outside the main thread, where signals cannot be caught, nothing changes.
    """

    def interrupt(_signal: int, _frame: Any) -> None:
        raise KeyboardInterrupt

    with _handling((signal.SIGTERM,), interrupt):
        yield


@contextlib.contextmanager
def interrupt_waits() -> Generator[list[bool]]:
    """Let the first interrupt in the block put a True into the list that is yielded, instead of raising; the second raises.

    Outside the main thread, where signals cannot be caught, nothing changes.
    """
    interrupted: list[bool] = []

    def interrupt(_signal: int, _frame: Any) -> None:
        if interrupted:
            raise KeyboardInterrupt
        interrupted.append(True)

    with _handling(_SIGNALS, interrupt):
        yield interrupted


@contextlib.contextmanager
def _handling(signals: tuple[signal.Signals, ...], handler: Any) -> Generator[None]:
    """Handle signals in the block, where they can be."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {each: signal.signal(each, handler) for each in signals}
    try:
        yield
    finally:
        for each, old in before.items():
            signal.signal(each, old)
