"""Routes: nothing of a flight is lost when straight ways are merged."""

import itertools

import numpy as np
import pytest
from flights import SCENARIOS, flight_of, result_of
from hypothesis import given
from hypothesis import strategies as st

from uavbench import load_scenario
from uavbench.evaluation.replay import fly_recorded
from uavbench.flight.route import FlightError, recorded_flight, route_of
from uavbench.world.city import LAND, OFFSETS


def cells_along(route):
    """The cells of a route, one for each step."""
    found = [route.stops[0].cell]
    for one, other in itertools.pairwise(route.stops):
        found += [one.cell] * one.wait
        (r, c), (y, x) = one.cell, other.cell
        assert (r == y) != (c == x)  # straight, and not on the spot
        far = abs(y - r) + abs(x - c)
        found += [(r + k * (y - r) // far, c + k * (x - c) // far) for k in range(1, far + 1)]
    return found + [route.stops[-1].cell] * route.stops[-1].wait


@given(moves=st.lists(st.integers(0, 4), max_size=60), landed=st.booleans())
def test_a_route_is_the_cells_of_a_flight(moves, landed):
    cells = [(0, 0)]
    for move in moves:
        down, right = ([*OFFSETS[:4].tolist(), (0, 0)])[move]
        cells.append((cells[-1][0] + down, cells[-1][1] + right))
    route = route_of([*cells, cells[-1]] if landed else cells, landed)
    assert cells_along(route) == cells
    assert route.moves == sum(move < 4 for move in moves)
    directions = [np.sign(np.subtract(other.cell, one.cell)).tolist() for one, other in itertools.pairwise(route.stops)]
    for k, (one, other) in enumerate(itertools.pairwise(directions)):
        assert one != other or route.stops[k + 1].wait


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_recorded_flight_is_what_was_flown(name):
    flight, result = flight_of(name, 1), result_of(name)
    scenario, actions = load_scenario(name), result.actions()[1]
    states = []

    def watch(simulator):
        states.append((simulator.state.position[0].copy(), simulator.state.done[0].copy(), simulator.state.target[0].copy()))

    record = fly_recorded(scenario, "test", 1, actions, watch)
    assert len(flight.routes) == record.uavs
    for u, route in enumerate(flight.routes):
        flown = actions[:, u] < 6
        steps = int(flown.sum())
        where = [tuple(position[u].tolist()) for position, _, _ in states[: steps + 1]]
        assert route.landed == (actions[steps - 1, u] == LAND)
        assert cells_along(route) == (where[:-1] if route.landed else where)
    np.testing.assert_array_equal(flight.target, states[0][2])
    np.testing.assert_array_equal(flight.left, states[-1][2])
    assert flight.cr == record.cr == pytest.approx(1 - flight.left.sum() / flight.target.sum())


def test_an_episode_that_is_not_there_is_refused():
    with pytest.raises(FlightError, match=r"--episode 4: .* holds the episodes 0 to 3"):
        recorded_flight(result_of("Block8-CPP-v0"), 4)
