"""Statistics over episodes: means with confidence intervals, and paired comparisons.

Landed is a proportion and gets Wilson's interval, which does not shrink to a point when every episode landed; CR and CRAL get
the percentile bootstrap. Resampling is keyed, so that the same scores give the same interval everywhere.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from uavbench.world.scenario import Scenario

#: The metrics of an episode (the paper's Table III).
METRICS = ("landed", "cr", "cral")
#: Their names in tables and figures.
NAMES = {"landed": "Landed", "cr": "CR", "cral": "CRAL"}
CONFIDENCE = 0.95
_RESAMPLES = 10_000
#: Scores that differ by at most this count as equal: two platforms' logarithms differ in their last digits.
ROUNDING = 1e-6
_CHUNK = 500_000  # values resampled at once


def tolerance(scenario: Scenario) -> float:
    """Return by how much two scores of a scenario may differ and still count as equal: 0 where its mission is exact."""
    return 0.0 if scenario.mission.exact else ROUNDING


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence interval, all as fractions."""

    mean: float
    low: float
    high: float


def proportion_interval(successes: NDArray[np.bool_ | np.float64], confidence: float = CONFIDENCE) -> Interval:
    """Return the share of successes with Wilson's score interval (Wilson 1927).

    Parameters
    ----------
    successes : ndarray
        Shape (n,): whether each trial succeeded. For groups of trials that depend on each other, give the share of each group
        that succeeded: a group then counts as one trial, so that the dependence does not make the interval too narrow.
    """
    n, share = len(successes), float(np.mean(successes))
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    centre = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return Interval(share, min(share, max(0.0, centre - half)), max(share, min(1.0, centre + half)))


def mean_interval(values: NDArray[np.float64], confidence: float = CONFIDENCE) -> Interval:
    """Return the mean with its percentile-bootstrap interval (Efron 1979; 10,000 resamples)."""
    return _percentiles(float(np.mean(values)), _resampled_means(values), confidence)


def _percentiles(mean: float, resampled: NDArray[np.float64], confidence: float = CONFIDENCE) -> Interval:
    """Return the percentile-bootstrap interval of a mean, from means of resamples."""
    tail = (1 - confidence) / 2
    low, high = np.quantile(resampled, (tail, 1 - tail))
    return Interval(mean, float(low), float(high))


