"""Statistics over episodes in many cities: against slow oracles, in simulations, and as promised at the edges."""

import math
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from uavbench.evaluation.cities import Spread, spread_over_cities
from uavbench.evaluation.metrics import (
    compare,
    difference_over_seeds,
    mean_interval,
    mean_over_seeds,
    paired_p_value,
    proportion_interval,
    share_over_seeds,
    summarise,
    variance_of_mean,
)
from uavbench.evaluation.resampling import resampled_means

CITIES = 40
CITY = np.arange(5 * CITIES) % CITIES
UNEQUAL = np.array([4, 4, 9, 4, 7, 9, 7, 4, 7, 7, 4])


def scores(generator, between=1.0, city=CITY):
    """Scores with mean 0: some cities are easier than others, and so are some episodes of each city."""
    return generator.normal(0, 1, len(city)) + generator.normal(0, between, city.max() + 1)[city]


def landings(generator):
    """Landings with mean 0.7, for which it matters much in which city they are."""
    return generator.random(len(CITY)) < generator.beta(1.4, 0.6, CITIES)[CITY]


def spans(interval, truth):
    return interval.low <= truth <= interval.high


# Against oracles.


def raw(key, first, count):
    return np.random.PCG64(key).advance(first).random_raw(count)


def one_resample(values, city, number):
    """The mean of a resample of the two-stage bootstrap, drawn with loops from the streams 3 and 4."""
    episodes: dict[int, list[float]] = {}
    for value, where in zip(values.tolist(), city.tolist(), strict=True):
        episodes.setdefault(where, []).append(value)
    cities = list(episodes.values())
    choices = [int(bits) * len(cities) >> 32 for bits in raw(3, 0, (number + 1) * len(cities)) >> 32]
    before = sum(len(cities[choice]) for choice in choices[: number * len(cities)])
    drawn = [cities[choice] for choice in choices[number * len(cities) :]]
    bits = iter((raw(4, before, sum(map(len, drawn))) >> 32).tolist())
    found = [there[next(bits) * len(there) >> 32] for there in drawn for _ in there]
    return math.fsum(found) / len(found)


def test_resamples_draw_cities_and_then_episodes_in_them():
    values = np.random.default_rng(0).random(len(UNEQUAL))
    found = resampled_means(values, UNEQUAL)
    assert found.shape == (10_000,)
    assert found[:200] == pytest.approx([one_resample(values, UNEQUAL, k) for k in range(200)], abs=1e-15)


def test_resamples_are_of_one_stream_however_they_are_drawn():
    city = np.random.default_rng(1).integers(0, 30, 1234)  # 405 resamples are drawn at once
    values = np.random.default_rng(2).random(1234)
    for _ in range(2):
        found = resampled_means(values, city)
        for number in (0, 404, 405, 1000, 9999):
            assert found[number] == pytest.approx(one_resample(values, city, number), abs=1e-14)
        resampled_means(values[:700], city[:700])


def test_the_bootstrap_has_the_variance_of_both_stages():
    values = scores(np.random.default_rng(3))
    there = values.reshape(5, CITIES)  # the columns are cities
    expected = there.mean(axis=0).var() / CITIES + there.var(axis=0).mean() / len(CITY)
    assert resampled_means(values, CITY).var() == pytest.approx(expected, rel=0.05)
    found = mean_interval(values, 0.9, clusters=CITY)
    assert (found.low, found.high) == tuple(np.quantile(resampled_means(values, CITY), ((1 - 0.9) / 2, 1 - (1 - 0.9) / 2)))


def test_the_variance_of_a_mean_is_that_of_a_ratio_of_sums_over_cities():
    values = np.random.default_rng(4).random(len(UNEQUAL))
    mean = math.fsum(values) / 11
    totals = [math.fsum(values[k] - mean for k in range(11) if UNEQUAL[k] == city) for city in (4, 7, 9)]
    expected = 3 / 2 * sum(total**2 for total in totals) / 11**2
    assert variance_of_mean(values, UNEQUAL) == pytest.approx(expected, rel=1e-12)
    difference = abs(mean) / math.sqrt(expected)
    assert paired_p_value(values, clusters=UNEQUAL) == pytest.approx(2 * NormalDist().cdf(-difference), rel=1e-9)


