"""How the scores of an agent differ between the cities of a scenario."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavbench.evaluation.resampling import in_order


@dataclass(frozen=True)
class Spread:
    """How the mean score differs between cities. Every city counts once, however many episodes it has.

    The means of cities differ by chance too: with few episodes in each city, the spread is larger than that of the cities.

    Attributes
    ----------
    cities : int
        The number of cities.
    mean : float
        The mean over cities of each city's mean over its episodes.
    deviation : float
        The standard deviation of the cities' means (with C − 1); 0 for a single city.
    tenth, ninetieth : float
        The quantiles 0.1 and 0.9 of the cities' means: one city in ten has a lower mean, and one in ten a higher one.
    """

    cities: int
    mean: float
    deviation: float
    tenth: float
    ninetieth: float


def spread_over_cities(values: NDArray[np.float64], clusters: NDArray[np.int64]) -> Spread:
    """Return how much the mean score differs between cities.

    Parameters
    ----------
    values : ndarray
        Shape (n,), float64: the score of each episode.
    clusters : ndarray
        Shape (n,), int64: the city of each episode.
    """
    city = in_order(clusters)
    means = np.bincount(city, weights=values) / np.bincount(city)
    tenth, ninetieth = np.quantile(means, (0.1, 0.9))
    deviation = float(means.std(ddof=1)) if len(means) > 1 else 0.0
    return Spread(len(means), float(means.mean()), deviation, float(tenth), float(ninetieth))
