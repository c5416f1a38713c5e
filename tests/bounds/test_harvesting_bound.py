"""The bound of DH is never below what a policy collects on average: the optimum of tiny worlds, and flights in fading."""

import copy
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import Oracle
from worlds import HARVESTING, draw_devices, draw_start, maps, scenario

from uavbench import load_scenario
from uavbench.bounds.harvesting import _NORMALS, _Problem, _spread, harvesting_bound
from uavbench.bounds.prices import add_most, fill_rates
from uavbench.planning.harvesting import expected_rates, search
from uavbench.simulation.missions.channel import channel_of
from uavbench.simulation.simulator import Simulator
from uavbench.world.city import city_of

STILL = {**HARVESTING, "fading_variance": {"los": 0.0, "nlos": 0.0}}
ACTIONS = {(-1, 0): 0, (0, 1): 1, (1, 0): 2, (0, -1): 3, (0, 0): 4}
OPEN = ("L....", ".....", ".....", ".....", ".....")
WALLED = ("L.N..", "NNN..", ".....", ".....", ".....")


def optimum(world, start, budget, devices):
    """Return the most data that a flight which lands collects without fading: all flights, step by step."""
    first = Oracle(world, start, budget, devices, noisy=False)
    best, flights = 0.0, {(first.p, tuple(first.devices)): first}
    for _ in range(budget - 1):
        onward = {}
        for flight in flights.values():
            for action in range(5):
                after = copy.copy(flight)
                after.devices = list(flight.devices)
                after.step(action)
                onward.setdefault((after.p, tuple(after.devices)), after)
        flights = onward
        best = max([best, *(flight.total - flight.left() for flight in flights.values() if flight.landing[flight.p])])
    return best


def bound_of(world, start, budget, devices, **options):
    table = np.array(devices, dtype=float)
    return harvesting_bound(world, start, budget, table[:, :2].astype(int), table[:, 2], **options)


def problem_of(world, start, budget, devices):
    table = np.array(devices, dtype=float)
    return _Problem(world, city_of(world), start, budget, table[:, :2].astype(np.int32), table[:, 2])


def flown(world, start, budget, devices, actions, count=1500):
    """Return the mean of the data collected by a flight in fading, and its standard error."""
    slots, simulator = np.arange(count), Simulator(world, count)
    simulator.reset(slots, "train", slots)
    for i in slots:
        simulator.customise(i, {"start": list(start), "budget": budget, "devices": devices})
    for action in actions:
        simulator.step(np.full(count, action))
    outcomes = simulator.outcomes(slots)
    assert outcomes["landed"].all()
    collected = outcomes["cral"] * sum(data for *_, data in devices)
    return collected.mean(), collected.std() / math.sqrt(count)


@st.composite
def episodes(draw):
    """Draw a tiny world without fading, and an episode of it."""
    rows = draw(maps(smallest=4, largest=5))
    mission = {
        **STILL,
        "communication_steps": draw(st.sampled_from([1, 3, 4])),
        "edge_snr": draw(st.sampled_from([-15.0, 0.0])),
    }
    data = draw(st.data())
    return scenario(rows, mission), draw_start(data, rows), draw(st.integers(1, 6)), draw_devices(data, rows)


@pytest.mark.slow
@settings(max_examples=60)
@given(episodes(), st.integers(0, 99))
def test_is_never_below_the_optimum_whatever_the_worths(episode, seed):
    best = optimum(*episode) * (1 - 1e-12)
    assert bound_of(*episode, rounds=30).value >= best
    problem, random = problem_of(*episode), np.random.default_rng(seed)
    for worth in (random.random(problem.rings.shape[:2]), random.integers(0, 2, problem.rings.shape[:2]).astype(float)):
        problem.look_at(worth)
        assert problem.bound() >= best


def test_is_mostly_close_to_the_optimum():
    random, gaps = np.random.default_rng(0), []
    for _ in range(12):
        grid = random.choice(list("......N##"), size=(5, 5))
        grid[0, :2], grid[1] = "L", "."
        world = scenario(tuple("".join(row) for row in grid.tolist()), STILL)
        cells = random.permutation(np.argwhere((grid == ".") | (grid == "N")))[:2]
        episode = world, (0, 0), int(random.integers(4, 7)), [[*cell, random.uniform(3, 12)] for cell in cells.tolist()]
        best = optimum(*episode)
        gaps.append(bound_of(*episode, rounds=300).value / best - 1)
    assert min(gaps) >= 0
    assert np.mean(gaps) < 0.05
    assert sum(gap < 0.01 for gap in gaps) >= 4


