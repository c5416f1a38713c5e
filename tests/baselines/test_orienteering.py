"""Orienteering: always home in time, better than greedy, and at a loss nowhere."""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import COVERAGE, HARVESTING, draw_devices, draw_start, draw_targets, maps, scenario

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.envs.env import UAVEnv
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.simulation.state_view import StateView
from uavbench.world.city import HOVER, LAND

pytest.importorskip("pyvrp", reason="needs the extra planning")

ORIENTEERING = find_agent("orienteering")


def records(agent, name, numbers, **changes):
    return {r.episode: r for r in evaluate(Job(find_agent(agent), load_scenario(name), "test", **changes), numbers)}


def fly(world, **options):
    """Fly an episode set by hand; return what the last info says, and the actions."""
    env = UAVEnv(world)
    agent = ORIENTEERING.make(world)
    observation, info = env.reset(options=options)
    state = StateView(env.simulator, 0)
    info = {**info, "state": state, "seed": 1, "uav": 0, "episode": 0}
    agent.reset(info)
    actions, ended = [], False
    while not ended:
        actions.append(agent.act(observation, {**info, "state": state}))
        observation, _, ended, truncated, info = env.step(actions[-1])
        ended = ended or truncated
    return info, actions


def mask(rows, *cells):
    targets = np.zeros((len(rows), len(rows[0])), dtype=bool)
    targets[tuple(zip(*cells, strict=True))] = True
    return targets


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "episodes"),
    [("Manhattan32-CPP-v0", 30), ("Urban50-CPP-v0", 4), ("Manhattan32-DH-v0", 30), ("Urban50-DH-v0", 10)],
)
def test_it_lands_and_does_better_than_greedy(name, episodes):
    found, greedy = records("orienteering", name, range(episodes)), records("greedy", name, range(episodes))
    assert all(record.landed for record in found.values())
    assert np.mean([record.cral - greedy[n].cral for n, record in found.items()]) > 0.02


@pytest.mark.parametrize("name", ["Block8-CPP-v0", "Block8-DH-v0"])
def test_it_lands_on_the_smallest_map_and_acts_alike_in_any_company(name):
    found, again = records("orienteering", name, range(20)), records("orienteering", name, range(19, -1, -1), batch_size=3)
    assert all(record.landed for record in found.values())
    for number, record in found.items():
        assert np.array_equal(record.actions, again[number].actions)


ROWS = ("L....", ".....", "..#..", ".....", ".....")


@pytest.mark.parametrize("budget", [1, 2])
@pytest.mark.parametrize("mission", [COVERAGE, HARVESTING])
def test_with_next_to_no_budget_it_lands(mission, budget):
    aim = {"targets": mask(ROWS, (4, 4))} if mission is COVERAGE else {"devices": [[4, 4, 20.0]]}
    info, actions = fly(scenario(ROWS, mission, budget=(1, 40)), start=[0, 0], budget=budget, **aim)
    assert info["landed"]
    assert actions[-1] == LAND


def test_a_target_that_nothing_sees_keeps_it_at_home():
    rows = ("L..###", "...#.#", "...###", "......")
    info, actions = fly(scenario(rows), start=[0, 0], budget=30, targets=mask(rows, (1, 4)))
    assert info["landed"]
    assert actions == [LAND]


def test_a_target_too_far_away_keeps_it_at_home():
    rows = ("L" + "." * 19,) * 4
    info, actions = fly(scenario(rows), start=[0, 0], budget=20, targets=mask(rows, (0, 19)))
    assert info["landed"]
    assert actions == [LAND]


def test_a_target_in_reach_to_the_last_action_is_covered():
    rows = ("L" + "." * 9,) * 4
    info, actions = fly(scenario(rows), start=[0, 0], budget=7, targets=mask(rows, (0, 5)))  # seen from three moves away
    assert info["landed"]
    assert info["cr"] == 1.0
    assert len(actions) == 7


WALLED = ("L.N...", "NNN...", "......", "......")


def test_walled_in_it_covers_what_it_sees_from_there():
    info, actions = fly(scenario(WALLED), start=[0, 0], budget=20, targets=mask(WALLED, (1, 1), (3, 5)))
    assert info["landed"]
    assert info["cr"] == 0.5
    assert actions == [HOVER, LAND]


@pytest.mark.parametrize("mission", [COVERAGE, HARVESTING])
def test_walled_in_it_lands(mission):
    aim = {"targets": mask(WALLED, (3, 5))} if mission is COVERAGE else {"devices": [[3, 5, 20.0]]}
    info, _ = fly(scenario(WALLED, mission), start=[0, 0], budget=20, **aim)
    assert info["landed"]


def test_a_device_in_a_no_fly_zone_is_emptied_from_beside():
    rows = ("L......", ".......", "...NNN.", "...NNN.", "...NNN.", ".......")
    world = scenario(rows, {**HARVESTING, "edge_snr": -5.0})
    info, _ = fly(world, start=[0, 0], budget=40, devices=[[3, 4, 10.0]], noise=False)
    assert info["landed"]
    assert info["cr"] == pytest.approx(1.0)


def test_a_channel_through_which_nothing_comes_keeps_it_at_home():
    rows = ("L" + "." * 19,) * 4
    world = scenario(rows, {**HARVESTING, "edge_snr": -200.0})
    info, actions = fly(world, start=[0, 0], budget=40, devices=[[3, 19, 20.0]])
    assert info["landed"]
    assert actions == [LAND]


@settings(max_examples=30)
@given(st.data())
def test_on_any_map_it_comes_home(data):
    rows = data.draw(maps())
    start, budget = list(draw_start(data, rows)), data.draw(st.integers(1, 25))
    if data.draw(st.booleans()):
        world, aim = scenario(rows, budget=(1, 40)), {"targets": draw_targets(data, rows)}
    else:
        world, aim = scenario(rows, HARVESTING, budget=(1, 40)), {"devices": draw_devices(data, rows)}
    info, _ = fly(world, start=start, budget=budget, **aim)
    assert info["landed"]
    assert info["blocked"] == 0


def test_more_iterations_are_searched_in_silence(monkeypatch):
    monkeypatch.setattr(ORIENTEERING.load(), "iterations", 1200)  # enough for PyVRP to adapt, and warn of, its penalties
    assert records("orienteering", "Block8-CPP-v0", range(2))[1].landed


def test_teams_are_refused():
    with pytest.raises(ValueError, match="for one UAV; Manhattan32-CPP-Team-v0 is for teams"):
        ORIENTEERING.make(load_scenario("Manhattan32-CPP-Team-v0"))


def test_large_maps_are_refused():
    with pytest.raises(ValueError, match="more than 128×128 cells, as Test-v0 has: choose planner"):
        ORIENTEERING.make(scenario(["L" + "." * 128] * 129))


def test_without_pyvrp_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvrp", None)
    with pytest.raises(ImportError, match=r"pip install 'uavbench\[planning\]'"):
        ORIENTEERING.make(load_scenario("Block8-CPP-v0"))
