"""Tours through zones, against all orders of few zones."""

import itertools

import numpy as np
import pytest

from uavbench import load_scenario
from uavbench.planning.shortest import grid_of
from uavbench.planning.zone_tours import Field, Zones, best_order, best_ways, tour_within, whole_tour
from uavbench.world.city import city_of


def test_the_order_is_short():
    """Local search is within a few per cent of the best of all orders."""
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(30):
        number = int(rng.integers(1, 7))
        enter, leave = rng.integers(0, 30, (2, number, 4, 2))
        first = enter.sum(axis=2)
        between = np.abs(leave[:, :, None, None] - enter[None, None]).sum(axis=4)
        last = leave.sum(axis=2)
        order, ways = best_order(first, between, last)
        assert sorted(order.tolist()) == list(range(number))
        visits = list(zip(order.tolist(), ways.tolist(), strict=True))
        length = first[visits[0]] + sum(between[(*a, *b)] for a, b in itertools.pairwise(visits)) + last[visits[-1]]
        orders = itertools.permutations(range(number))
        ratios.append(length / min(best_ways(np.array(each), first, between, last)[0] for each in orders))
    assert min(ratios) >= 1.0
    assert np.mean(ratios) < 1.03


def drawn(rng, number):
    """Return a field in a city, and zones that are swept in one of two directions."""
    city = city_of(load_scenario("Urban50-CPP-v0"))
    free = np.flatnonzero(city.distance_to_landing.reshape(-1) >= 0)
    ends = rng.choice(free, (2, number))
    enter, leave = np.stack(ends, axis=1), np.stack(ends[::-1], axis=1)
    within = np.array([city.distances(divmod(int(a), 50))[divmod(int(b), 50)] for a, b in ends.T])
    zones = Zones(enter, leave, np.stack([within, within], axis=1).astype(np.int64), rng.integers(1, 50, number))
    start = tuple(city.landing_cells[0].tolist())
    return Field(city, grid_of(city), start[0] * 50 + start[1]), zones


def length_of(field, zones, tour):
    """Return the moves of a tour from the start to a landing zone."""
    here, moves = field.start, 0
    for zone, way in zip(*(each.tolist() for each in tour), strict=True):
        there = int(zones.enter[zone, way])
        moves += field.city.distances(divmod(here, 50))[divmod(there, 50)] + zones.within[zone, way]
        here = int(zones.leave[zone, way])
    return moves + field.home[here]


def test_a_tour_through_all_zones_is_about_as_short_as_that_of_the_longer_search():
    rng, ratios = np.random.default_rng(1), []
    for number in range(1, 16):
        field, zones = drawn(rng, number)
        whole, within = whole_tour(field, zones), tour_within(field, zones, 10**6)
        for order, _ in (whole, within):
            assert sorted(order.tolist()) == list(range(number))
        ratios.append(length_of(field, zones, within) / length_of(field, zones, whole))
    assert np.mean(ratios) < 1.1


@pytest.mark.parametrize("budget", [1, 60, 200, 500])
def test_a_tour_is_as_long_as_the_budget_allows_and_one_zone_more(budget):
    rng = np.random.default_rng(budget)
    field, zones = drawn(rng, 60)
    order, ways = tour_within(field, zones, budget)
    assert len(set(order.tolist())) == len(order) < 60
    assert length_of(field, zones, (order, ways)) > budget
    worth = zones.worth[order].sum()
    assert worth > np.sort(zones.worth)[: len(order)].sum()
