"""Proposed changes lead to flights that are possible, and differ from the flight before."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import COVERAGE, maps, scenario

from uavbench import load_scenario
from uavbench.planning.changes import propose
from uavbench.planning.coverage import search
from uavbench.planning.distances import distances_of
from uavbench.planning.flights import landing_numbers, pack
from uavbench.simulation.simulator import Simulator
from uavbench.world.city import city_of


@pytest.mark.parametrize("hovers", [True, False])
@settings(max_examples=40)
@given(st.data())
def test_changed_flights_move_from_neighbour_to_neighbour_and_land_in_time(hovers, data):
    city = city_of(scenario(data.draw(maps()), COVERAGE))
    cols, landing = city.shape[1], landing_numbers(city)
    cursor = np.array([data.draw(st.integers(0, 2**32))], dtype=np.uint64)
    longest = data.draw(st.integers(2, 60))
    start = tuple(city.landing_cells[0].tolist())
    paths, lengths = pack(city, [start], [80], None, cursor)
    path, length = paths[0], int(lengths[0])
    aims = np.flatnonzero(~city.no_fly.reshape(-1))
    served, new = np.zeros(len(aims), dtype=np.int32), np.empty(40_000, dtype=np.int32)
    for _ in range(300):
        fixed = distances_of(city), city.shape, landing, aims, served, hovers, length + 1, cursor, new
        first, after, size = propose(path, length, longest, *fixed)
        if size < 0:
            continue
        old = path[first + 1 : after].tolist()
        assert old != new[:size].tolist()
        flight = [*path[: first + 1].tolist(), *new[:size].tolist(), *path[after : length + 1].tolist()]
        assert len(flight) - 1 <= longest
        assert flight[0] == path[0]
        assert flight[-1] in landing
        for here, there in pairwise(flight):
            down, right = there // cols - here // cols, there % cols - here % cols
            assert abs(down) + abs(right) == 1 or (hovers and here == there)
        assert not city.no_fly.reshape(-1)[flight].any()
        if old and size > 0:  # what remains the same is left out
            assert old[0] != new[0]
            assert old[-1] != new[size - 1]
        path[: len(flight)], length = flight, len(flight) - 1


@pytest.mark.parametrize("name", ["Manhattan32-CPP-v0", "Urban50-CPP-v0"])
def test_a_flight_that_uses_its_budget_can_nearly_always_be_changed(name):
    """A search that is only told that a change is impossible learns nothing."""
    world = load_scenario(name)
    city = city_of(world)
    simulator = Simulator(world, 1)
    simulator.reset([0], "validation", [0])
    start, budget = tuple(simulator.state.position[0, 0].tolist()), int(simulator.state.budget[0, 0])
    target = simulator.state.target[0]
    plan = search(world, target, [start], [budget], seed=1, moves=20_000)
    cursor = np.array([1], dtype=np.uint64)
    paths, lengths = pack(city, [start], [budget], plan.flights, cursor)
    assert lengths[0] >= budget - 3
    aims = np.flatnonzero(target > 0)
    served, new = np.zeros(len(aims), dtype=np.int32), np.empty(40_000, dtype=np.int32)
    fixed = distances_of(city), city.shape, landing_numbers(city), aims, served, False, int(lengths[0]) + 1, cursor, new
    sizes = [propose(paths[0], int(lengths[0]), budget - 1, *fixed)[2] for _ in range(2000)]
    assert np.mean(np.array(sizes) >= 0) > 0.9
