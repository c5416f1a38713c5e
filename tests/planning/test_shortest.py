"""Searches for single paths, against the distances in the whole city."""

import numpy as np
from hypothesis import given, settings
from worlds import COVERAGE, maps, scenario

from uavbench import load_scenario
from uavbench.planning.shortest import grid_of, moves_between, straight
from uavbench.world.city import city_of


def check(city, heres, theres):
    grid, cols = grid_of(city), city.shape[1]
    for there in theres:
        away = city.distances(divmod(there, cols)).reshape(-1)
        for here in heres:
            assert moves_between(grid, here, there) == away[here]
            assert away[here] < 0 or straight(here, there, cols) <= away[here]


@settings(max_examples=40)
@given(maps())
def test_every_pair_of_a_small_map(rows):
    city = city_of(scenario(rows, COVERAGE))
    free = np.flatnonzero(~city.no_fly.reshape(-1)).tolist()
    check(city, free, free)


def test_some_pairs_of_a_city():
    city = city_of(load_scenario("Helsinki50-CPP-v0"))
    free = np.flatnonzero(~city.no_fly.reshape(-1))
    rng = np.random.default_rng(0)
    check(city, rng.choice(free, 100).tolist(), rng.choice(free, 40).tolist())
