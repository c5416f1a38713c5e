"""Statistics over episodes: means with confidence intervals, and paired comparisons.

Landed is a proportion and gets Wilson's interval, which does not shrink to a point when every episode landed; CR and CRAL get
the percentile bootstrap. Resampling is keyed, so that the same scores give the same interval everywhere.

Episodes of one city are alike, because some cities are harder than others. Where a scenario has many cities, 1,000 episodes in
200 of them tell less about other cities than 1,000 episodes in 1,000 cities would. So whatever gives an interval or a p-value
takes ``clusters``, the city of each episode. Without them, episodes count as independent, which is right where all episodes fly
in the same city. With one city only, and with another city in every episode, the results are those without ``clusters``. A few
dozen cities are needed: with less than about twenty, all intervals over cities are too narrow.

- **Means** have the two-stage bootstrap, which draws cities, then episodes in the cities drawn (Davison and Hinkley 1997,
  section 3.8). It is on the safe side: the spread of the episodes within a city counts in both stages. Where cities do not
  differ at all, an interval with m episodes in each city is too wide by a factor of up to √(2 − 1/m).
- **Shares** have Wilson's interval for the effective number of episodes. That is their number, divided by the design effect
  (Kish 1965): how many times larger the variance of the share is than if the episodes were independent.
- **Paired tests** have the variance that `variance_of_mean` gives.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from uavbench.evaluation.resampling import RESAMPLES, clusters_of, drawn, resampled_means
from uavbench.world.scenario import Scenario

#: The metrics of an episode (the paper's Table III).
METRICS = ("landed", "cr", "cral")
#: Their names in tables and figures.
NAMES = {"landed": "Landed", "cr": "CR", "cral": "CRAL"}
CONFIDENCE = 0.95
#: Scores that differ by at most this count as equal: two platforms' logarithms differ in their last digits.
ROUNDING = 1e-6
#: What is less than this is no standard error, but the rounding of sums: a single score that differs by more than `ROUNDING`
#: has a larger one, in as many as 10⁸ episodes.
_NOISE = 1e-14


def tolerance(scenario: Scenario) -> float:
    """Return by how much two scores of a scenario may differ and still count as equal: 0 where its mission is exact."""
    return 0.0 if scenario.mission.exact else ROUNDING


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence interval, all as fractions."""

    mean: float
    low: float
    high: float


def proportion_interval(
    successes: NDArray[np.bool_ | np.float64], confidence: float = CONFIDENCE, *, clusters: NDArray[np.int64] | None = None
) -> Interval:
    """Return the share of successes with Wilson's score interval (Wilson 1927).

    Parameters
    ----------
    successes : ndarray
        Shape (n,): whether each trial succeeded. For groups of trials that depend on each other, give the share of each group
        that succeeded: a group then counts as one trial, so that the dependence does not make the interval too narrow.
    confidence : float, optional
    clusters : ndarray, optional
        Shape (n,), int64: the city of each trial. The interval is then that of fewer trials: n, divided by the design effect.
    """
    n, share = _effective_number(successes, clusters), float(np.mean(successes))
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    centre = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return Interval(share, min(share, max(0.0, centre - half)), max(share, min(1.0, centre + half)))


def _effective_number(successes: NDArray[np.bool_ | np.float64], clusters: NDArray[np.int64] | None) -> float:
    """Return how many independent trials tell as much about the share as these do: at most as many as there are.

    Where all trials succeeded, or all failed, they do not show how alike the trials of a city are, and count as independent.
    """
    n = len(successes)
    if clusters_of(n, clusters) is None:
        return n
    values = successes.astype(np.float64)
    independent = variance_of_mean(values)
    return n if independent < _NOISE**2 else n / max(1.0, variance_of_mean(values, clusters) / independent)


def variance_of_mean(values: NDArray[np.float64], clusters: NDArray[np.int64] | None = None) -> float:
    """Return the variance of a mean, the square of its standard error.

    With clusters, it is that of the ratio of two sums over cities, the scores and the numbers of episodes (the linearised
    variance of a ratio estimator; Kish 1965, section 6.3): C / (C − 1) · Σ tᵢ² / n², with C cities, and tᵢ the sum over the
    episodes of city i of their deviations from the mean of all n.

    Parameters
    ----------
    values : ndarray
        Shape (n,), float64, n > 1.
    clusters : ndarray, optional
        Shape (n,), int64: the city of each value.
    """
    n, cities = len(values), clusters_of(len(values), clusters)
    if cities is None:
        return float(values.var(ddof=1)) / n
    totals = np.bincount(cities.number, weights=values - values.mean())
    return len(totals) / (len(totals) - 1) * float((totals * totals).sum()) / n**2


def mean_interval(
    values: NDArray[np.float64], confidence: float = CONFIDENCE, *, clusters: NDArray[np.int64] | None = None
) -> Interval:
    """Return the mean with its percentile-bootstrap interval (Efron 1979; 10,000 resamples).

    Parameters
    ----------
    values : ndarray
        Shape (n,), float64.
    confidence : float, optional
    clusters : ndarray, optional
        Shape (n,), int64: the city of each value. Each resample then draws cities, and episodes in them.
    """
    return _percentiles(float(np.mean(values)), resampled_means(values, clusters), confidence)


def _percentiles(mean: float, resampled: NDArray[np.float64], confidence: float = CONFIDENCE) -> Interval:
    """Return the percentile-bootstrap interval of a mean, from means of resamples."""
    tail = (1 - confidence) / 2
    low, high = np.quantile(resampled, (tail, 1 - tail))
    return Interval(mean, float(low), float(high))