def test_with_cities_of_one_size_the_test_is_that_of_the_cities_means():
    values = scores(np.random.default_rng(5)) + 0.3
    theirs = stats.ttest_1samp(values.reshape(5, CITIES).mean(axis=0), 0.0)
    assert paired_p_value(values, clusters=CITY) == pytest.approx(2 * stats.norm.sf(abs(theirs.statistic)), rel=1e-9)


def test_a_share_has_wilsons_interval_for_the_effective_number():
    alike = (np.arange(CITIES) < 30)[CITY]  # every city is landed in always or never: 40 independent trials, not 200
    found = proportion_interval(alike, clusters=CITY)
    effective = 200 * (CITIES - 1) / 199
    for limit in (found.low, found.high):  # the test of each limit is just about significant
        z = (0.75 - limit) / math.sqrt(limit * (1 - limit) / effective)
        assert abs(z) == pytest.approx(NormalDist().inv_cdf(0.975), rel=1e-9)
    apart = (np.arange(5) < 3).repeat(CITIES)  # every city has three landings of five: less spread than by chance
    assert proportion_interval(apart, clusters=CITY) == proportion_interval(apart)


def test_the_spread_over_cities_counts_each_city_once():
    values = np.array([0.2, 0.4, 0.9, 0.5, 0.5, 0.5])
    assert spread_over_cities(values, np.array([3, 3, 8, 1, 1, 1])) == Spread(
        3,
        pytest.approx((0.3 + 0.9 + 0.5) / 3),
        pytest.approx(np.std([0.3, 0.9, 0.5], ddof=1)),
        pytest.approx(0.3 + 0.2 * (0.5 - 0.3)),
        pytest.approx(0.9 - 0.2 * (0.9 - 0.5)),
    )
    assert spread_over_cities(np.array([0.25, 0.75]), np.array([6, 6])) == Spread(1, 0.5, 0.0, 0.5, 0.5)
    many = np.arange(1000) % 200
    found = spread_over_cities(many / 199, many)
    assert (found.cities, found.mean, found.tenth, found.ninetieth) == pytest.approx((200, 0.5, 0.1, 0.9))


# In simulations, where the truth is known.


def test_intervals_over_cities_cover_the_truth_and_those_over_episodes_do_not():
    generator = np.random.default_rng(6)
    datasets = [scores(generator) for _ in range(300)]
    assert 0.9 <= np.mean([spans(mean_interval(each, clusters=CITY), 0.0) for each in datasets]) <= 0.98
    assert np.mean([spans(mean_interval(each), 0.0) for each in datasets]) < 0.85


def test_intervals_cover_the_truth_where_cities_differ_in_size():
    generator = np.random.default_rng(7)
    city = np.repeat(np.arange(CITIES), generator.integers(1, 10, CITIES))
    datasets = [scores(generator, city=city) for _ in range(300)]
    assert 0.9 <= np.mean([spans(mean_interval(each, clusters=city), 0.0) for each in datasets]) <= 0.98
    assert np.mean([spans(mean_interval(each), 0.0) for each in datasets]) < 0.85


def test_intervals_are_on_the_safe_side_where_cities_do_not_differ():
    generator = np.random.default_rng(8)
    datasets = [scores(generator, between=0.0) for _ in range(100)]
    widths = [[found.high - found.low for found in (mean_interval(x, clusters=CITY), mean_interval(x))] for x in datasets]
    wide, narrow = np.mean(widths, axis=0)
    assert wide / narrow == pytest.approx(math.sqrt(2 - 1 / 5), rel=0.03)


def test_shares_over_cities_cover_the_truth_and_those_over_episodes_do_not():
    generator = np.random.default_rng(9)
    datasets = [landings(generator) for _ in range(1000)]
    assert 0.925 <= np.mean([spans(proportion_interval(each, clusters=CITY), 0.7) for each in datasets]) <= 0.975
    assert np.mean([spans(proportion_interval(each), 0.7) for each in datasets]) < 0.85


def test_the_paired_test_errs_once_in_twenty():
    generator = np.random.default_rng(10)
    datasets = [scores(generator) for _ in range(2000)]
    assert 0.04 <= np.mean([paired_p_value(each, clusters=CITY) < 0.05 for each in datasets]) <= 0.075
    assert np.mean([paired_p_value(each) < 0.05 for each in datasets]) > 0.2


