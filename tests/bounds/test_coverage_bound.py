"""The bound of CPP is never below the optimum, which is found here by trying every flight."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import draw_start, draw_targets, maps, scenario

from uavbench.bounds.coverage import coverage_bound
from uavbench.simulation.missions.coverage import camera_views
from uavbench.world.city import city_of

pytest.importorskip("highspy", reason="the bound needs highspy: pip install 'uavbench[planning]'")

OPEN = ("L....", ".....", ".....", ".....", ".....")


def corridor(row):
    """Return a map that is one row of cells and three of buildings."""
    return (row, *["#" * len(row)] * 3)


def everything(world):
    """Return the mask of all cells outside buildings."""
    return ~city_of(world).building


def seen_from(world, cell):
    """Return the cells that the camera sees from ``cell``, as a set."""
    view, size = int(camera_views(world)[cell]), world.mission.camera_size
    corner = cell[0] - size // 2, cell[1] - size // 2
    return {(corner[0] + bit // size, corner[1] + bit % size) for bit in range(size * size) if view >> bit & 1}


def optimum(world, start, budget, targets):
    """Return the most targets covered by a flight that lands, and such a flight: all (cell, covered set) step by step."""
    city = city_of(world)
    wanted = {tuple(cell) for cell in np.argwhere(targets).tolist()}
    gains = {cell: frozenset(seen_from(world, cell) & wanted) for cell in np.ndindex(city.shape) if not city.no_fly[cell]}
    best, best_path = 0, [start]
    flights = {(start, frozenset()): [start]}
    for _ in range(budget - 1):
        onward = {}
        for ((r, c), covered), path in flights.items():
            for cell in ((r, c), (r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
                if cell in gains:
                    onward.setdefault((cell, covered | gains[cell]), [*path, cell])
        flights = onward
        for (cell, covered), path in flights.items():
            if city.landing[cell] and len(covered) > best:
                best, best_path = len(covered), path
    return best, best_path


@st.composite
def episodes(draw):
    """Draw a tiny world with a camera of 3×3 cells, and an episode of it."""
    rows = draw(maps(smallest=4, largest=6))
    mission = {"kind": "coverage", "camera_size": 3, "shapes": (1, 3), "target_fraction": (0.1, 0.9)}
    data = draw(st.data())
    return scenario(rows, mission), draw_start(data, rows), draw(st.integers(1, 12)), draw_targets(data, rows)


@settings(max_examples=60)
@given(episodes())
def test_is_never_below_the_optimum(episode):
    best, path = optimum(*episode)
    bound = coverage_bound(*episode)
    assert bound.value >= best
    assert bound.cr == bound.value / episode[3].sum()
    helped = coverage_bound(*episode, plan=path)
    assert helped.value >= best
    assert helped.proved_optimal == (helped.value == best)


def test_is_mostly_the_optimum():
    random, equal, gap = np.random.default_rng(0), 0, 0
    for _ in range(40):
        grid = random.choice(list("......N##"), size=(6, 6))
        grid[0, :2], grid[1] = "L", "."
        world = scenario(
            tuple("".join(row) for row in grid.tolist()), {**scenario(OPEN).mission.model_dump(), "camera_size": 3}
        )
        episode = world, (0, 0), int(random.integers(6, 13)), (random.random((6, 6)) < 0.5) & everything(world)
        best, path = optimum(*episode)
        bound = coverage_bound(*episode, plan=path)
        equal += bound.proved_optimal
        gap += bound.value - best
    assert equal >= 25
    assert gap <= 25


def test_stops_valid_when_the_time_is_up():
    world = scenario(OPEN)
    targets = everything(world)
    best, _ = optimum(world, (0, 0), 8, targets)
    for seconds in (0.0, 0.001, 0.02):
        assert coverage_bound(world, (0, 0), 8, targets, seconds=seconds).value >= best


def test_reach_alone_is_the_bound_where_all_within_reach_can_be_covered():
    world = scenario(OPEN)
    targets = np.zeros((5, 5), dtype=bool)
    targets[2, 2] = targets[4, 4] = True
    bound = coverage_bound(world, (0, 0), 4, targets, plan=[(0, 0), (0, 0)])
    assert (bound.value, bound.cr, bound.method, bound.proved_optimal, bound.rounds) == (1, 0.5, "reach", True, 0)


def test_cuts_see_that_two_ways_exclude_each_other():
    world = scenario(corridor(".......L......."))
    targets = np.zeros((4, 15), dtype=bool)
    targets[0, 0] = targets[0, 14] = True  # either is seen after 5 moves
    assert coverage_bound(world, (0, 7), 20, targets).value == 1
    assert coverage_bound(world, (0, 7), 21, targets).value == 2


def test_flight_may_end_in_another_landing_zone():
    world = scenario(corridor("L..........L"))
    targets = np.zeros((4, 12), dtype=bool)
    targets[0, 5] = True
    assert coverage_bound(world, (0, 0), 7, targets).value == 1  # there and back
    assert coverage_bound(world, (0, 0), 12, everything(world)).value == 12
    assert coverage_bound(world, (0, 0), 11, everything(world)).value < 12


@pytest.mark.parametrize(("budget", "value"), [(1, 0), (2, 9)])
def test_start_counts_after_one_action(budget, value):
    world = scenario(OPEN)
    assert coverage_bound(world, (0, 0), budget, everything(world)).value == value


def test_targets_out_of_reach():
    world = scenario(("L.#..", "###..", ".....", ".....", "....."))
    targets = np.zeros((5, 5), dtype=bool)
    targets[4, 4] = True
    bound = coverage_bound(world, (0, 0), 20, targets)
    assert (bound.value, bound.cr, bound.proved_optimal) == (0, 0.0, True)


def test_start_walled_in_by_no_fly_cells_sees_over_them():
    world = scenario(("L.N..", "NNN..", ".....", ".....", "....."))
    assert coverage_bound(world, (0, 0), 20, everything(world)).value == 12


def test_no_targets():
    bound = coverage_bound(scenario(OPEN), (0, 0), 5, np.zeros((5, 5), dtype=bool))
    assert (bound.value, bound.cr) == (0, 0.0)


@pytest.mark.parametrize(
    ("plan", "reason"),
    [
        ([], "begin"),
        ([(1, 1)], "begin"),
        ([(0, 0)] * 6, "budget"),
        ([(0, 0), (-1, 0)], "off the map or a no-fly cell"),
        ([(0, 0), (1, 1)], "one move"),
        ([(0, 0), (0, 1)], "landing cell"),
    ],
)
def test_refuses_a_plan_that_is_no_flight(plan, reason):
    world = scenario(OPEN)
    with pytest.raises(ValueError, match=reason):
        coverage_bound(world, (0, 0), 5, everything(world), plan=plan)
