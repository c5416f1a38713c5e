"""Who flies episodes: worker processes of this machine, or a cluster."""

from collections.abc import Generator, Iterator, Sequence

from uavbench.evaluation.cluster import Cluster, work_on
from uavbench.evaluation.evaluate import EpisodeRecord, Job, evaluate
from uavbench.evaluation.parcel import Parcel, pack, unpack

#: A number of worker processes, or a cluster.
Crew = int | Cluster
_MOST = 50  # episodes of a piece if the agent flies them one by one


def evaluate_with(crew: Crew, job: Job, numbers: Sequence[int]) -> Generator[EpisodeRecord]:
    """Fly the episodes ``numbers``, yielding the record of each as it ends, or on a cluster soon after.

    Parameters and errors are those of `uavbench.evaluation.evaluate.evaluate`, and on a cluster also those of
    `uavbench.evaluation.cluster.work_on` and `uavbench.evaluation.parcel.pack`.

    Notes
    -----
    On a cluster, a call of the agent that takes too long is noticed when it returns; nothing kills it.
    """
    if not isinstance(crew, Cluster):
        yield from evaluate(job, numbers, crew)
        return
    yield from work_on(crew, _fly, pack(job), lambda cores: pieces(job, numbers, cores))


def crew_size(crew: Crew) -> int:
    """Return how many processes fly."""
    return crew.size if isinstance(crew, Cluster) else crew


def pieces(job: Job, numbers: Sequence[int], cores: int) -> list[Sequence[int]]:
    """Cut episodes into pieces, so that all cores have work.

    Each piece costs the driver some milliseconds, so they are large at first; the last ones are small, so that no core has to
    wait long for another. An agent that decides for many episodes at once has pieces of one size.
    """
    cores = max(1, cores)  # machines may still join
    if job.source.call(job.scenario) == "act_batch":
        size = min(job.batch_size, -(-len(numbers) // cores))
        return [numbers[k : k + size] for k in range(0, len(numbers), size)]
    found: list[Sequence[int]] = []
    while numbers:
        size = min(_MOST, max(1, len(numbers) // (2 * cores)))
        found.append(numbers[:size])
        numbers = numbers[size:]
    return found


def _fly(parcel: Parcel, numbers: Sequence[int]) -> Iterator[EpisodeRecord]:
    """Fly episodes on the machine where this is called."""
    return evaluate(unpack(parcel), numbers)