def test_fading_that_lets_one_choose_the_best_of_three_counts():
    loud = {**HARVESTING, "fading_variance": {"los": 30.0, "nlos": 30.0}, "data": (1.0, 500.0), "communication_steps": 100}
    world = scenario(OPEN, loud)
    devices, cells = [[0, 3, 500.0], [3, 0, 500.0], [2, 2, 500.0]], np.array([[0, 3], [3, 0], [2, 2]], dtype=np.int32)
    mean, error = flown(world, (0, 0), 2, devices, [4, 5])  # there is time to hover once
    bound = bound_of(world, (0, 0), 2, devices)
    assert mean - 4 * error <= bound.value <= 1.08 * mean
    rates = expected_rates(world, cells)[0, 4]
    assert rates.max(axis=1).sum() < mean - 4 * error, "the means of the rates alone would be a bound here"


def test_is_above_what_plans_collect_in_fading():
    world, simulator = load_scenario("Block8-DH-v0"), Simulator(load_scenario("Block8-DH-v0"), 1)
    closest = []
    for number in range(4):
        simulator.reset([0], "test", [number])
        start, budget = tuple(simulator.state.position[0, 0].tolist()), int(simulator.state.budget[0, 0])
        cells, data = (simulator.mission.view(0)[name].copy() for name in ("device_cell", "device_data"))
        plan = search(world, expected_rates(world, cells), cells, data, [start], [budget], seed=0, moves=5_000)
        (flight,) = plan.flights
        actions = [ACTIONS[q[0] - p[0], q[1] - p[1]] for p, q in itertools.pairwise(flight)]
        devices = [[*cell, amount] for cell, amount in zip(cells.tolist(), data.tolist(), strict=True)]
        mean, error = flown(world, start, budget, devices, [*actions, 5], count=300)
        bound = harvesting_bound(world, start, budget, cells, data, rounds=150)
        assert bound.value >= (mean - 4 * error) * (1 - 1e-12)
        assert bound.cr == pytest.approx(bound.value / data.sum())
        closest.append(mean / bound.value)
    assert min(closest) > 0.7


def test_nodes_stand_for_a_normal_variable_from_above():
    chances, beyond = _spread(_NORMALS)
    assert chances.min() > 0
    assert chances.sum() == pytest.approx(1, abs=1e-12)
    assert 0 <= beyond < 1e-9
    assert (chances * _NORMALS).sum() == pytest.approx(0, abs=1e-3)
    for k in np.linspace(-6, 5, 45):  # E max(0, N − k): all convex functions are mixtures of these and lines
        exact = math.exp(-k * k / 2) / math.sqrt(2 * math.pi) - k * math.erfc(k / math.sqrt(2)) / 2
        assert exact - 2 * beyond <= chances @ np.maximum(_NORMALS - k, 0) <= exact + 0.1


def test_mean_of_the_best_device_is_that_of_samples():
    world = scenario(OPEN, HARVESTING)
    devices = np.array([[0, 2], [2, 1], [4, 4], [2, 2]], dtype=np.int32)
    channel = channel_of(world.mission, world.shape)
    sight = np.array([city_of(world).visible(cell) for cell in devices.tolist()])
    positions = np.array([[0.0, 0.0], [1.25, 2.0], [2.0, 2.0]])
    chances, _ = _spread(_NORMALS)
    rates, samples = np.empty((3, 4, len(_NORMALS))), np.empty((3, 4, 200_000))
    fill_rates(positions, devices, sight, channel, _NORMALS, rates)
    normals = np.random.default_rng(0).normal(size=(4, 200_000))
    for d in range(4):  # the same function of position and fading, at other fadings
        fill_rates(positions, devices[d : d + 1], sight[d : d + 1], channel, normals[d], samples[:, d : d + 1])
    for worth in ([1, 1, 1, 1], [1, 0.5, 0.2, 0.1], [0, 0, 0.3, 0], [0, 0, 0, 0], [0.9, 0.7, 0, 0.4]):
        worth = np.array(worth, dtype=float)
        for i in range(3):
            slope = np.zeros(4)
            mean = add_most(rates[i], worth, chances, slope, np.empty(4), np.empty((2, 4), dtype=np.int64))
            best = (worth[:, None] * samples[i]).max(axis=0)
            assert best.mean() - 4 * best.std() / math.sqrt(best.size) <= mean <= 1.02 * best.mean()
            assert slope @ worth == pytest.approx(mean)


