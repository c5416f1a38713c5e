"""Keyed random numbers: the published hash, the right distributions, independent streams."""

from statistics import NormalDist

import numpy as np
import oracle
import pytest
from scipy import stats

from uavbench.world import keyed

GOLDEN = 0x9E3779B97F4A7C15


def test_is_splitmix64():
    """The first outputs for seed 1234567, as published with the reference implementation."""
    cursor = np.array([1234567], dtype=np.uint64)
    assert [int(keyed.next_bits(cursor)) for _ in range(3)] == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
    ]


@pytest.mark.parametrize("key", [0, 1, 2**62, 2**64 - 1, 12345678901234567890])
def test_streams_are_those_of_the_oracle(key):
    for purpose in (1, 2, 3, 77):
        assert int(keyed.stream(np.uint64(key), np.uint64(purpose))) == oracle.stream(key, purpose)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 1000])
def test_integers_are_uniform(count):
    cursor = np.array([5], dtype=np.uint64)
    drawn = np.array([keyed.next_integer(cursor, count) for _ in range(20_000)])
    assert drawn.min() == 0
    assert drawn.max() == count - 1
    if count > 1:
        assert stats.chisquare(np.bincount(drawn, minlength=count)).pvalue > 0.001


def test_uniform_numbers_fill_their_interval():
    cursor = np.array([6], dtype=np.uint64)
    drawn = np.array([keyed.next_uniform(cursor, 5.0, 20.0) for _ in range(20_000)])
    assert stats.kstest(drawn, stats.uniform(5, 15).cdf).pvalue > 0.001


def test_the_normal_quantile_is_exact_to_the_last_digits():
    generator = np.random.default_rng(0)
    tails = 10.0 ** -generator.uniform(1, 15, 3000)
    for p in np.concatenate([generator.random(3000), tails, 1 - tails, [2.0**-54, 1 - 2.0**-53, 0.5]]):
        expected = NormalDist().inv_cdf(p)
        assert keyed.normal_quantile(p) == pytest.approx(expected, rel=1e-14, abs=1e-15)


EXTREMES = [0, 1, 2**11 - 1, 2**11, 2**58 - 1, 2**58, 2**63, 2**64 - 2**11, 2**64 - 1]


def test_all_bits_give_a_finite_normal_number_that_its_bound_is_not_below():
    generator = np.random.default_rng(1)
    drawn = [int(n) for n in generator.integers(0, 2**64, 20_000, dtype=np.uint64)]
    edges = [(n << 58) + d for n in range(64) for d in (0, 2**58 - 1)]
    for bits in np.array([*EXTREMES, *drawn, *edges], dtype=np.uint64):
        number = keyed.normal_of(bits)
        assert np.isfinite(number)
        assert number <= keyed.normal_above(bits)


def test_more_bits_give_no_smaller_normal_number():
    ordered = np.sort(np.concatenate([np.random.default_rng(2).integers(0, 2**64, 5000, dtype=np.uint64), np.uint64(EXTREMES)]))
    assert (np.diff([keyed.normal_of(bits) for bits in ordered]) >= 0).all()


def test_normal_numbers_are_normal_and_independent_of_their_neighbours():
    start = np.uint64(keyed.stream(np.uint64(9), keyed.NOISE))
    drawn = np.array([keyed.normal(start, k) for k in range(40_000)])
    assert stats.kstest(drawn, stats.norm.cdf).pvalue > 0.001
    assert abs(np.corrcoef(drawn[:-1], drawn[1:])[0, 1]) < 0.02
    other = np.uint64(keyed.stream(np.uint64(10), keyed.NOISE))
    assert abs(np.corrcoef(drawn, [keyed.normal(other, k) for k in range(40_000)])[0, 1]) < 0.02
