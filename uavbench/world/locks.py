"""Holding a folder, so that two processes do not work in it at the same time."""

import contextlib
import os
from collections.abc import Generator
from pathlib import Path

from uavbench.errors import UavbenchError
from uavbench.world.files import make_folder


class BusyError(UavbenchError):
    """Another process holds a folder."""


@contextlib.contextmanager
def held(folder: Path) -> Generator[None]:
    """Hold a folder, which is made if it is not there, so that no other process holds it; delete it at the end if it is empty.

    The lock is on the file ``lock`` in it and ends with the process. Windows and some network drives have no such lock: there,
    nothing is held.

    Raises
    ------
    BusyError
        When another process holds it.
    OSError
        When it cannot be made.
    """
    path = folder / "lock"
    handle = _lock(path)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
            folder.rmdir()
        os.close(handle)


def _lock(path: Path) -> int:
    """Return a handle with the lock on a file, where there are locks; the file and its folder are made if they are missing."""
    while True:
        make_folder(path.parent)
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except FileNotFoundError:  # another process has just deleted the folder
            continue
        try:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise BusyError(f"{path.parent}: another process uses it") from None
        except (ImportError, OSError):
            return handle
        try:
            if os.path.samestat(os.fstat(handle), path.stat()):
                return handle
        except FileNotFoundError:  # it was deleted before the lock was taken, which is worthless then
            pass
        os.close(handle)