def _resampled_means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the means of 10,000 samples of ``values`` with replacement."""
    n = len(values)
    size = max(1, _CHUNK // n)
    chunks = ((k, min(size, _RESAMPLES - k)) for k in range(0, _RESAMPLES, size))
    return np.concatenate([values.take(_picks(n, first, count), mode="clip").mean(axis=1) for first, count in chunks])


@lru_cache(maxsize=_RESAMPLES * 1000 // _CHUNK)  # all resamples of a test split: 40 MB
def _picks(n: int, first: int, count: int) -> NDArray[np.int32]:
    """Return the indices of the values in the resamples ``first`` to ``first`` + ``count`` − 1: shape (``count``, n)."""
    return _drawn(n, first, count, 0)


def _drawn(n: int, first: int, count: int, key: int) -> NDArray[np.int32]:
    """Draw the indices that `_picks` describes from the stream of a key; key 0 is for episodes."""
    bits = np.random.PCG64(key).advance(first * n)  # NumPy promises the stream of raw bits, not of its distributions
    raw = bits.random_raw(count * n)
    return (((raw >> np.uint64(32)) * np.uint64(n)) >> np.uint64(32)).astype(np.int32).reshape(count, n)


def interquartile_mean(values: NDArray[np.float64]) -> float:
    """Return the mean of the middle half of all values (Agarwal et al., NeurIPS 2021)."""
    ordered = np.sort(values, axis=None)
    cut = len(ordered) // 4
    return float(ordered[cut : len(ordered) - cut].mean())


def paired_p_value(differences: NDArray[np.float64]) -> float:
    """Return the two-sided p-value of the mean of paired differences, by the normal distribution.

    Parameters
    ----------
    differences : ndarray
        Shape (n,): first − second on the same episodes. A few hundred of them are enough for the central limit theorem.
        Differences of at most `ROUNDING` count as 0.
    """
    differences = _beyond_rounding(differences)
    mean, variance = float(differences.mean()), float(differences.var(ddof=1)) / len(differences)
    if variance == 0.0:
        return 1.0 if mean == 0.0 else 0.0
    return math.erfc(abs(mean) / math.sqrt(2 * variance))


def significant(p_values: Sequence[float], level: float = 1 - CONFIDENCE) -> list[bool]:
    """Return which of several tests are significant, corrected for their number (Holm 1979)."""
    found = [False] * len(p_values)
    for rank, k in enumerate(sorted(range(len(p_values)), key=lambda k: p_values[k])):
        if p_values[k] > level / (len(p_values) - rank):
            break
        found[k] = True
    return found


def summarise(landed: NDArray[np.bool_], cr: NDArray[np.float64], cral: NDArray[np.float64]) -> dict[str, Interval]:
    """Return Landed, CR and CRAL over episodes, by name, each with its 95 % confidence interval."""
    return {"landed": proportion_interval(landed), "cr": mean_interval(cr), "cral": mean_interval(cral)}


def mean_over_seeds(values: NDArray[np.float64]) -> Interval:
    """Return the mean score of a method that was trained with several seeds, with its interval over seeds and episodes.

    Each of 10,000 resamples draws episodes and seeds with replacement. A seed is drawn as a whole, since one agent flew all its
    episodes. In the words of rliable (Agarwal et al., NeurIPS 2021), the scenario is a task and each seed is a run.

    Parameters
    ----------
    values : ndarray
        Shape (seeds, n): the scores of each seed on the same n episodes. With one seed, this is `mean_interval`.
    """
    return _percentiles(float(np.mean(values)), _resampled_over_seeds(values, 1))


def difference_over_seeds(first: NDArray[np.float64], second: NDArray[np.float64]) -> Interval:
    """Return the mean of first − second on the same episodes, with its interval over the seeds of both and over episodes.

    Parameters
    ----------
    first, second : ndarray
        Shape (seeds, n): the numbers of seeds may differ, the episodes must be the same.
    """
    mean = float(np.mean(first)) - float(np.mean(second))
    return _percentiles(mean, _resampled_over_seeds(first, 1) - _resampled_over_seeds(second, 2))


def _resampled_over_seeds(values: NDArray[np.float64], key: int) -> NDArray[np.float64]:
    """Return the means of 10,000 samples of seeds and episodes; the episodes sampled do not depend on ``key``."""
    means = np.stack([_resampled_means(each) for each in values])
    seeds = _drawn(len(values), 0, _RESAMPLES, key).T
    return np.take_along_axis(means, seeds, axis=0).mean(axis=0)


def share_over_seeds(successes: NDArray[np.bool_]) -> Interval:
    """Return the share of successes of a method that was trained with several seeds, with its interval over seeds and episodes.

    The interval has two independent parts, Wilson's over episodes and the bootstrap's over seeds, so the squares of their
    lengths add up. It does not shrink to a point when every episode of every seed landed.

    Parameters
    ----------
    successes : ndarray
        Shape (seeds, n): the successes of each seed on the same n episodes. With one seed, this is `proportion_interval`.
    """
    episodes = proportion_interval(successes.mean(axis=0))
    if len(successes) == 1:
        return episodes
    means, share = successes.mean(axis=1), episodes.mean
    seeds = _percentiles(share, means[_drawn(len(means), 0, _RESAMPLES, 1)].mean(axis=1))
    low = share - math.hypot(share - episodes.low, share - seeds.low)
    high = share + math.hypot(episodes.high - share, seeds.high - share)
    return Interval(share, max(0.0, low), min(1.0, high))


@dataclass(frozen=True)
class Comparison:
    """Two agents on the same episodes, in one metric.

    Attributes
    ----------
    difference : Interval
        Mean of first − second over the episodes.
    improvement : Interval
        Probability that the first is better on an episode; a tie counts half. Values that differ by at most `ROUNDING` are
        tied.
    """

    difference: Interval
    improvement: Interval


def compare(first: NDArray[np.float64], second: NDArray[np.float64]) -> Comparison:
    """Compare two agents on the same episodes; both arrays of shape (n,), in the same order."""
    difference = first - second
    return Comparison(mean_interval(difference), mean_interval((np.sign(_beyond_rounding(difference)) + 1) / 2))


def _beyond_rounding(differences: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the differences, with 0 for those of at most `ROUNDING`."""
    return np.where(np.abs(differences) <= ROUNDING, 0.0, differences)
