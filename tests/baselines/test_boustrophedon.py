"""Boustrophedon coverage: it gets home, covers, and gives way to nothing absurd."""

import itertools
from functools import partial

import flying
import numpy as np
import pytest
from flying import check_forgets, fly
from worlds import COVERAGE, HARVESTING, scenario

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.simulation.missions.coverage import camera_views

SCENARIOS = ["Manhattan32-CPP-v0", "Urban50-CPP-v0", "Block8-CPP-v0"]
LONG = ["Manhattan32-CPP-Long-v0", "Urban50-CPP-Long-v0"]
OPEN = ["LL......", "........", "........", "........"]
WALLED = ["L.N.....", "NNN.....", "........", "........"]
SPLIT = ["LL..#...", "....#...", "....#...", "....#..."]
STREET = ["L###", ".###", ".###", ".###", ".###", ".###"]


fly_world = partial(flying.fly_world, "boustrophedon")


def mask(rows, *cells):
    targets = np.zeros((len(rows), len(rows[0])), dtype=bool)
    for cell in cells:
        targets[cell] = True
    return targets


def part(name):
    """Return a function of the baseline's file."""
    return find_agent("boustrophedon").load().act.__globals__[name]


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS + LONG)
def test_it_always_lands_and_beats_random_by_a_wide_margin(name):
    numbers = range(5 if name in LONG else 30)
    swept, chance = fly(name, "boustrophedon", numbers), fly(name, "random", numbers)
    assert all(record.landed for record in swept.values())
    assert all(record.blocked == 0 for record in swept.values())
    gains = np.array([swept[n].cral - chance[n].cral for n in numbers])
    assert gains.mean() > 0.5
    assert (gains > 0).mean() > 0.9


def test_it_keeps_its_level():
    """A tour that is longer than need be, or lanes too close or too far apart, fall below."""
    assert np.mean([record.cral for record in fly("Urban50-CPP-v0", "boustrophedon", range(40)).values()]) > 0.85


@pytest.mark.parametrize("name", SCENARIOS)
def test_it_acts_alike_in_any_order(name):
    first, again = fly(name, "boustrophedon", range(8)), fly(name, "boustrophedon", range(7, -1, -1))
    assert all(np.array_equal(first[n].actions, again[n].actions) for n in first)


def test_an_episode_broken_off_leaves_no_trace():
    check_forgets("boustrophedon", "Manhattan32-CPP-v0")


@pytest.mark.parametrize("budget", [1, 2, 3, 4, 40])
@pytest.mark.parametrize("rows", [OPEN, WALLED, SPLIT, STREET])
def test_it_lands_whatever_the_world(rows, budget):
    """One target, all targets; walled in, behind a wall, too far; a street of one cell's width."""
    free = [(r, c) for r, row in enumerate(rows) for c, cell in enumerate(row) if cell != "#"]
    for cells in ([free[-1]], [free[0]], free):
        _, info = fly_world(scenario(rows), start=[0, 0], budget=budget, targets=mask(rows, *cells))
        assert info["landed"]


def test_it_covers_what_it_sees_from_where_it_is_walled_in():
    _, info = fly_world(scenario(WALLED), start=[0, 0], budget=9, targets=mask(WALLED, (2, 0), (1, 4), (3, 7)))
    assert info["landed"]
    assert info["cral"] == pytest.approx(1 / 3)


def test_a_hover_covers_where_there_is_no_time_for_more():
    actions, info = fly_world(scenario(OPEN), start=[0, 0], budget=2, targets=mask(OPEN, (2, 0), (3, 7)))
    assert actions == [4, 5]
    assert info["cral"] == 0.5


def test_it_covers_an_open_field_in_lanes_a_camera_apart():
    rows = ["L" + "." * 14] + ["." * 15] * 14
    world = scenario(rows, budget=(5, 90))
    actions, info = fly_world(world, start=[0, 0], budget=90, targets=np.ones((15, 15), dtype=bool))
    assert info["cral"] == 1.0
    assert len(actions) <= 4 + 3 * 10 + 2 * 5 + 2 * 12 + 1  # to the first lane, three of them, from one to the next, home


def test_a_short_budget_takes_what_pays_most_for_the_way():
    rows = ["L" + "." * 19] + ["." * 20] * 4
    near = [(r, c) for r in range(5) for c in range(4, 9)]
    far = [(r, c) for r in range(5) for c in range(14, 20)]
    _, info = fly_world(scenario(rows), start=[0, 0], budget=18, targets=mask(rows, *near, *far))
    assert info["landed"]
    assert info["cral"] == pytest.approx(25 / 55)


def test_zones_end_where_lanes_divide_and_join():
    decompose = part("_decompose")
    lines = [
        [(0, 9, "a")],
        [(0, 9, "b")],
        [(0, 3, "c"), (5, 9, "d")],
        [(1, 3, "e"), (6, 9, "f")],
        [(0, 9, "g")],
        [],
        [(0, 9, "h")],
    ]
    assert decompose(lines) == [["a", "b"], ["c", "e"], ["d", "f"], ["g"], ["h"]]


def test_view_sets_are_what_the_camera_sees():
    world = load_scenario("Block8-CPP-v0")
    views, (rows, cols) = camera_views(world), world.shape
    sets = part("_view_sets")(views, 5)
    for r, c in itertools.product(range(rows), range(cols)):
        seen = {
            (r + i - 2) * cols + c + j - 2
            for i, j in itertools.product(range(5), range(5))
            if int(views[r, c]) >> (5 * i + j) & 1
        }
        assert {cell for cell in range(rows * cols) if sets[r * cols + c] >> cell & 1} == seen


def test_the_order_is_short():
    """Local search is within a few per cent of the best of all orders."""
    best_order, best_ways = part("_best_order"), part("_best_ways")
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(30):
        number = int(rng.integers(1, 7))
        enter, leave = rng.integers(0, 30, (2, number, 4, 2))
        first = enter.sum(axis=2).astype(np.int32)
        between = np.abs(leave[:, :, None, None] - enter[None, None]).sum(axis=4).astype(np.int32)
        last = leave.sum(axis=2).astype(np.int32)
        order, ways = best_order(first, between, last)
        assert sorted(order.tolist()) == list(range(number))
        visits = list(zip(order.tolist(), ways.tolist(), strict=True))
        length = first[visits[0]] + sum(between[(*a, *b)] for a, b in itertools.pairwise(visits)) + last[visits[-1]]
        orders = itertools.permutations(range(number))
        ratios.append(length / min(best_ways(np.array(each), first, between, last)[0] for each in orders))
    assert min(ratios) >= 1.0
    assert np.mean(ratios) < 1.03


@pytest.mark.parametrize("name", ["Manhattan32-DH-v0", "Block8-DH-v0", "Manhattan32-CPP-Team-v0", "Urban50-DH-Team-v0"])
def test_it_says_what_it_is_for(name):
    with pytest.raises(ValueError, match=r"boustrophedon is for coverage by one UAV .*tsp.*planner") as caught:
        find_agent("boustrophedon").make(load_scenario(name))
    assert name in str(caught.value)
    with pytest.raises(ValueError, match="Test-v0"):
        find_agent("boustrophedon").make(scenario(OPEN, HARVESTING))
    find_agent("boustrophedon").make(scenario(OPEN, COVERAGE))
