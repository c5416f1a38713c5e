"""Ctrl-C that waits for what must not be broken off."""

import contextlib
import signal
import threading
from collections.abc import Generator
from typing import Any


@contextlib.contextmanager
def interrupt_waits() -> Generator[list[bool]]:
    """Let the first Ctrl-C in the block put a True into the list that is yielded, instead of raising; the second raises.

    Outside the main thread, where signals cannot be caught, nothing changes.
    """
    interrupted: list[bool] = []
    if threading.current_thread() is not threading.main_thread():
        yield interrupted
        return

    def interrupt(_signal: int, _frame: Any) -> None:
        if interrupted:
            raise KeyboardInterrupt
        interrupted.append(True)

    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, before)
