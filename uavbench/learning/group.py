"""The processes that share a training: each steps a part of the environments, and all learn one network.

The first process leads: it keeps the files and talks to the user. The others do what it tells. They are started here, on this
machine, or by PyTorch's launcher ``torchrun``, on one or on several machines. Gradients are averaged by PyTorch's
``DistributedDataParallel`` over gloo, which works on every processor. The observations of a process never leave it.
"""

import contextlib
import datetime
import importlib
import multiprocessing
import os
import socket
import tempfile
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from multiprocessing import connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.errors import UavbenchError, one_line
from uavbench.evaluation.interrupt import ignore_interrupts

#: How long a process waits for the others. One that has died is noticed at once, by its closed connection.
_WAIT = datetime.timedelta(hours=1)
_POLL_SECONDS = 0.02
_END_SECONDS = 10.0
_INTERFACE = "GLOO_SOCKET_IFNAME"  # gloo reads it


class GroupError(UavbenchError, RuntimeError):
    """The processes of a training cannot begin or go on together."""


@dataclass(frozen=True)
class Group:
    """The processes of a training, seen from one of them. All have to call the same methods in the same order.

    Attributes
    ----------
    rank, size : int
        The number of this process, 0 for the one that leads, and the number of processes.
    """

    rank: int = 0
    size: int = 1

    def told(self, value: Any = None) -> Any:
        """Return the value of the process that leads; what the others give does not count."""
        if self.size == 1:
            return value
        values = [value]
        _distributed().broadcast_object_list(values, src=0)
        return values[0]

    def gathered(self, value: Any) -> list[Any]:
        """Return the values of all processes, by rank, to the process that leads; an empty list to the others."""
        if self.size == 1:
            return [value]
        values = [None] * self.size if self.rank == 0 else None
        _distributed().gather_object(value, values, dst=0)
        return values or []

    def least(self, number: int) -> int:
        """Return the least of the numbers of all processes."""
        return number if self.size == 1 else min(self._all(number))

    def mean(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mean over all processes."""
        return numbers if self.size == 1 else np.mean(self._all(numbers), axis=0)

    def together(self, network: Any) -> Any:
        """Return a network whose gradients are the means over all processes, and whose weights are those of the first."""
        if self.size == 1:
            return network
        return importlib.import_module("torch.nn.parallel").DistributedDataParallel(network)

    def _all(self, value: Any) -> list[Any]:
        """Return the values of all processes to all of them."""
        values = [None] * self.size
        _distributed().all_gather_object(values, value)
        return values


#: A process that shares its training with no other.
ALONE = Group()


def group() -> Group:
    """Return the group of this process; it is alone if nothing else was begun."""
    distributed = _distributed()
    if distributed.is_available() and distributed.is_initialized():
        return Group(distributed.get_rank(), distributed.get_world_size())
    return ALONE


def group_for(processes: int) -> Group:
    """Return the group of a training that begins here: that of ``torchrun``, or one that this process leads.

    Parameters
    ----------
    processes : int
        The number of processes that the user wants. Under ``torchrun``, 1 stands for as many as it has started.

    Raises
    ------
    GroupError
        When ``torchrun`` has started another number of processes.
    """
    if not _launched():
        return Group(0, processes)
    found = Group(int(os.environ["RANK"]), int(os.environ["WORLD_SIZE"]))
    if processes not in (1, found.size):
        raise GroupError(f"--processes {processes}: torchrun has started {found.size}; leave the option out")
    return found


def _launched() -> bool:
    """Return whether ``torchrun`` has started this process. PyTorch could tell, but it may be missing here."""
    return all(name in os.environ for name in ("TORCHELASTIC_RUN_ID", "RANK", "WORLD_SIZE"))


@contextlib.contextmanager
def begun(processes: int, follow: Callable[..., None], *arguments: Any) -> Generator[Group]:
    """Begin a group: start the other processes, unless ``torchrun`` has done so; end them with the block.

    Parameters
    ----------
    processes : int
        The number of processes, this one included.
    follow : callable
        What the others do, with the same arguments; both must be picklable.

    Raises
    ------
    GroupError
        When a process has ended too early.
    """
    with _launched_here() if _launched() else _started_here(processes, follow, arguments) as found:
        yield found


@contextlib.contextmanager
def _launched_here() -> Generator[Group]:
    """Join the group in which ``torchrun`` has started this process."""
    distributed = _distributed()
    distributed.init_process_group("gloo", timeout=_WAIT)
    try:
        yield group()
    except RuntimeError as error:
        raise GroupError(f"a process of the training has failed or was lost: {one_line(error)}; go on with --resume") from error
    finally:
        distributed.destroy_process_group()


@contextlib.contextmanager
def _started_here(processes: int, follow: Callable[..., None], arguments: tuple[Any, ...]) -> Generator[Group]:
    """Start the other processes on this machine; all of them talk over its loopback interface only."""
    if processes == 1:
        yield ALONE
        return
    distributed, spawn = _distributed(), multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as folder, _loopback():
        where = str(Path(folder) / "group")
        store = distributed.FileStore(where, processes)
        others = [
            spawn.Process(target=_other, args=(rank, processes, where, follow, arguments), daemon=True)
            for rank in range(1, processes)
        ]
        try:
            for other in others:
                other.start()
            while not store.check([_here(rank) for rank in range(1, processes)]):
                _check(others, _POLL_SECONDS)
            distributed.init_process_group("gloo", store=store, rank=0, world_size=processes, timeout=_WAIT)
            yield group()
            for other in others:
                other.join(_END_SECONDS)
        except RuntimeError:
            _check(others, _END_SECONDS)
            raise
        finally:
            for other in others:
                if other.pid is not None:
                    other.kill()
                    other.join()
            if distributed.is_initialized():
                distributed.destroy_process_group()


def _other(rank: int, size: int, where: str, follow: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    """Run one of the other processes."""
    ignore_interrupts()  # the process that leads says when to end
    distributed = _distributed()
    store = distributed.FileStore(where, size)
    store.set(_here(rank), "")
    try:
        distributed.init_process_group("gloo", store=store, rank=rank, world_size=size, timeout=_WAIT)
        follow(*arguments)
    except UavbenchError:
        os._exit(1)  # the process that leads finds the same, and says it
    except RuntimeError:
        parent = multiprocessing.parent_process()
        if parent is not None and connection.wait([parent.sentinel], _END_SECONDS):
            os._exit(1)
        raise  # otherwise the process that leads would have ended this one by now
    distributed.destroy_process_group()


def _here(rank: int) -> str:
    """Return the key under which a process says that it has begun."""
    return f"process {rank}"


def _check(others: Sequence[Any], seconds: float) -> None:
    """Raise a GroupError if one of the other processes has ended, or ends within some seconds."""
    connection.wait([other.sentinel for other in others], seconds)
    for rank, other in enumerate(others, 1):
        if not other.is_alive():
            raise GroupError(
                f"process {rank + 1} of the {len(others) + 1} of this training has ended, with exit status {other.exitcode}; "
                "go on with --resume"
            ) from None


@contextlib.contextmanager
def _loopback() -> Generator[None]:
    """Let gloo use the loopback interface in the block, unless the user has named another one."""
    names = [name for _, name in socket.if_nameindex() if name.startswith("lo")]
    if _INTERFACE in os.environ or not names:
        yield
        return
    os.environ[_INTERFACE] = names[0]
    try:
        yield
    finally:
        del os.environ[_INTERFACE]


def _distributed() -> Any:
    return importlib.import_module("torch.distributed")
