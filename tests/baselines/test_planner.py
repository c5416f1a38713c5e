"""The planner: always home, better than greedy, for one UAV and for teams. Its searches are tested in tests/planning."""

import numpy as np
import pytest
from worlds import COVERAGE, HARVESTING, scenario

import uavbench
from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.envs.parallel_env import UAVParallelEnv
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.planning import coverage, harvesting
from uavbench.simulation.state_view import StateView


def fly(name, world, seed=1, changes=100, **options):
    """Fly an episode with a built-in that plans for teams; return the last info and the actions."""
    env = world if isinstance(world, UAVParallelEnv) else UAVParallelEnv(world)
    agent = find_agent(name).make(env.scenario)
    agent.changes, agent.searches, agent.refined, agent.mending_changes = changes, 1, 0, 300
    observations, infos = env.reset(seed=0, options=options)
    flown = []
    told = {k: {"seed": seed, "uav": k, "state": StateView(env.simulator, 0, k)} for k in range(len(env.agents))}
    if hasattr(agent, "reset"):
        agent.reset(told[0])
    while env.agents:
        flying = [int(each[-1]) for each in env.agents]
        actions = agent.act_team([observations[each] for each in env.agents], [told[k] for k in flying])
        flown.append(actions)
        observations, _, _, _, infos = env.step(dict(zip(env.agents, actions, strict=True)))
    return next(iter(infos.values())), flown


@pytest.mark.parametrize("name", [f"{city}-{mission}-v0" for city in ("Manhattan32", "Urban50") for mission in ("CPP", "DH")])
def test_always_lands_and_beats_greedy(name):
    world, better = load_scenario(name), []
    for number in range(6):
        ours, _ = fly("planner", world, split="validation", episode=number)
        theirs, _ = fly("greedy", world, split="validation", episode=number)
        assert ours["landed"]
        better.append(ours["cral"] - theirs["cral"])
    assert np.mean(better) > 0.01  # with a thirtieth of the default effort or less


@pytest.mark.parametrize("mission", ["CPP", "DH"])
def test_teams_always_land_and_beat_greedy(mission):
    env, better = uavbench.parallel_env(f"Manhattan32-{mission}-Team-v0"), []
    for number in range(6):
        ours, _ = fly("planner", env, split="validation", episode=number)
        theirs, _ = fly("greedy", env, split="validation", episode=number)
        assert ours["landed"]
        better.append(ours["cral"] - theirs["cral"])
    assert np.mean(better) > 0.0


@pytest.mark.parametrize("name", ["Manhattan32-CPP-v0", "Urban50-DH-v0", "Urban50-CPP-Team-v0", "Block8-DH-v0"])
def test_the_quick_one_lands_too_and_is_the_same_again(name):
    job = Job(find_agent("quick_planner"), load_scenario(name), "validation")
    flown = [[record.actions.tobytes() for record in evaluate(job, range(4))] for _ in range(2)]
    assert flown[0] == flown[1]
    assert all(record.landed for record in evaluate(job, range(12)))


@pytest.mark.slow
@pytest.mark.parametrize("uavs", [1, 2])
@pytest.mark.parametrize("mission", ["CPP", "DH"])
def test_flies_on_large_maps(mission, uavs):
    """Where distances are known in windows only: better than greedy, and the same again."""
    world = load_scenario(f"City128-{mission}-v0")
    if uavs > 1:
        same = {name: getattr(world, name) for name in type(world).model_fields}
        world = type(world).model_validate({**same, "splits": {}, "uavs": (uavs, uavs)})
    ours = [fly("planner", world, split="validation", episode=1) for _ in range(2)]
    theirs, _ = fly("greedy", world, split="validation", episode=1)
    assert ours[0][0]["landed"]
    assert ours[0][0]["cral"] > theirs["cral"]
    assert ours[0][1] == ours[1][1]


def test_the_same_seed_flies_the_same():
    for name in ("Block8-CPP-v0", "Block8-DH-v0"):
        world = load_scenario(name)
        flights = [fly("planner", world, seed=s, split="test", episode=3)[1] for s in (5, 5)]
        assert flights[0] == flights[1]


@pytest.mark.parametrize("budget", [1, 2, 3, 30])
@pytest.mark.parametrize("kind", ["coverage", "harvesting"])
def test_lands_whatever_there_is_to_do(kind, budget):
    rows = ("N....", "NLL..", "N....", "..###", "..#.#")
    if kind == "coverage":
        targets = np.zeros((5, 5), bool)
        targets[4, 3] = True  # nobody gets there, nor sees it
        info, _ = fly("planner", scenario(rows), start=[1, 1], budget=budget, targets=targets)
    else:
        info, _ = fly("planner", scenario(rows, HARVESTING), start=[1, 1], budget=budget, devices=[[4, 3, 5.0]])
    assert info["landed"]


@pytest.mark.parametrize("all_can_be_had", [True, False])
@pytest.mark.parametrize("mission", [COVERAGE, HARVESTING])
def test_searches_while_there_is_more_to_get(mission, all_can_be_had, monkeypatch):
    module, searches = harvesting if mission is HARVESTING else coverage, []
    search = module.search

    def counted(*arguments, seed, moves, **options):
        searches.extend([(seed, moves)] if moves else [])  # without moves it only values a flight
        return search(*arguments, seed=seed, moves=moves, **options)

    monkeypatch.setattr(module, "search", counted)
    world = scenario(("N....", "NLL..", "N....", ".....", "....."), mission)
    options = {"start": [1, 1], "budget": 30 if all_can_be_had else 3}
    if mission is HARVESTING:
        options["devices"] = [[4, c, 0.01 if all_can_be_had else 20.0] for c in range(3)]
    else:
        options["targets"] = np.ones((5, 5), bool)
    env = UAVParallelEnv(world)
    agent = find_agent("planner").make(world)
    agent.changes, agent.searches, agent.mending_changes = 100, 4, 300
    observations, _ = env.reset(seed=0, options=options)
    info = {"seed": 7, "uav": 0, "state": StateView(env.simulator, 0, 0)}
    agent.reset(info)
    for _ in range(2):
        (name,) = observations
        observations, *_ = env.step({name: agent.act_team([observations[name]], [info])[0]})
    effort = 100 * options["budget"]
    planned = [(seed, effort) for seed in ([7] if all_can_be_had else [7, 8, 9, 10])]
    if mission is COVERAGE and not all_can_be_had:
        planned += [(11, 2 * effort), (12, 2 * effort)]  # the two best plans are improved
    mended = [] if all_can_be_had or mission is COVERAGE else [(7, 300)]
    assert searches == planned + mended


@pytest.mark.parametrize("mission", [COVERAGE, HARVESTING])
def test_uavs_in_each_others_way_in_a_corridor_land(mission):
    world = scenario(("#########", "#LL.....#", "#########", "#########"), mission, uavs=(1, 2))
    more = {"devices": [[1, 7, 5.0]]}
    if mission is COVERAGE:
        targets = np.zeros((4, 9), bool)
        targets[1, 7] = True
        more = {"targets": targets}
    for budget in ([30, 30], [1, 30], [30, 2], [12, 5]):
        info, _ = fly("planner", world, num_uavs=2, start=[[1, 1], [1, 2]], budget=budget, **more)
        assert info["landed"]