def test_intervals_over_seeds_and_cities_cover_the_truth():
    generator = np.random.default_rng(11)

    def runs():
        return scores(generator) + generator.normal(0, 0.1, (5, 1)) + generator.normal(0, 0.2, (5, len(CITY)))

    datasets = [runs() for _ in range(100)]
    assert 0.9 <= np.mean([spans(mean_over_seeds(each, clusters=CITY), 0.0) for each in datasets]) <= 0.99
    assert np.mean([spans(mean_over_seeds(each), 0.0) for each in datasets]) < 0.88
    found = [difference_over_seeds(each, np.zeros((1, len(CITY))), clusters=CITY) for each in datasets]
    assert 0.9 <= np.mean([spans(each, 0.0) for each in found]) <= 0.99


# As promised.


def test_comparisons_over_cities_are_paired():
    first = scores(np.random.default_rng(12))
    second = first - 0.01  # far less than the spread of scores: only pairing can see it
    found = compare(first, second, clusters=CITY)
    assert (found.difference.low, found.difference.high) == pytest.approx((0.01, 0.01))
    assert (found.improvement.mean, found.improvement.low) == (1, 1)
    seeds = difference_over_seeds(np.stack([first, first]), np.stack([second]), clusters=CITY)
    assert (seeds.low, seeds.high) == pytest.approx((0.01, 0.01))
    other = scores(np.random.default_rng(13))
    found, expected = compare(first, other, clusters=CITY), mean_interval(first - other, clusters=CITY)
    assert found.difference == expected
    better = mean_interval((first > other).astype(np.float64), clusters=CITY)
    assert (found.improvement.low, found.improvement.high) == (better.low, better.high)


def test_summaries_and_single_seeds_have_the_intervals_over_cities():
    cral = np.random.default_rng(14).random(len(CITY))
    landed = landings(np.random.default_rng(15))
    found = summarise(landed, cral**0.5, cral, clusters=CITY)
    assert found["landed"] == proportion_interval(landed, clusters=CITY) != proportion_interval(landed)
    assert found["cr"] == mean_interval(cral**0.5, clusters=CITY) != mean_interval(cral**0.5)
    assert found["cral"] == mean_interval(cral, clusters=CITY)
    assert mean_over_seeds(cral[None], clusters=CITY) == found["cral"]
    assert share_over_seeds(landed[None], clusters=CITY) == found["landed"]


def test_shares_over_seeds_and_cities_add_up():
    generator = np.random.default_rng(16)
    alike = np.repeat(landings(generator)[None], 3, axis=0)  # seeds do not differ: only cities and episodes count
    assert share_over_seeds(alike, clusters=CITY).low == pytest.approx(proportion_interval(alike[0], clusters=CITY).low)
    mixed = np.stack([landings(generator) for _ in range(3)])
    found, episodes = share_over_seeds(mixed, clusters=CITY), share_over_seeds(mixed)
    assert found.low < episodes.low < found.mean < episodes.high < found.high


def test_where_all_landed_episodes_count_as_independent():
    every = np.ones(len(CITY), dtype=np.bool_)
    assert proportion_interval(every, clusters=CITY) == proportion_interval(every)
    thirds = np.full(len(CITY), 2 / 3)  # one of three seeds never landed
    assert proportion_interval(thirds, clusters=CITY) == proportion_interval(thirds)


def test_differences_that_cancel_in_every_city_are_no_difference():
    for each in ([0.1, 0.2, -0.3], [0.3, 0.6, -0.9]):  # their mean is no 0, but rounding
        assert paired_p_value(np.tile(each, 20), clusters=np.repeat(np.arange(20), 3)) == 1.0
    assert paired_p_value(np.ones(6), clusters=np.repeat(np.arange(3), 2)) == 0.0
    assert paired_p_value(np.full(6, 1e-12), clusters=np.repeat(np.arange(3), 2)) == 1.0


@pytest.mark.parametrize("clusters", [CITY[:-1], CITY[:, None], np.array([], dtype=np.int64)])
def test_there_is_a_city_for_each_episode(clusters):
    values = np.ones(len(CITY))
    for function in (mean_interval, proportion_interval, paired_p_value):
        with pytest.raises(ValueError, match="there are 200 episodes"):
            function(values, clusters=clusters)


