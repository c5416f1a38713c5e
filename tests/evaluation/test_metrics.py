"""Means, intervals and comparisons: against the libraries that users know, and as promised."""

import numpy as np
import pytest
from scipy import stats

from uavbench.evaluation.metrics import (
    Interval,
    compare,
    difference_over_seeds,
    mean_interval,
    mean_over_seeds,
    paired_p_value,
    proportion_interval,
    share_over_seeds,
    summarise,
)

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


def test_statistics_without_cities_keep_every_bit():
    """What the functions gave before they knew cities. All sums are exact, so no machine may find another number."""
    one, two = ((np.random.PCG64(key).random_raw(512) >> np.uint64(54)) / 1024 for key in (1, 2))
    runs, others = np.stack([one, two, one * two]), np.stack([two * two, one * one])
    cr = Interval(0.48729705810546875, 0.4623563289642334, 0.5121691703796387)
    cral = Interval(0.49303627014160156, 0.4677865028381348, 0.5181007862091065)
    landed = Interval(0.904296875, 0.8757213408880494, 0.9268508310860258)
    assert summarise(one < 0.9, one, two) == {"landed": landed, "cr": cr, "cral": cral}
    assert (proportion_interval(one < 0.9), mean_interval(one)) == (landed, cr)
    assert mean_interval(one, 0.99) == Interval(0.48729705810546875, 0.4547423362731934, 0.5195578765869138)
    found = compare(one, two)
    assert found.difference == Interval(-0.0057392120361328125, -0.04211649894714355, 0.030338335037231445)
    assert found.improvement == Interval(0.4931640625, 0.44921875, 0.537109375)
    assert mean_over_seeds(runs) == Interval(0.4063074781248967, 0.24166513551026583, 0.5044638315836588)
    assert difference_over_seeds(runs, others) == Interval(0.08258966139207286, -0.08321614996530113, 0.17861569842013222)
    assert share_over_seeds(runs > 0.3) == Interval(0.556640625, 0.3106138764888401, 0.686804271853861)
    assert paired_p_value(one - two) == pytest.approx(0.7531792257155185, rel=1e-14)  # the C library has the last digit


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


def of_seeds(generator, seeds, n, spread=0.05):
    """Scores of so many seeds on the same episodes: some episodes are hard for all, some seeds are bad on all."""
    return 0.6 + generator.normal(0, spread, (seeds, 1)) + generator.normal(0, 0.1, n) + generator.normal(0, 0.05, (seeds, n))


def test_one_seed_is_as_any_result():
    landed = CR > 0.4
    assert mean_over_seeds(CR[None]) == mean_interval(CR)
    assert share_over_seeds(landed[None]) == proportion_interval(landed)
    found, expected = difference_over_seeds(CR[None], CR[None] ** 2), compare(CR, CR**2).difference
    assert (found.mean, found.low, found.high) == pytest.approx((expected.mean, expected.low, expected.high), abs=1e-12)


def test_seeds_have_rliables_interval(monkeypatch):
    """Its runs are seeds, and its task is the scenario; then its tasks are the episodes, where seeds do not differ."""
    monkeypatch.setattr("pandas.util._decorators.deprecate_kwarg", lambda *_: lambda function: function)  # else arch fails
    library = pytest.importorskip("rliable.library", reason="rliable is the oracle: pip install 'uavbench[dev]'")
    mean = lambda scores: np.array([scores.mean()])  # noqa: E731
    scores = of_seeds(np.random.default_rng(3), 7, 400)
    np.random.seed(0)  # noqa: NPY002  which rliable draws from
    runs = np.repeat(scores.mean(axis=1, keepdims=True), 400, axis=1)
    point, theirs = library.get_interval_estimates({"mine": scores.mean(axis=1, keepdims=True)}, mean, reps=10_000)
    found = mean_over_seeds(runs)
    assert found.mean == pytest.approx(point["mine"][0])
    assert (found.low, found.high) == pytest.approx(tuple(theirs["mine"][:, 0]), abs=2e-3)
    alike = np.repeat(scores.mean(axis=0, keepdims=True), 7, axis=0)
    _, theirs = library.get_interval_estimates({"mine": alike}, mean, reps=10_000, task_bootstrap=True)
    found = mean_over_seeds(alike)
    assert (found.low, found.high) == pytest.approx(tuple(theirs["mine"][:, 0]), abs=1e-3)


def test_intervals_over_seeds_cover_what_other_seeds_and_episodes_would_score():
    generator = np.random.default_rng(4)
    found = [mean_over_seeds(of_seeds(generator, 20, 30)) for _ in range(100)]
    covered = sum(interval.low <= 0.6 <= interval.high for interval in found)
    assert 88 <= covered <= 99
    one = [mean_interval(of_seeds(generator, 20, 30).mean(axis=0)) for _ in range(100)]  # which knows nothing of seeds
    assert sum(interval.low <= 0.6 <= interval.high for interval in one) < covered


def test_shares_over_seeds_are_honest():
    every = share_over_seeds(np.ones((5, 100), dtype=np.bool_))
    assert (every.mean, every.high) == (1, 1)
    assert every.low == proportion_interval(np.ones(100, dtype=np.bool_)).low
    mixed = np.arange(100) < np.array([[50], [100], [90]])
    found = share_over_seeds(mixed)
    assert found.mean == pytest.approx(0.8)
    assert 0 <= found.low < 0.65 < 0.95 < found.high <= 1
