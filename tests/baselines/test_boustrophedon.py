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


@pytest.mark.slow
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


def test_what_is_seen_is_counted():
    world = load_scenario("Block8-CPP-v0")
    views, (rows, cols), rng = camera_views(world), world.shape, np.random.default_rng(0)
    target = rng.random(world.shape) < 0.5
    sight = part("Sight")(part("_targets_in_view")(views, 5, target), 5, np.zeros(world.shape, np.int32))
    seen = {
        (r, c): {
            (r + i - 2, c + j - 2)
            for i, j in itertools.product(range(5), range(5))
            if int(views[r, c]) >> (5 * i + j) & 1 and target[r + i - 2, c + j - 2]
        }
        for r, c in itertools.product(range(rows), range(cols))
    }
    for _ in range(20):
        lanes = [rng.choice(rows * cols, rng.integers(1, 5)) for _ in range(rng.integers(1, 5))]
        shown = [set().union(*(seen[divmod(int(cell), cols)] for cell in lane)) for lane in lanes]
        assert part("_covered")(np.concatenate(lanes), sight) == len(set().union(*shown))
        own = part("_own_targets")(np.concatenate(lanes), np.cumsum([len(lane) for lane in lanes]), sight)
        others = [set().union(*(shown[j] for j in range(len(lanes)) if j != k)) for k in range(len(lanes))]
        assert own.tolist() == [len(mine - theirs) for mine, theirs in zip(shown, others, strict=True)]
        kept = part("_trimmed")(lanes[0], sight).tolist()
        assert kept
        assert set().union(*(seen[divmod(cell, cols)] for cell in kept)) == shown[0]
        assert not sight.counts.any()


@pytest.mark.parametrize("side", [pytest.param(64, marks=pytest.mark.slow), 160])
def test_flies_in_large_cities(side):
    """In the larger one there are more zones than are all ordered, and more than the budget suffices for."""
    like = load_scenario("Cities32-CPP-v0")
    same = {name: getattr(like, name) for name in type(like).model_fields}
    source = like.cities.model_copy(update={"map_shape": (side, side), "shape": (side, side), "frozen": None})
    world = type(like).model_validate({**same, "cities": source, "splits": {}, "budget": (200, 400)})
    _, info = fly_world(world, budget=400)
    assert info["landed"]
    assert info["cral"] > {64: 0.7, 160: 0.15}[side]


@pytest.mark.parametrize("name", ["Manhattan32-DH-v0", "Block8-DH-v0", "Manhattan32-CPP-Team-v0", "Urban50-DH-Team-v0"])
def test_it_says_what_it_is_for(name):
    with pytest.raises(ValueError, match=r"boustrophedon is for coverage by one UAV .*tsp.*planner") as caught:
        find_agent("boustrophedon").make(load_scenario(name))
    assert name in str(caught.value)
    with pytest.raises(ValueError, match="Test-v0"):
        find_agent("boustrophedon").make(scenario(OPEN, HARVESTING))
    find_agent("boustrophedon").make(scenario(OPEN, COVERAGE))