def interquartile_mean(values: NDArray[np.float64]) -> float:
    """Return the mean of the middle half of all values (Agarwal et al., NeurIPS 2021)."""
    ordered = np.sort(values, axis=None)
    cut = len(ordered) // 4
    return float(ordered[cut : len(ordered) - cut].mean())


def paired_p_value(differences: NDArray[np.float64], *, clusters: NDArray[np.int64] | None = None) -> float:
    """Return the two-sided p-value of the mean of paired differences, by the normal distribution.

    Parameters
    ----------
    differences : ndarray
        Shape (n,): first − second on the same episodes. A few hundred of them are enough for the central limit theorem.
        Differences of at most `ROUNDING` count as 0.
    clusters : ndarray, optional
        Shape (n,), int64: the city of each episode. The central limit theorem then needs a few dozen cities.
    """
    differences = _beyond_rounding(differences)
    mean, variance = float(differences.mean()), variance_of_mean(differences, clusters)
    if variance < _NOISE**2:
        return 1.0 if abs(mean) < _NOISE else 0.0
    return math.erfc(abs(mean) / math.sqrt(2 * variance))


def significant(p_values: Sequence[float], level: float = 1 - CONFIDENCE) -> list[bool]:
    """Return which of several tests are significant, corrected for their number (Holm 1979)."""
    found = [False] * len(p_values)
    for rank, k in enumerate(sorted(range(len(p_values)), key=lambda k: p_values[k])):
        if p_values[k] > level / (len(p_values) - rank):
            break
        found[k] = True
    return found


def summarise(
    landed: NDArray[np.bool_],
    cr: NDArray[np.float64],
    cral: NDArray[np.float64],
    *,
    clusters: NDArray[np.int64] | None = None,
) -> dict[str, Interval]:
    """Return Landed, CR and CRAL over episodes, by name, each with its 95 % confidence interval.

    Parameters
    ----------
    landed, cr, cral : ndarray
        Shape (n,): the scores of each episode.
    clusters : ndarray, optional
        Shape (n,), int64: the city of each episode.
    """
    means = {name: mean_interval(values, clusters=clusters) for name, values in (("cr", cr), ("cral", cral))}
    return {"landed": proportion_interval(landed, clusters=clusters), **means}


def mean_over_seeds(values: NDArray[np.float64], *, clusters: NDArray[np.int64] | None = None) -> Interval:
    """Return the mean score of a method that was trained with several seeds, with its interval over seeds and episodes.

    Each of 10,000 resamples draws episodes and seeds with replacement. A seed is drawn as a whole, since one agent flew all its
    episodes. In the words of rliable (Agarwal et al., NeurIPS 2021), the scenario is a task and each seed is a run.

    Parameters
    ----------
    values : ndarray
        Shape (seeds, n): the scores of each seed on the same n episodes. With one seed, this is `mean_interval`.
    clusters : ndarray, optional
        Shape (n,), int64: the city of each episode.
    """
    return _percentiles(float(np.mean(values)), _resampled_over_seeds(values, 1, clusters))


def difference_over_seeds(
    first: NDArray[np.float64], second: NDArray[np.float64], *, clusters: NDArray[np.int64] | None = None
) -> Interval:
    """Return the mean of first − second on the same episodes, with its interval over the seeds of both and over episodes.

    Parameters
    ----------
    first, second : ndarray
        Shape (seeds, n): the numbers of seeds may differ, the episodes must be the same.
    clusters : ndarray, optional
        Shape (n,), int64: the city of each episode.
    """
    mean = float(np.mean(first)) - float(np.mean(second))
    return _percentiles(mean, _resampled_over_seeds(first, 1, clusters) - _resampled_over_seeds(second, 2, clusters))


def _resampled_over_seeds(values: NDArray[np.float64], key: int, clusters: NDArray[np.int64] | None) -> NDArray[np.float64]:
    """Return the means of 10,000 samples of seeds and episodes; the episodes sampled do not depend on ``key``."""
    means = np.stack([resampled_means(each, clusters) for each in values])
    seeds = drawn(len(values), 0, RESAMPLES, key).T
    return np.take_along_axis(means, seeds, axis=0).mean(axis=0)


def share_over_seeds(successes: NDArray[np.bool_], *, clusters: NDArray[np.int64] | None = None) -> Interval:
    """Return the share of successes of a method that was trained with several seeds, with its interval over seeds and episodes.

    The interval has two independent parts, Wilson's over episodes and the bootstrap's over seeds, so the squares of their
    lengths add up. It does not shrink to a point when every episode of every seed landed.

    Parameters
    ----------
    successes : ndarray
        Shape (seeds, n): the successes of each seed on the same n episodes. With one seed, this is `proportion_interval`.
    clusters : ndarray, optional
        Shape (n,), int64: the city of each episode.
    """
    episodes = proportion_interval(successes.mean(axis=0), clusters=clusters)
    if len(successes) == 1:
        return episodes
    means, share = successes.mean(axis=1), episodes.mean
    seeds = _percentiles(share, means[drawn(len(means), 0, RESAMPLES, 1)].mean(axis=1))
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


def compare(
    first: NDArray[np.float64], second: NDArray[np.float64], *, clusters: NDArray[np.int64] | None = None
) -> Comparison:
    """Compare two agents on the same episodes.

    Parameters
    ----------
    first, second : ndarray
        Shape (n,), float64: the scores of both agents, in the same order of episodes.
    clusters : ndarray, optional
        Shape (n,), int64: the city of each episode.
    """
    difference = first - second
    better = (np.sign(_beyond_rounding(difference)) + 1) / 2
    return Comparison(mean_interval(difference, clusters=clusters), mean_interval(better, clusters=clusters))


def _beyond_rounding(differences: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the differences, with 0 for those of at most `ROUNDING`."""
    return np.where(np.abs(differences) <= ROUNDING, 0.0, differences)