def test_gradient_is_that_of_the_bound():
    world = scenario(OPEN, HARVESTING)
    problem = problem_of(world, (0, 0), 12, [[2, 3, 9.0], [4, 1, 14.0]])
    random = np.random.default_rng(0)
    for _ in range(5):
        worth = random.uniform(0.1, 0.9, problem.rings.shape[:2])
        problem.look_at(worth)
        gradient = problem.gradient(1e-4, 1e-9).copy()
        for _ in range(5):
            by = 1e-6 * random.normal(size=worth.shape)
            values = []
            for sign in (1, -1):
                problem.look_at(worth + sign * by)
                values.append(problem.bound())
            assert values[0] - values[1] == pytest.approx(2 * (gradient * by).sum(), rel=1e-2, abs=1e-8)


def test_descent_finds_that_one_cannot_be_in_two_places():
    world = scenario((".......L.......", *["#" * 15] * 3), {**STILL, "edge_snr": -35.0})
    for budget, most in ((18, 2.1), (22, 2.75), (26, 3.2)):  # data units, of 4; half of these are far from the other half
        bound = bound_of(world, (0, 7), budget, [[0, 0, 2.0], [0, 14, 2.0]])
        assert bound.method == "prices"
        assert bound.value < most


def test_stops_valid_when_time_or_rounds_are_up_or_the_plan_is_as_good():
    world, devices = scenario(OPEN, STILL), [[2, 3, 9.0], [4, 1, 14.0]]
    best = optimum(world, (0, 0), 6, devices)
    for options in ({"rounds": 0}, {"seconds": 0.0}, {"rounds": 7}, {"seconds": 0.02}, {"planned": best}):
        assert bound_of(world, (0, 0), 6, devices, **options).value >= best
    assert bound_of(world, (0, 0), 6, devices, seconds=0.0).rounds == 0
    assert bound_of(world, (0, 0), 6, devices, rounds=7).rounds == 7
    all_data = bound_of(world, (0, 0), 6, devices, planned=23.0)
    assert (all_data.value, all_data.cr, all_data.method, all_data.rounds) == (23.0, 1.0, "data", 0)


def test_gives_up_where_there_is_far_more_time_than_data():
    bound = bound_of(scenario(OPEN, STILL), (0, 0), 200, [[2, 3, 9.0], [4, 1, 14.0]])
    assert (bound.value, bound.cr, bound.method, bound.rounds) == (23.0, 1.0, "data", 200)


@pytest.mark.parametrize("rows", [OPEN, WALLED])
def test_a_budget_of_one_is_for_landing(rows):
    bound = bound_of(scenario(rows, HARVESTING), (0, 0), 1, [[3, 3, 5.0]])
    assert (bound.value, bound.cr) == (pytest.approx(0, abs=1e-6), pytest.approx(0, abs=1e-6))


def test_start_walled_in_and_devices_that_nobody_reaches():
    devices = [[3, 3, 20.0], [0, 3, 20.0]]
    for rows in (WALLED, ("L.#..", "###..", ".....", ".....", ".....")):
        world = scenario(rows, STILL)
        bound = bound_of(world, (0, 0), 6, devices)
        assert optimum(world, (0, 0), 6, devices) <= bound.value < 40
    fenced = scenario(("L....", ".....", "..NNN", "..N..", "..N.."), STILL)
    for cell in ([4, 4], [3, 2]):
        devices = [[*cell, 5.0]]
        assert optimum(fenced, (0, 0), 6, devices) <= bound_of(fenced, (0, 0), 6, devices).value <= 5
