"""The static world: lines of sight as the oracle's, distances as a plain search, tables of linear size."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import ray, visible
from worlds import COVERAGE, maps, scenario

from uavbench import load_scenario
from uavbench.simulation.missions.coverage import camera_gain, camera_views
from uavbench.simulation.missions.harvesting import HarvestingMission
from uavbench.simulation.simulator import Simulator
from uavbench.world.cells import cells_of
from uavbench.world.city import LAND, OFFSETS, City, action_between, city_of, neighbour


@settings(max_examples=60)
@given(maps(largest=12))
def test_sees_what_the_oracle_sees(rows):
    city = City(cells_of(rows))
    for cell in np.ndindex(city.shape):
        assert np.array_equal(city.visible(cell), visible(city.building, cell))


@given(st.tuples(*[st.integers(0, 100)] * 4))
def test_a_ray_ends_at_its_border_cell_and_moves_one_axis_at_a_time(ends):
    x0, y0, x1, y1 = ends
    cells = ray(x0, y0, x1, y1)
    assert len(cells) == abs(x0 - x1) + abs(y0 - y1) + 1
    assert all(abs(a - c) + abs(b - d) == 1 for (a, b), (c, d) in pairwise(cells))


def test_visibility_is_not_symmetric():
    city = city_of(load_scenario("Manhattan32-CPP-v0"))
    cells = [tuple(cell) for cell in np.argwhere(~city.building).tolist()]
    seen = {cell: city.visible(cell) for cell in cells}
    assert any(seen[a][b] != seen[b][a] for a in cells[:50] for b in cells)


@settings(max_examples=40)
@given(maps())
def test_distances_are_those_of_relaxation(rows):
    city = City(cells_of(rows))
    start = tuple(city.landing_cells[0].tolist())
    found = city.distances(start)
    expected = np.full(city.shape, 10**6)
    expected[start] = 0
    for _ in range(city.building.size):
        near = np.pad(expected, 1, constant_values=10**6)
        best = np.minimum.reduce([near[:-2, 1:-1], near[2:, 1:-1], near[1:-1, :-2], near[1:-1, 2:]]) + 1
        expected = np.where(city.no_fly, 10**6, np.minimum(expected, best))
    assert np.array_equal(found, np.where(expected >= 10**6, -1, expected))
    homes = [city.distances(cell) for cell in city.landing_cells]
    there = np.array([np.where(home < 0, 10**6, home) for home in homes]).min(axis=0)
    assert np.array_equal(city.distance_to_landing, np.where(there >= 10**6, -1, there))


@settings(max_examples=40)
@given(maps(), st.sampled_from([1, 3, 5, 7]))
def test_the_cameras_views_are_its_square_less_buildings_and_shadow(rows, size):
    world = scenario(rows, {**COVERAGE, "camera_size": size})
    city, views, half = city_of(world), camera_views(world), size // 2
    target = (np.arange(city.building.size).reshape(city.shape) % 3 > 0).astype(np.float32)
    gain = camera_gain(world, target)
    for r, c in np.ndindex(city.shape):
        seen = visible(city.building, (r, c))
        count = 0
        for i in range(size):
            for j in range(size):
                y, x = r - half + i, c - half + j
                inside = 0 <= y < city.shape[0] and 0 <= x < city.shape[1]
                shown = inside and bool(seen[y, x]) and not city.building[y, x]
                assert bool(int(views[r, c]) >> (i * size + j) & 1) == shown
                count += bool(shown and target[y, x])
        assert gain[r, c] == count


@settings(max_examples=40)
@given(maps(), st.integers(1, 20))
def test_homeward_are_the_actions_after_which_it_can_still_land(rows, budget):
    city = City(cells_of(rows))
    there = np.argwhere(city.distance_to_landing >= 0)
    found = city.safe_action_mask(there, np.full(len(there), budget))
    for (r, c), mask in zip(there.tolist(), found.tolist(), strict=True):
        expected = []
        for action, (down, right) in enumerate(OFFSETS.tolist()):
            y, x = r + down, c + right
            blocked = not (0 <= y < city.shape[0] and 0 <= x < city.shape[1]) or city.no_fly[y, x]
            home = city.distance_to_landing[r, c] if blocked else city.distance_to_landing[y, x]
            expected.append((action == LAND and bool(city.landing[r, c])) or bool(home + 1 < budget))
        assert mask == (expected if any(expected) else [True] * 6)


def test_its_arrays_are_read_only():
    city = city_of(load_scenario("Block8-CPP-v0"))
    for name in ("landing", "no_fly", "building", "landing_cells", "action_mask", "distance_to_landing"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(city, name)[0] = 0


def size_of_tables(rows, mission="Urban50-DH-v0"):
    """Bytes of all that is kept per scenario: city, views, lines of sight, observation tables."""
    shipped = load_scenario(mission)
    world = scenario(rows, shipped.mission.model_dump(), observation={"local_size": 17, "global_scale": 5})
    city = city_of(world)
    arrays = [array for array in vars(city).values() if isinstance(array, np.ndarray)]
    simulator = Simulator(world, 1)
    arrays += list(simulator.state.maps)
    if isinstance(simulator.mission, HarvestingMission):
        arrays += list(simulator.mission._sights)
    else:
        arrays.append(simulator.mission.views)
    return sum(array.nbytes for array in arrays)


@pytest.mark.parametrize("mission", ["Urban50-CPP-v0", "Urban50-DH-v0"])
def test_tables_stay_small_and_grow_with_the_number_of_cells(mission):
    small = size_of_tables(load_scenario("Urban50-CPP-v0").rows, mission)
    assert small <= 64e6
    side = 200
    large = size_of_tables(["." * side] * (side - 1) + ["." * (side - 1) + "L"], mission)
    per_cell = small / 50**2, large / side**2
    assert per_cell[1] < 2.5 * per_cell[0]  # a table of cells × cells would be 16 times


@given(maps(), st.data())
def test_a_step_towards_a_goal_is_the_first_move_that_comes_nearer(rows, data):
    city = City(cells_of(rows))
    goal = tuple(data.draw(st.sampled_from(city.landing_cells.tolist())))
    distance = city.distances(goal)
    for cell in map(tuple, np.argwhere(distance > 0).tolist()):
        nearer = [
            action
            for action in range(4)
            if city.action_mask[cell][action] and distance[neighbour(cell, action)] == distance[cell] - 1
        ]
        assert city.step_towards(distance, cell) == nearer[0]
        assert action_between(cell, neighbour(cell, nearer[0])) == nearer[0]
    with pytest.raises(ValueError, match="no neighbour that is nearer"):
        city.step_towards(distance, goal)