@st.composite
def episodes(draw):
    """Scores of a few episodes, and the city of each."""
    n = draw(st.integers(1, 30))
    values = np.array(draw(st.lists(st.integers(0, 1024), min_size=n, max_size=n))) / 1024
    return values, np.array(draw(st.lists(st.integers(0, 5), min_size=n, max_size=n)))


def every_statistic(values, clusters):
    """All that takes ``clusters``, of one agent and of two."""
    other = values[::-1]
    runs = np.stack([values, other, values**2])
    found = [*summarise(values > 0.3, values, values**2, clusters=clusters).values()]
    found += [compare(values, other, clusters=clusters), mean_over_seeds(runs, clusters=clusters)]
    found += [difference_over_seeds(runs, runs[:2], clusters=clusters), share_over_seeds(runs > 0.3, clusters=clusters)]
    return [*found, *([paired_p_value(values - other, clusters=clusters)] if len(values) > 1 else [])]


@settings(max_examples=15, deadline=None)
@given(episodes(), st.permutations(range(6)), st.integers(-(2**40), 2**40))
def test_the_names_of_cities_do_not_matter(data, names, shift):
    values, city = data
    renamed = np.array(names)[city] * 1000 + shift
    assert every_statistic(values, city) == every_statistic(values, renamed)
    assert spread_over_cities(values, city) == spread_over_cities(values, renamed)


@settings(max_examples=25, deadline=None)
@given(episodes())
def test_the_order_of_cities_is_that_of_their_first_episodes(data):
    values, city = data
    places = [k for name in dict.fromkeys(city.tolist()) for k in np.flatnonzero(city == name).tolist()]
    if 1 < len(set(city.tolist())) < len(city):
        assert np.array_equal(resampled_means(values, city), resampled_means(values[places], city[places]))


@settings(max_examples=15, deadline=None)
@given(episodes(), st.integers(-5, 5), st.randoms(use_true_random=False))
def test_one_city_and_a_city_for_every_episode_are_as_no_cities(data, name, random):
    values, _ = data
    without = every_statistic(values, None)
    assert every_statistic(values, np.full(len(values), name)) == without
    names = list(range(name, name + len(values)))
    random.shuffle(names)
    assert every_statistic(values, np.array(names)) == without


@settings(max_examples=100, deadline=None)
@given(episodes())
def test_cities_never_make_the_interval_of_a_share_narrower(data):
    values, city = data
    found, without = proportion_interval(values > 0.3, clusters=city), proportion_interval(values > 0.3)
    assert found.mean == without.mean
    assert 0 <= found.low <= without.low + 1e-12
    assert without.high - 1e-12 <= found.high <= 1


@settings(max_examples=50, deadline=None)
@given(episodes())
def test_p_values_are_probabilities_and_alike_from_both_sides(data):
    values, city = data
    if len(values) > 1:
        found = paired_p_value(values - 0.5, clusters=city)
        assert 0 <= found <= 1
        assert found == paired_p_value(0.5 - values, clusters=city)


@settings(max_examples=15, deadline=None)
@given(episodes())
def test_means_of_resamples_stay_between_the_lowest_and_the_highest_score(data):
    values, city = data
    found = resampled_means(values, city)
    assert values.min() - 1e-12 <= found.min() <= values.mean() + 1e-12
    assert values.mean() - 1e-12 <= found.max() <= values.max() + 1e-12
    spread = spread_over_cities(values, city)
    assert values.min() <= spread.tenth <= spread.ninetieth <= values.max()
    assert spread.cities == len(set(city.tolist()))


def test_a_single_episode_has_statistics():
    one = np.array([7])
    found = summarise(np.array([True]), np.array([0.5]), np.array([0.25]), clusters=one)
    assert (found["cr"].low, found["cr"].high) == (0.5, 0.5)
    assert 0 < found["landed"].low < found["landed"].high == 1
    assert compare(np.array([0.5]), np.array([0.25]), clusters=one).difference.mean == 0.25
    assert spread_over_cities(np.array([0.25]), one) == Spread(1, 0.25, 0.0, 0.25, 0.25)
