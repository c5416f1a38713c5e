"""The searches promise what the simulator then finds."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import visible
from worlds import COVERAGE, HARVESTING, draw_devices, draw_starts, draw_targets, maps, scenario

from uavbench.envs.parallel_env import UAVParallelEnv
from uavbench.planning import coverage, harvesting
from uavbench.planning.distances import FAR, distance_table
from uavbench.planning.rates import expected_rates, near_rates
from uavbench.world.city import city_of

LAND = 5
STEPS = {(-1, 0): 0, (0, 1): 1, (1, 0): 2, (0, -1): 3, (0, 0): 4}


def check_flights(plan, starts, budgets, world):
    """Flights begin where the UAVs are, go from cell to cell, and end in a landing cell with an action left to land."""
    cells = np.array([list(row) for row in world.rows])
    for flight, start, budget in zip(plan.flights, starts, budgets, strict=True):
        assert flight[0] == tuple(start)
        assert cells[flight[-1]] == "L"
        assert len(flight) <= budget
        for (r0, c0), (r1, c1) in pairwise(flight):
            assert (r1 - r0, c1 - c0) in STEPS
            assert cells[r1, c1] in ".Lb"


def fly(world, plan, starts, budgets, **options):
    """Fly a plan; return the state at its end and what was landed."""
    env = UAVParallelEnv(world)
    _, infos = env.reset(seed=0, options={"num_uavs": len(starts), "start": starts, "budget": budgets, **options})
    flights = {f"uav_{u}": flight for u, flight in enumerate(plan.flights)}
    for step in range(max(budgets)):
        if not env.agents:
            break
        actions = {}
        for agent in env.agents:
            flight = flights[agent]
            here, there = flight[min(step, len(flight) - 1)], flight[min(step + 1, len(flight) - 1)]
            ended = step >= len(flight) - 1
            actions[agent] = LAND if ended else STEPS[there[0] - here[0], there[1] - here[1]]
        *_, infos = env.step(actions)
    return env.simulator.state, next(iter(infos.values()))


@settings(max_examples=60)
@given(st.data(), maps(landing=(2, 3)), st.sampled_from([1, 3, 5, 7]), st.integers(1, 2), st.integers(0, 99))
def test_a_coverage_plan_covers_what_it_says(data, rows, camera, number, seed):
    world = scenario(rows, {**COVERAGE, "camera_size": camera}, uavs=(1, 2))
    starts, targets = draw_starts(data, rows, number), draw_targets(data, rows)
    budgets = data.draw(st.lists(st.integers(1, 40), min_size=number, max_size=number))
    plan = coverage.search(world, targets.astype(np.float32), [tuple(c) for c in starts], budgets, seed=seed, moves=400)
    check_flights(plan, starts, budgets, world)
    city, seen = city_of(world), np.zeros(world.shape, bool)
    for flight in plan.flights:
        for r, c in flight[1:]:
            half, square = camera // 2, np.zeros(world.shape, bool)
            square[max(0, r - half) : r + half + 1, max(0, c - half) : c + half + 1] = True
            seen |= square & visible(city.building, (r, c)) & ~city.building
    assert plan.value == (seen & targets).sum()


@pytest.mark.parametrize("large", [False, True])
@settings(max_examples=40)
@given(st.data(), maps(landing=(2, 3)), st.integers(0, 99))
def test_a_harvesting_plan_collects_what_it_says_when_nothing_fades(large, data, rows, seed):
    """Also by the search of large maps, whose rates are those of devices near the UAV: here all are near."""
    quiet = {"fading_variance": {"los": 0.0, "nlos": 0.0}, "edge_snr": -5.0}
    world = scenario(rows, {**HARVESTING, **quiet}, uavs=(1, 2))
    starts, devices = draw_starts(data, rows, 1), draw_devices(data, rows)
    budget = data.draw(st.integers(1, 40))
    cells = np.array([[r, c] for r, c, _ in devices], dtype=np.int32)
    rates = near_rates(world, cells, city_of(world)) if large else expected_rates(world, cells)
    assert not large or rates.reach >= max(world.shape)
    stored = np.array([each for *_, each in devices])
    plan = harvesting.search(world, rates, cells, stored, [tuple(starts[0])], [budget], seed=seed, moves=300)
    check_flights(plan, starts, [budget], world)
    state, info = fly(world, plan, starts, [budget], devices=devices)
    assert info["landed"]
    assert plan.value == pytest.approx(state.total[0] - state.remaining[0], rel=1e-5)


def test_expected_rates_are_means_over_the_fading():
    world = scenario(("......", ".LL.#.", "......", "......"), HARVESTING)
    rates = expected_rates(world, np.array([[3, 5]], dtype=np.int32))
    quiet = expected_rates(
        scenario(world.rows, {**HARVESTING, "fading_variance": {"los": 0.0, "nlos": 0.0}}), np.array([[3, 5]], dtype=np.int32)
    )
    normal = np.random.default_rng(0).standard_normal(200_000)
    for cell, sigma in ((3 * 6 + 5, 2.0**0.5), (1 * 6 + 1, None)):
        alone = quiet[cell, 4, 0, 0]
        spread = sigma or (2.0**0.5 if _sees(world, (3, 5), divmod(cell, 6)) else 5.0**0.5)
        snr = (2.0**alone - 1) * 10 ** (spread * normal / 10)
        assert rates[cell, 4, 0, 0] == pytest.approx(np.log2(1 + snr).mean(), rel=5e-3)


def _sees(world, device, cell):
    return visible(city_of(world).building, device)[cell]


def test_more_changes_find_the_best_flight_of_a_small_city():
    """All flights of up to eleven moves, one after the other, find no better one."""
    rows = (".....", ".L.#.", "...#.", ".....")
    world = scenario(rows, {**COVERAGE, "camera_size": 1})
    targets = np.zeros((4, 5), np.float32)
    for cell in ((0, 4), (3, 0), (3, 4), (0, 0), (1, 4)):
        targets[cell] = 1
    budget, best = 12, 0
    frontier = {((1, 1), frozenset())}
    for _ in range(budget - 1):
        grown = set()
        for (r, c), seen in frontier:
            for down, right in ((-1, 0), (0, 1), (1, 0), (0, -1)):
                y, x = r + down, c + right
                if 0 <= y < 4 and 0 <= x < 5 and rows[y][x] != "#":
                    grown.add(((y, x), seen | {(y, x)} if targets[y, x] else seen))
        frontier = grown
        best = max(best, *(len(seen) for cell, seen in frontier if cell == (1, 1)), 0)
    plan = coverage.search(world, targets, [(1, 1)], [budget], seed=1, moves=50_000)
    assert plan.value == best > 1


@pytest.mark.parametrize("name", ["coverage", "harvesting"])
def test_the_same_seed_finds_the_same_plan(name):
    rows = ("........", ".LL..#..", "........", "..#.....", "........")
    if name == "coverage":
        world = scenario(rows)
        targets = np.zeros((5, 8), np.float32)
        targets[4] = targets[0] = 1
        plans = [coverage.search(world, targets, [(1, 1)], [20], seed=s, moves=20) for s in (3, 3, 4)]
    else:
        world = scenario(rows, HARVESTING)
        cells = np.array([[4, 7], [0, 6], [4, 0]], dtype=np.int32)
        rates = expected_rates(world, cells)
        plans = [harvesting.search(world, rates, cells, np.full(3, 9.0), [(1, 1)], [20], seed=s, moves=20) for s in (3, 3, 4)]
    assert plans[0] == plans[1]
    assert plans[0].flights != plans[2].flights


def test_distances_are_those_of_the_city():
    world = scenario(("......", ".LL.#.", "...#..", "N....#"))
    city = city_of(world)
    table = distance_table(city)
    for cell in range(24):
        away = city.distances(divmod(cell, 6)).reshape(-1)
        if city.no_fly[divmod(cell, 6)]:
            assert (table[cell] == FAR).all()
        else:
            assert np.array_equal(np.where(away >= 0, away, FAR), table[cell])
