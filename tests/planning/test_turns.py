"""Turns are counted as a slow oracle counts them, and flights turn less if turns cost moves."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import COVERAGE, maps, scenario

from uavbench import load_scenario
from uavbench.planning import coverage, harvesting
from uavbench.planning.changes import propose
from uavbench.planning.distances import distances_of
from uavbench.planning.flights import landing_numbers, pack
from uavbench.planning.rates import near_rates
from uavbench.planning.turns import turned, turns_of
from uavbench.world.city import city_of

MAP = load_scenario("Manhattan32-CPP-v0")


def quarters(flight):
    """Return the quarter turns of a flight, a sequence of (row, column)."""
    moves = [(r1 - r0, c1 - c0) for (r0, c0), (r1, c1) in pairwise(flight)]
    count = 0
    for first, then in pairwise(moves):
        if (0, 0) not in (first, then):
            count += 0 if first == then else 2 if first == (-then[0], -then[1]) else 1
    return count


@pytest.mark.parametrize("hovers", [True, False])
@settings(max_examples=30)
@given(st.data())
def test_the_price_of_a_change_is_that_of_its_further_turns(hovers, data):
    city = city_of(scenario(data.draw(maps()), COVERAGE))
    cols, cursor = city.shape[1], np.array([data.draw(st.integers(0, 2**32))], dtype=np.uint64)
    paths, lengths = pack(city, [tuple(city.landing_cells[0].tolist())], [80], None, cursor)
    path, length = paths[0], int(lengths[0])
    aims = np.flatnonzero(~city.no_fly.reshape(-1))
    served, new = np.zeros(len(aims), dtype=np.int32), np.empty(40_000, dtype=np.int32)
    for _ in range(200):
        fixed = distances_of(city), city.shape, landing_numbers(city), aims, served, hovers, length + 1, cursor, new
        first, after, size = propose(path, length, 60, *fixed)
        if size < 0:
            continue
        flight = [*path[: first + 1].tolist(), *new[:size].tolist(), *path[after : length + 1].tolist()]
        before = quarters([divmod(cell, cols) for cell in path[: length + 1].tolist()])
        behind = quarters([divmod(cell, cols) for cell in flight])
        assert turns_of(path, length, cols) == before
        price = turned(path, length, 50, first, after, size, new, cols, 0.5)
        too_long = len(flight) - 1 + 0.5 * behind > max(50, length + 0.5 * before)
        assert price == (np.inf if too_long else 0.5 * (behind - before))
        assert turned(path, length, 50, first, after, size, new, cols, 0.0) == 0.0
        path[: len(flight)], length = flight, len(flight) - 1


def test_a_coverage_flight_turns_less_and_its_turns_count_as_moves():
    city, target = city_of(MAP), np.zeros(MAP.shape, dtype=np.float32)
    target[8:24, 4:20] = ~city.building[8:24, 4:20]
    start = tuple(city.landing_cells[0].tolist())
    plans = [coverage.search(MAP, target, [start], [100], seed=1, moves=60_000, turn_cost=cost) for cost in (0.0, 1.0)]
    free, dear = (quarters(plan.flights[0]) for plan in plans)
    assert dear < free / 2
    assert len(plans[1].flights[0]) - 1 + dear <= 99
    assert 0.5 * plans[0].value < plans[1].value < plans[0].value


@pytest.mark.parametrize("large", [False, True])
def test_a_harvesting_flight_turns_less_and_its_turns_count_as_moves(large):
    world = load_scenario("Manhattan32-DH-v0")
    city, rng = city_of(world), np.random.default_rng(3)
    devices = rng.permutation(np.argwhere(~city.building & ~city.landing))[:6].astype(np.int32)
    rates = near_rates(world, devices, city) if large else harvesting.rates_for(world, devices, city)
    start, data = tuple(city.landing_cells[0].tolist()), np.full(6, 20.0)
    plans = [
        harvesting.search(world, rates, devices, data, [start], [90], seed=1, moves=30_000, turn_cost=cost)
        for cost in (0.0, 1.0)
    ]
    free, dear = (quarters(plan.flights[0]) for plan in plans)
    assert dear < 0.7 * free
    assert len(plans[1].flights[0]) - 1 + dear <= 89
    assert plans[1].value > 0.5 * plans[0].value
