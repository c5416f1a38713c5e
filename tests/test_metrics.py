"""Means, intervals and comparisons: against the libraries that users know, and as promised."""

import numpy as np
import pytest
from scipy import stats

from uavbench.metrics import compare, mean_interval, proportion_interval, summarise

CR = np.random.default_rng(0).beta(5, 2, 1000)


@pytest.mark.parametrize(("successes", "n"), [(0, 20), (1, 20), (13, 20), (985, 1000), (1000, 1000)])
def test_landed_has_wilsons_interval(successes, n):
    found = proportion_interval(np.arange(n) < successes)
    theirs = stats.binomtest(successes, n).proportion_ci(method="wilson")
    assert found.mean == successes / n
    assert (found.low, found.high) == pytest.approx((theirs.low, theirs.high), abs=1e-12)


@pytest.mark.parametrize("n", [1, 60, 1234])
def test_resamples_are_of_one_stream_however_they_are_drawn(n):
    raw = np.random.PCG64(0).random_raw(10_000 * n).reshape(-1, n)
    values = np.random.default_rng(1).random(n)
    expected = np.quantile(values[((raw >> 32) * n) >> 32].mean(axis=1), (0.025, 0.975))
    for _ in range(2):
        found = mean_interval(values)
        assert (found.low, found.high) == tuple(expected)
        mean_interval(np.ones(700))


def test_means_have_the_bootstrap_interval():
    found = mean_interval(CR)
    theirs = stats.bootstrap((CR,), np.mean, method="percentile", n_resamples=10_000, rng=1).confidence_interval
    assert found.mean == CR.mean()
    assert (found.low, found.high) == pytest.approx((theirs.low, theirs.high), abs=1e-3)


def test_intervals_cover_the_truth_95_times_in_100():
    generator = np.random.default_rng(1)
    covered = sum(
        interval.low <= 5 / 7 <= interval.high for interval in (mean_interval(generator.beta(5, 2, 60)) for _ in range(200))
    )
    assert stats.binomtest(covered, 200, 0.95).pvalue > 0.001


def test_the_same_episodes_give_the_same_interval():
    assert mean_interval(CR) == mean_interval(CR.copy())


def test_a_single_episode_has_an_interval():
    found = summarise(np.array([True]), np.array([0.5]), np.array([0.5]))
    assert (found["cr"].low, found["cr"].high) == (0.5, 0.5)
    assert 0 < found["landed"].low < 1
    assert found["landed"].high == 1


def test_comparisons_are_paired():
    worse = CR - 0.01  # far less than the spread of CR: only pairing can see it
    found = compare(CR, worse)
    assert found.difference.mean == pytest.approx(0.01)
    assert found.difference.low > 0
    assert (found.improvement.mean, found.improvement.low) == (1, 1)
    again = compare(worse, CR)
    assert again.difference.high < 0
    assert again.improvement.mean == 0


def test_ties_count_half():
    found = compare(np.array([1.0, 0.0, 0.5, 0.5]), np.array([0.0, 0.0, 0.5, 1.0]))
    assert found.improvement.mean == (1 + 0.5 + 0.5 + 0) / 4
    rounding = compare(np.array([0.5 + 9e-7, 0.5 - 1e-12, 0.5 + 2e-6]), np.full(3, 0.5))
    assert rounding.improvement.mean == (0.5 + 0.5 + 1) / 3
