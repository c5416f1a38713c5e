"""First flights over stops, against all tours of few stops."""

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import COVERAGE, draw_start, maps, scenario

from uavbench.planning.tours import first_flight
from uavbench.world.city import city_of


def best_prize(city, start, longest, stops, prizes):
    """Return the largest sum of prizes of all orders of all subsets of the stops, within so many moves."""
    away = {cell: city.distances(cell) for cell in {start, *stops}}
    best = 0.0
    for number in range(1, len(stops) + 1):
        for order in itertools.permutations(range(len(stops)), number):
            cells = [start, *(stops[k] for k in order)]
            legs = [int(away[b][a]) for a, b in itertools.pairwise(cells)]
            home = int(city.distance_to_landing[cells[-1]])
            if min(*legs, home) >= 0 and sum(legs) + home <= longest:
                best = max(best, sum(prizes[k] for k in order))
    return best


@settings(max_examples=40)
@given(st.data())
def test_a_small_tour_is_the_best_one(data):
    rows = data.draw(maps())
    city, start = city_of(scenario(rows, COVERAGE)), tuple(draw_start(data, rows))
    cells = [cell for cell in np.ndindex(*city.shape) if not city.no_fly[cell] and cell != start]
    stops = data.draw(st.lists(st.sampled_from(cells), max_size=4, unique=True)) if cells else []
    prizes = np.array(data.draw(st.lists(st.integers(1, 9), min_size=len(stops), max_size=len(stops))), dtype=np.float64)
    budget = data.draw(st.integers(1, 40))
    array = np.array(stops, dtype=np.int32).reshape(-1, 2)
    flight = first_flight(city, start, budget, array, prizes, seed=1, changes=20_000)
    assert flight[0] == start
    assert city.landing[flight[-1]]
    assert len(flight) <= budget
    for a, b in itertools.pairwise(flight):
        assert abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1
        assert not city.no_fly[b]
    visited = sum(prize for stop, prize in zip(stops, prizes, strict=True) if stop in flight)
    assert visited >= best_prize(city, start, budget - 1, stops, prizes)
