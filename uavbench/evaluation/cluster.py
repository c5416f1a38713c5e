"""Flying episodes on a cluster of Ray or Dask.

The episodes are cut into pieces. When machines or processes of the cluster are lost, the pieces that they had are flown again
by those that are left; what is finished stays. The other machines need only uavbench and the packages that the agent imports:
see `uavbench.evaluation.parcel`.
"""

import contextlib
import itertools
import logging
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from uavbench.errors import UavbenchError, one_line
from uavbench.evaluation.evaluate import DEFAULT_BATCH, EpisodeRecord, Job, evaluate
from uavbench.evaluation.parcel import Parcel, pack, unpack

Engine = Literal["ray", "dask"]
ENGINES: tuple[Engine, ...] = ("ray", "dask")
_PIECE = 10  # episodes of a piece if the agent flies them one by one
_WINDOW = 1_000  # pieces that the cluster is given at a time
_RETRIES = 3  # how often the engine itself starts a piece anew whose process or machine is lost
_SECONDS = 30  # in which a scheduler must answer
_TRIES = 3  # how often in a row the cluster may fail without finishing a piece


class ClusterError(UavbenchError):
    """A cluster cannot be reached, or fails again and again."""


@dataclass
class Cluster:
    """A cluster on which episodes are flown.

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


def evaluate_with(crew: "int | Cluster", job: Job, numbers: Sequence[int]) -> Generator[EpisodeRecord]:
    """Fly episodes in worker processes of this machine, as many as ``crew`` says, or on a cluster."""
    return evaluate_on(crew, job, numbers) if isinstance(crew, Cluster) else evaluate(job, numbers, crew)


def crew_size(crew: "int | Cluster") -> int:
    """Return how many processes fly."""
    return crew.size if isinstance(crew, Cluster) else crew


def evaluate_on(cluster: Cluster, job: Job, numbers: Sequence[int]) -> Generator[EpisodeRecord]:
    """Fly the episodes ``numbers`` on a cluster, yielding the record of each soon after it ends.

    Parameters
    ----------
    cluster : Cluster
    job : Job
        What is flown.
    numbers : sequence of int
        Which episodes.

    Raises
    ------
    ClusterError
        When the cluster cannot be reached, or has failed three times in a row.
    AgentError, ParcelError
        When the agent fails, or the evaluation cannot be sent. The episodes that were finished have been yielded before.

    Notes
    -----
    A call of the agent that takes too long is noticed when it returns; nothing kills it.
    """
    parcel, missing, tries = pack(job), dict.fromkeys(numbers), 0
    size = min(job.batch_size, DEFAULT_BATCH) if job.source.call(job.scenario) == "act_batch" else _PIECE
    with _connected(cluster) as answers:
        while missing:
            waiting = list(missing)
            pieces = [waiting[k : k + size] for k in range(0, len(waiting), size)]
            try:
                for answer in answers(parcel, pieces):
                    if isinstance(answer, UavbenchError):
                        raise answer
                    tries = 0
                    for record in answer:
                        if record.episode in missing:  # a piece may have been flown twice
                            del missing[record.episode]
                            yield record
            except UavbenchError:
                raise
            except Exception as error:  # each engine has its own errors for what it has lost
                tries, why = tries + 1, f"{type(error).__name__}: {one_line(error)}"
                if tries == _TRIES:
                    raise ClusterError(f"the cluster of {cluster.engine} has failed {_TRIES} times in a row: {why}") from error
                cluster.on_loss(why)


Answer = list[EpisodeRecord] | UavbenchError


def _fly(parcel: Parcel, piece: Sequence[int]) -> Answer:
    """Fly a piece on the machine where this is called; return the records, or what is wrong, as engines wrap exceptions."""
    try:
        return list(evaluate(unpack(parcel), piece))
    except UavbenchError as error:
        return error


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

    def answers(parcel: Parcel, pieces: Sequence[Sequence[int]]) -> Generator[Answer]:
        sent, fly, ahead = ray.put(parcel), ray.remote(max_retries=_RETRIES)(_fly), iter(pieces)
        waiting = {fly.remote(sent, piece) for piece in itertools.islice(ahead, _WINDOW)}
        while waiting:
            (ready,), _ = ray.wait(list(waiting), num_returns=1)
            waiting.remove(ready)
            waiting.update(fly.remote(sent, piece) for piece in itertools.islice(ahead, 1))
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
    own: dict[str, Any] = {"threads_per_worker": 1, "dashboard_address": None}
    try:
        client = distributed.Client(cluster.address, timeout=_SECONDS) if cluster.address else distributed.Client(**own)
    except (OSError, ValueError) as error:
        raise ClusterError(f"--address {cluster.address}: no scheduler of Dask answers there: {one_line(error)}") from None

    def answers(parcel: Parcel, pieces: Sequence[Sequence[int]]) -> Generator[Answer]:
        (sent,), ahead = client.scatter([parcel], broadcast=True, hash=False), iter(pieces)

        def submitted(count: int) -> list[Any]:
            chosen = itertools.islice(ahead, count)
            return [client.submit(_fly, sent, piece, pure=False, retries=_RETRIES) for piece in chosen]

        ready = distributed.as_completed(submitted(_WINDOW))
        for future in ready:
            for other in submitted(1):
                ready.add(other)
            yield future.result()

    with client:
        cluster.size = sum(client.nthreads().values())
        yield answers
