"""How the resamples of the bootstrap are drawn: of episodes, or of cities and of the episodes in them.

Every draw comes from a stream of random bits with a fixed key, so that the same scores give the same interval everywhere, and
so that two agents are resampled alike. The functions know nothing of cities: what they call a cluster is any group of episodes
that are alike.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 10_000
_CHUNK = 500_000  # values resampled at once
_KEPT = RESAMPLES * 1000 // _CHUNK  # chunks: all resamples of a test split, 40 MB
#: The keys of the streams; 1 and 2 are for the seeds of the methods that `uavbench.evaluation.metrics` compares.
_EPISODES, _CLUSTERS, _IN_CLUSTERS = 0, 3, 4


@dataclass(frozen=True)
class Clusters:
    """Episodes of several clusters, of which at least one has several episodes.

    Attributes
    ----------
    number : ndarray
        Shape (n,), int64: the cluster of each episode, from 0 on, in the order in which the clusters first appear.
    sizes : tuple of int
        How many episodes each cluster has.
    """

    number: NDArray[np.int64]
    sizes: tuple[int, ...]


def clusters_of(n: int, labels: NDArray[np.int64] | None) -> Clusters | None:
    """Return the clusters of ``n`` episodes, or None if clusters make no difference.

    They make none if there are no labels, if every episode has a cluster of its own, and if all episodes have the same cluster.
    In the last case nothing is known of other clusters, so the statistics are about the episodes of this cluster only.

    Parameters
    ----------
    n : int
        The number of episodes.
    labels : ndarray or None
        Shape (n,), int64: the cluster of each episode. Any numbers will do: only which of them are equal counts, and the order
        in which they first appear.

    Raises
    ------
    ValueError
        When there is not one label for each episode.
    """
    if labels is None:
        return None
    if labels.shape != (n,):
        raise ValueError(f"clusters: the shape is {labels.shape}, but there are {n} episodes, so it must be ({n},)")
    number = in_order(labels)
    sizes = np.bincount(number).tolist()
    return None if len(sizes) in (1, n) else Clusters(number, tuple(sizes))


def in_order(labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return labels numbered from 0 on in the order in which they first appear, so that it does not matter what they are."""
    _, first, place = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[place]


def resampled_means(values: NDArray[np.float64], labels: NDArray[np.int64] | None = None) -> NDArray[np.float64]:
    """Return the means of 10,000 resamples of ``values``.

    Without labels, a resample draws n values with replacement. With labels, it draws as many clusters as there are with
    replacement, and then, in each cluster that was drawn, as many values as the cluster has, with replacement too. So where
    the clusters differ in size, the number of values in a resample varies; its mean is the mean over all values in it.

    Parameters
    ----------
    values : ndarray
        Shape (n,), float64.
    labels : ndarray, optional
        Shape (n,), int64: the cluster of each value, as in `clusters_of`.

    Returns
    -------
    ndarray
        Shape (10000,), float64. Which values a resample draws depends on n and on the clusters alone.
    """
    clusters = clusters_of(len(values), labels)
    if clusters is None:
        return np.concatenate(
            [values.take(_picks(len(values), *some), mode="clip").mean(axis=1) for some in _chunks(len(values))]
        )
    together = values.astype(np.float64)[np.argsort(clusters.number, kind="stable")]  # cluster after cluster
    means: list[NDArray[np.float64]] = []
    drawn = 0
    for first, count in _chunks(len(values)):
        picks, lengths = _picks_in_clusters(clusters.sizes, first, count, drawn)
        means.append(np.add.reduceat(together.take(picks, mode="clip"), np.cumsum(lengths) - lengths) / lengths)
        drawn += len(picks)
    return np.concatenate(means)


def _chunks(n: int) -> Iterator[tuple[int, int]]:
    """Yield the number of the first resample, and how many there are, of each part that is drawn at once."""
    size = max(1, _CHUNK // n)
    for first in range(0, RESAMPLES, size):
        yield first, min(size, RESAMPLES - first)


@lru_cache(maxsize=_KEPT)
def _picks(n: int, first: int, count: int) -> NDArray[np.int32]:
    """Return the indices of the values in the resamples ``first`` to ``first`` + ``count`` − 1: shape (``count``, n)."""
    return drawn(n, first, count, _EPISODES)


@lru_cache(maxsize=_KEPT)
def _picks_in_clusters(
    sizes: tuple[int, ...], first: int, count: int, before: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Draw clusters, and values in them.

    Parameters
    ----------
    sizes : tuple of int
        How many values each cluster has; the values stand cluster after cluster.
    first, count : int
        The first resample that is drawn, and how many are drawn.
    before : int
        How many values all resamples before the first one have.

    Returns
    -------
    picks : ndarray
        Shape (sum of ``lengths``,), int32: the indices of the values drawn, resample after resample.
    lengths : ndarray
        Shape (``count``,), int64: how many values each resample has.
    """
    size = np.array(sizes)
    clusters = drawn(len(sizes), first, count, _CLUSTERS)
    lengths = size[clusters].sum(axis=1)
    clusters = np.repeat(clusters.ravel(), size[clusters].ravel())  # one for each value drawn
    raw = np.random.PCG64(_IN_CLUSTERS).advance(before).random_raw(len(clusters))
    inside = _below(raw, size.astype(np.uint64)[clusters])
    return inside + (np.cumsum(size) - size).astype(np.int32)[clusters], lengths


def drawn(n: int, first: int, count: int, key: int) -> NDArray[np.int32]:
    """Draw ``count`` times n of the numbers below n, with replacement: shape (``count``, n).

    Parameters
    ----------
    n : int
    first : int
        How many times n numbers come before those that are drawn in the stream.
    count : int
    key : int
        The key of the stream.
    """
    bits = np.random.PCG64(key).advance(first * n)  # NumPy promises the stream of raw bits, not of its distributions
    return _below(bits.random_raw(count * n), np.uint64(n)).reshape(count, n)


def _below(raw: NDArray[np.uint64], bound: NDArray[np.uint64] | np.uint64) -> NDArray[np.int32]:
    """Turn raw bits into integers from 0 to ``bound`` − 1."""
    return (((raw >> np.uint64(32)) * bound) >> np.uint64(32)).astype(np.int32)
