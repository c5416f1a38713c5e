"""Doing work on a cluster of Ray or Dask.

When machines or processes of the cluster are lost, those that are left do the pieces of work again that they had; what is
finished stays.
"""

import contextlib
import itertools
import logging
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from uavbench.errors import UavbenchError, one_line

Engine = Literal["ray", "dask"]
Work = Callable[[Any, Any], Iterable[Any]]
_Answer = tuple[int, list[Any] | UavbenchError]
_WINDOW = 1_000  # pieces that the cluster is given at a time
_RETRIES = 3  # how often the engine itself starts a piece anew whose process or machine is lost
_SECONDS = 30  # in which a scheduler must answer
_TRIES = 3  # how often in a row the cluster may fail without finishing a piece


class ClusterError(UavbenchError):
    """A cluster cannot be reached, or fails again and again."""


@dataclass
class Cluster:
    """A cluster on which work is done.

    Attributes
    ----------
    engine : {"ray", "dask"}
    address : str, optional
        Where it is; by default one is started on this machine, with a process for each core.
    on_loss : callable
        Called with the reason each time that a part of the cluster is lost.
    size : int
        Its number of cores, once it has been reached; 0 before.
    """

    engine: Engine
    address: str | None = None
    on_loss: Callable[[str], None] = lambda why: None
    size: int = field(default=0, init=False)


def work_on(cluster: Cluster, work: Work, sent: Any, pieces: Callable[[int], Iterable[Any]]) -> Generator[Any]:
    """Do pieces of work on a cluster, and yield each result soon after its piece is done.

    Parameters
    ----------
    cluster : Cluster
    work : callable
        ``work(sent, piece)`` yields the results of a piece; a function of a module, as engines send it by its name.
    sent : object
        What all pieces need; it is sent to each machine once.
    pieces : callable
        ``pieces(cores)`` returns the work, cut into pieces for so many cores.

    Raises
    ------
    ClusterError
        When the cluster cannot be reached, or has failed three times in a row.
    UavbenchError
        What ``work`` raises. The results that were there before have been yielded.
    """
    with _connected(cluster) as answers:
        missing, tries = dict(enumerate(pieces(cluster.size))), 0
        while missing:
            try:
                for number, answer in answers(work, sent, list(missing.items())):
                    if isinstance(answer, UavbenchError):
                        raise answer
                    tries = 0
                    del missing[number]
                    yield from answer
            except UavbenchError:
                raise
            except Exception as error:  # each engine has its own errors for what it has lost
                tries, why = tries + 1, f"{type(error).__name__}: {one_line(error)}"
                if tries == _TRIES:
                    raise ClusterError(f"the cluster of {cluster.engine} has failed {_TRIES} times in a row: {why}") from error
                cluster.on_loss(why)


def _do(work: Work, sent: Any, number: int, piece: Any) -> _Answer:
    """Do a piece on the machine where this is called; return its results, or what is wrong, as engines wrap exceptions."""
    try:
        return number, list(work(sent, piece))
    except UavbenchError as error:
        return number, error


@contextlib.contextmanager
def _connected(cluster: Cluster) -> Generator[Any]:
    """Connect to a cluster for the block; yield a function that gives the answers to pieces of a parcel as they come."""
    try:
        with (_ray if cluster.engine == "ray" else _dask)(cluster) as answers:
            yield answers
    except ImportError as error:
        raise ClusterError(
            f"--cluster {cluster.engine}: needs {error.name}: pip install 'uavbench[{cluster.engine}]'"
        ) from None


@contextlib.contextmanager
def _ray(cluster: Cluster) -> Generator[Any]:
    """Connect to a cluster of Ray, or start one on this machine."""
    import ray as engine

    ray: Any = engine
    mine = not ray.is_initialized()
    if mine:
        try:
            ray.init(address=cluster.address, log_to_driver=False, logging_level=logging.ERROR)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise ClusterError(f"--address {cluster.address}: no cluster of Ray answers there: {one_line(error)}") from None

    def answers(work: Work, sent: Any, pieces: Sequence[tuple[int, Any]]) -> Generator[_Answer]:
        there, do, ahead = ray.put(sent), ray.remote(max_retries=_RETRIES)(_do), iter(pieces)
        waiting = {do.remote(work, there, *piece) for piece in itertools.islice(ahead, _WINDOW)}
        while waiting:
            (ready,), _ = ray.wait(list(waiting), num_returns=1)
            waiting.remove(ready)
            waiting.update(do.remote(work, there, *piece) for piece in itertools.islice(ahead, 1))
            yield ray.get(ready)

    try:
        cluster.size = int(ray.cluster_resources().get("CPU", 1))
        yield answers
    finally:
        if mine:
            ray.shutdown()


@contextlib.contextmanager
def _dask(cluster: Cluster) -> Generator[Any]:
    """Connect to a cluster of Dask, or start one on this machine."""
    import distributed as engine

    distributed: Any = engine
    own: dict[str, Any] = {"threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}  # 0: any free port
    try:
        client = distributed.Client(cluster.address, timeout=_SECONDS) if cluster.address else distributed.Client(**own)
    except (OSError, ValueError) as error:
        raise ClusterError(f"--address {cluster.address}: no scheduler of Dask answers there: {one_line(error)}") from None

    def answers(work: Work, sent: Any, pieces: Sequence[tuple[int, Any]]) -> Generator[_Answer]:
        (there,), ahead = client.scatter([sent], broadcast=True, hash=False), iter(pieces)

        def submitted(count: int) -> list[Any]:
            chosen = itertools.islice(ahead, count)
            return [client.submit(_do, work, there, *piece, pure=False, retries=_RETRIES) for piece in chosen]

        ready = distributed.as_completed(submitted(_WINDOW))
        for future in ready:
            for other in submitted(1):
                ready.add(other)
            yield future.result()

    with client:
        cluster.size = sum(client.nthreads().values())
        yield answers
