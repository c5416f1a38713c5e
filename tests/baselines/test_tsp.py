"""The TSP over devices: it gets home, collects, and gives way to nothing absurd."""

import itertools
from functools import partial

import flying
import numpy as np
import pytest
from flying import check_forgets, fly
from worlds import COVERAGE, HARVESTING, scenario

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.envs.env import UAVEnv
from uavbench.simulation.state_view import StateView

SCENARIOS = ["Manhattan32-DH-v0", "Urban50-DH-v0", "Block8-DH-v0"]
LONG = ["Manhattan32-DH-Long-v0", "Urban50-DH-Long-v0"]
OPEN = ["LL......", "........", "........", "........"]
WALLED = ["L.N.....", "NNN.....", "........", "........"]
SPLIT = ["LL..#...", "....#...", "....#...", "....#..."]


fly_world = partial(flying.fly_world, "tsp", noise=False)


@pytest.mark.parametrize("name", SCENARIOS + LONG)
def test_it_always_lands_and_beats_random_by_a_wide_margin(name):
    numbers = range(5 if name in LONG else 30)
    tsp, chance = fly(name, "tsp", numbers), fly(name, "random", numbers)
    assert all(record.landed for record in tsp.values())
    assert all(record.blocked == 0 for record in tsp.values())
    gains = np.array([tsp[n].cral - chance[n].cral for n in numbers])
    assert gains.mean() > 0.5
    assert (gains > 0).mean() > 0.9


def test_it_keeps_its_level():
    """A tour that is longer than need be, or hovers where it need not, falls below."""
    assert np.mean([record.cral for record in fly("Manhattan32-DH-v0", "tsp", range(60)).values()]) > 0.85


@pytest.mark.parametrize("name", SCENARIOS)
def test_it_acts_alike_in_any_order(name):
    first, again = fly(name, "tsp", range(8)), fly(name, "tsp", range(7, -1, -1))
    assert all(np.array_equal(first[n].actions, again[n].actions) for n in first)


def test_an_episode_broken_off_leaves_no_trace():
    check_forgets("tsp", "Manhattan32-DH-v0")


@pytest.mark.parametrize("budget", [1, 2, 3, 4, 40])
@pytest.mark.parametrize("rows", [OPEN, WALLED, SPLIT])
@pytest.mark.parametrize("device", [(3, 7), (0, 2), (1, 3)])
def test_it_lands_whatever_the_world(rows, budget, device):
    """Walled in, behind a wall, too far: what can be collected from afar is, and the rest is let be."""
    _, info = fly_world(scenario(rows, HARVESTING), start=[0, 0], budget=budget, devices=[[*device, 20.0]])
    assert info["landed"]


def test_it_hovers_over_a_device_as_close_as_it_may():
    world = scenario(["LL......", "........", ".....NN.", ".....NN."], HARVESTING)
    actions, info = fly_world(world, start=[0, 0], budget=40, devices=[[2, 5, 20.0]])
    assert info["cral"] == 1.0
    assert 4 in actions
    r, c = 0, 0
    for action in actions[: actions.index(4)]:
        r, c = r + (action == 2) - (action == 0), c + (action == 1) - (action == 3)
    assert abs(r - 2) + abs(c - 5) == 1


def test_it_takes_the_device_that_the_budget_allows():
    """The far device has more, but only the near one can be reached and left in time."""
    world = scenario(["L" + "." * 11, *["." * 12] * 3], {**HARVESTING, "edge_snr": -25.0})
    actions, info = fly_world(world, start=[0, 0], budget=12, devices=[[0, 4, 5.0], [0, 11, 20.0]])
    assert info["landed"]
    assert 4 in actions
    assert info["cral"] == pytest.approx(0.2, abs=0.02)


def test_it_goes_as_near_as_the_budget_allows():
    """The device cannot be reached in time, but something of it can be collected from afar."""
    world = scenario(["L" + "." * 11, *["." * 12] * 3], HARVESTING)
    actions, info = fly_world(world, start=[0, 0], budget=16, devices=[[0, 11, 20.0]])
    assert info["landed"]
    assert actions == [1] * 7 + [4] + [3] * 7 + [5]


def test_more_devices_than_it_can_order():
    mission = {**HARVESTING, "devices": (1, 30)}
    devices = [[r, c, 1.0 + c] for r in range(4) for c in range(8) if OPEN[r][c] == "."]
    _, info = fly_world(scenario(OPEN, mission, budget=(5, 100)), start=[0, 0], budget=100, devices=devices)
    assert info["cral"] == 1.0


def test_it_turns_home_in_time_whatever_its_goal():
    world = scenario(OPEN, HARVESTING)
    env, agent = UAVEnv(world), find_agent("tsp").make(world)
    for budget in range(1, 25):
        observation, info = env.reset(options={"start": [0, 1], "budget": budget, "devices": [[3, 7, 20.0]]})
        agent._left, agent._goal = [0], (3, 7)
        over = False
        while not over:
            action = agent.act(observation, {**info, "state": StateView(env.simulator, 0)})
            observation, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            agent._goal = (3, 7)
        assert info["landed"]


def test_the_tour_is_the_best_of_all_orders_and_subsets():
    best_tour = find_agent("tsp").load()._plan.__globals__["_best_tour"]
    rng = np.random.default_rng(0)
    for _ in range(60):
        number = int(rng.integers(1, 6))
        cells = rng.integers(0, 12, (number + 1, 2))
        moves = np.abs(cells[:, None] - cells[None]).sum(axis=2).astype(np.int32)
        first, between, home = moves[0, 1:], moves[1:, 1:], moves[0, 1:]
        data, rates = rng.uniform(5, 20, number), rng.uniform(1, 8, number)
        budget = int(rng.integers(2, 60))

        def value(order, first=first, between=between, home=home, data=data, rates=rates, budget=budget):
            if not order:
                return 0.0
            flown = first[order[0]] + sum(between[a, b] for a, b in itertools.pairwise(order))
            hovering = budget - 1 - flown - home[order[-1]]
            needed = sum(max(0.0, data[k] / rates[k] - 1.0) for k in order)
            missing = max(0.0, needed - hovering) * rates[order[-1]]
            return sum(data[k] for k in order) - missing if hovering >= 0 else -np.inf

        orders = [order for size in range(number + 1) for order in itertools.permutations(range(number), size)]
        found = best_tour(first, between, home, data, rates, budget).tolist()
        assert value(found) == pytest.approx(max(map(value, orders)), abs=0.1)  # of near equals the shorter one


@pytest.mark.parametrize("name", ["Manhattan32-CPP-v0", "Block8-CPP-v0", "Manhattan32-DH-Team-v0", "Urban50-CPP-Team-v0"])
def test_it_says_what_it_is_for(name):
    with pytest.raises(ValueError, match=r"tsp is for data harvesting by one UAV .*boustrophedon.*planner") as caught:
        find_agent("tsp").make(load_scenario(name))
    assert name in str(caught.value)
    with pytest.raises(ValueError, match="Test-v0"):
        find_agent("tsp").make(scenario(OPEN, COVERAGE))
