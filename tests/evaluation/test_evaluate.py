"""Evaluation: scores that depend on nothing but agent and episodes, and clear words when an agent fails."""

from pathlib import Path

import numpy as np
import pytest

import uavbench
from uavbench import load_scenario
from uavbench.agents.agent import AgentLoadError, find_agent
from uavbench.evaluation.evaluate import NO_ACTION, AgentError, Job, evaluate
from uavbench.simulation.simulator import Simulator
from uavbench.simulation.state_view import StateView

AGENTS = Path(__file__).parents[1] / "helpers" / "agents.py"
TEAM = "Manhattan32-DH-Team-v0"


def job(name, scenario="Block8-DH-v0", **changes):
    source = find_agent(name if name in ("random", "greedy") else f"{AGENTS}:{name}")
    return Job(source, load_scenario(scenario), "test", **changes)


def scores(job, numbers=range(30), workers=0):
    """All that a record holds, but for the time it took."""
    return {
        r.episode: (r.uavs, r.budget, r.steps, r.landed, r.cr, r.cral, r.blocked, r.total_reward, r.actions.tobytes())
        for r in evaluate(job, numbers, workers)
    }


@pytest.mark.parametrize("scenario", ["Block8-CPP-v0", "Manhattan32-DH-v0", TEAM])
def test_the_score_does_not_depend_on_batch_size_workers_order_or_kind_of_agent(scenario):
    expected = scores(job("One", scenario))
    assert len(expected) == 30
    assert scores(job("Many", scenario)) == expected
    assert scores(job("Many", scenario, batch_size=7)) == expected
    assert scores(job("Many", scenario, batch_size=1)) == expected
    assert scores(job("One", scenario), range(29, -1, -1)) == expected
    assert scores(job("One", scenario), workers=2) == expected
    assert scores(job("Many", scenario, batch_size=4), workers=1) == expected
    assert scores(job("Together", scenario)) == expected


@pytest.mark.parametrize("scenario", ["Block8-CPP-v0", TEAM])
@pytest.mark.parametrize("name", ["random", "greedy"])
def test_built_ins_do_not_depend_on_the_batch_either(name, scenario):
    assert scores(job(name, scenario), range(12)) == scores(job(name, scenario, batch_size=5), range(11, -1, -1))


@pytest.mark.parametrize("scenario", ["Manhattan32-CPP-Team-v0", TEAM])
def test_a_team_flies_as_in_its_environment(scenario):
    """The actions of a record, flown through PettingZoo, give its numbers to the last bit."""
    env = uavbench.parallel_env(scenario)
    for record in evaluate(job("random", scenario), range(8)):
        env.reset(options={"split": "test", "episode": record.episode})
        assert len(env.agents) == record.uavs
        assert env.simulator.state.budget[0, : record.uavs].sum() == record.budget
        total = steps = 0
        for row in record.actions.tolist():
            assert [f"uav_{u}" for u, action in enumerate(row) if action != NO_ACTION] == env.agents
            steps += len(env.agents)
            _, rewards, _, _, infos = env.step({agent: row[int(agent[-1])] for agent in env.agents})
            for reward in rewards.values():
                total += reward
        assert env.agents == []
        assert (record.steps, record.total_reward) == (steps, total)
        info = next(iter(infos.values()))
        assert (record.landed, record.cr, record.cral, record.blocked) == tuple(
            info[key] for key in ("landed", "cr", "cral", "blocked")
        )


def test_a_record_tells_what_happened():
    for record in evaluate(job("One"), range(10)):
        simulator = Simulator(load_scenario("Block8-DH-v0"), 1)
        simulator.reset([0], "test", [record.episode])
        assert record.budget == simulator.state.budget[0]
        total = 0.0
        for action in record.actions:
            assert not simulator.state.done[0]
            simulator.step(action)
            total += simulator.state.reward[0, 0]
        assert simulator.state.done[0]
        outcome = simulator.outcomes([0])
        assert (record.landed, record.cr, record.cral, record.blocked) == tuple(v[0] for v in outcome.values())
        assert (record.steps, record.total_reward) == (len(record.actions), total)


@pytest.mark.parametrize("scenario", ["Block8-CPP-v0", "Block8-DH-v0", TEAM])
def test_the_state_track_shows_everything_and_nothing_can_be_written(scenario):
    assert len(scores(job("Seer", scenario), range(5))) == 5


@pytest.mark.parametrize("scenario", ["Block8-CPP-v0", "Block8-DH-v0", "Cities32-CPP-v0"])
def test_who_asks_for_safe_actions_is_told_them(scenario):
    records = list(evaluate(job("Careful", scenario), range(30)))
    assert all(record.landed for record in records)
    assert not all(record.landed for record in evaluate(job("One", scenario), range(30)))
    with pytest.raises(AgentLoadError, match=r"Careless\.safe_mask is 'yes'; use True or False"):
        job("Careless", scenario).source.load()


def test_an_agent_for_teams_flies_alone_too():
    assert len(scores(job("OnlyTogether", "Block8-CPP-v0"), range(5))) == 5


def test_the_observation_track_does_not_show_the_state():
    assert len(scores(job("Blind"), range(3))) == 3


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Raises", "act() raised RuntimeError: lost my way"),
        ("WrongShape", "act() returned [1, 2] (int64 of shape (2,)), expected an integer from 0 to 5"),
        ("NotANumber", "act() returned nan (float64), expected an integer"),
        ("OutOfRange", "act() returned 6, expected an integer from 0 to 5"),
        ("Nothing", "act() returned None (object), expected an integer"),
        ("Ragged", "act() returned [[1, 2], [3]], which is no array of integers"),
        ("Exits", "act() raised SystemExit: 0"),
        ("ExitsInArray", "which is no array of integers: SystemExit: 0"),
        ("Unreadable", "act() raised HiddenError: HiddenError, which cannot say what it is"),
    ],
)
def test_a_failing_agent_is_told_where_and_why(name, reason):
    with pytest.raises(AgentError) as caught:
        list(evaluate(job(name), range(10)))
    message = str(caught.value)
    assert message.startswith(f"agents.{name} on Block8-DH-v0, test episode 3, step 3: ")
    assert reason in message
    if name == "Raises":
        assert 'raise RuntimeError("lost my way")' in message
        assert "agents.py" in message
        assert "evaluate.py" not in message


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("TooMany", "test episode 0, step 0: act_team() returned shape (4,), expected (3,)"),
        ("WrongTogether", "test episode 0, step 0, UAV 1: act_team() returned np.int64(8), expected an integer from 0 to 5"),
        ("WrongAlone", "test episode 0, step 0, UAV 1: act() returned 8, expected an integer from 0 to 5"),
    ],
)
def test_who_of_a_team_fails_is_told(name, reason):
    with pytest.raises(AgentError) as caught:
        list(evaluate(job(name, "Urban50-DH-Team-v0"), range(3)))
    assert reason in str(caught.value)


def finished_before_failure(failing, workers=1):
    flown, finished = evaluate(failing, range(10), workers), []
    with pytest.raises(AgentError):
        finished.extend(iter(lambda: next(flown).episode, None))
    return finished


def test_what_was_finished_before_a_failure_is_yielded():
    assert finished_before_failure(job("OutOfRange")) == [0, 1, 2]
    assert {0, 1, 2} <= set(finished_before_failure(job("OutOfRange"), workers=2))


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("WrongBatch", "act_batch() returned shape (10, 1), expected (10,)"),
        ("BadBatch", "test episode 3, step 0: act_batch() returned np.int64(7)"),
        ("RaggedBatch", "test episodes 0 to 9, step 0: act_batch() returned [[1], [2, 3]], which is no array"),
        ("RaisingBatch", "test episodes 0 to 9, step 0: act_batch() raised RuntimeError: lost"),
        ("BadInit", "__init__() raised OSError: no weights"),
    ],
)
def test_batches_and_constructors_are_checked_too(name, reason):
    with pytest.raises(AgentError) as caught:
        list(evaluate(job(name), range(10)))
    assert reason in str(caught.value)


@pytest.mark.parametrize("name", ["Slow", "Compiled", "Stubborn", "Deaf", "EndlessArray"])
def test_a_decision_that_takes_too_long_is_stopped_whatever_the_agent_does(name):
    finished = []
    with pytest.raises(AgentError, match=r"test episode 3, step 3: act\(\) took longer than 1 s\nTraceback") as told:
        finished.extend(record.episode for record in evaluate(job(name, decision_timeout=1.0), range(10), workers=1))
    assert str(told.value).splitlines()[-1].endswith("in answer") or name in ("Stubborn", "EndlessArray")
    assert "agents.py" in str(told.value)
    assert "evaluate.py" not in str(told.value)
    assert finished == [0, 1, 2]


def test_a_hanging_reset_is_stopped():
    with pytest.raises(AgentError, match=r"episode 0, step 0: reset\(\) took longer than 1 s"):
        list(evaluate(job("HangingReset", decision_timeout=1.0), range(3), workers=1))


def test_two_evaluations_at_once_keep_their_own_limits():
    """Each in turn yields an episode; then one hangs."""
    calm, hanging = (
        evaluate(job("One"), range(10), workers=1),
        evaluate(job("Slow", decision_timeout=1.0), range(10), workers=1),
    )
    assert [next(flown).episode for _ in range(3) for flown in (calm, hanging)] == [0, 0, 1, 1, 2, 2]
    calm.close()
    with pytest.raises(AgentError, match="took longer than 1 s"):
        next(hanging)


@pytest.mark.slow
def test_compiling_is_not_the_agents_time():
    records = list(evaluate(job("Compiles", decision_timeout=0.5), range(3), workers=1))
    assert sum(record.seconds for record in records) < 0.5


@pytest.mark.parametrize(("name", "status"), [("Dies", 1), ("DiesQuietly", 0)])
@pytest.mark.parametrize("workers", [1, 2])
def test_a_process_that_ends_is_a_failing_agent(name, status, workers):
    with pytest.raises(
        AgentError, match=rf"agents\.{name} on Block8-DH-v0: its process ended itself with the exit status {status}"
    ):
        list(evaluate(job(name), range(10), workers=workers))


def test_a_worker_flies_only_the_files_that_it_was_told_of():
    with pytest.raises(AgentError, match="its files changed while it was loaded"):
        list(evaluate(job("One", agent_sha256="0" * 64), range(3), workers=1))


@pytest.mark.parametrize("number", [-1, 1000])
def test_an_episode_that_is_not_there_is_refused(number):
    with pytest.raises(ValueError, match="out of range"):
        list(evaluate(job("One"), [number]))


@pytest.mark.slow
def test_greedy_beats_random_by_a_wide_margin_and_always_lands():
    teams = [name for name in uavbench.list_scenarios() if "Team" in name]
    for scenario in ("Manhattan32-CPP-v0", "Urban50-CPP-v0", "Manhattan32-DH-v0", "Urban50-DH-v0", *teams):
        greedy = list(evaluate(job("greedy", scenario), range(40)))
        chance = list(evaluate(job("random", scenario), range(40)))
        assert all(record.landed for record in greedy)
        assert np.mean([r.landed for r in chance]) > 0.5
        assert np.mean([r.cral for r in greedy]) > np.mean([r.cral for r in chance]) + 0.5


def test_greedy_uavs_do_not_chase_the_same_target():
    """At every decision each has a goal of its own, and none that another will have served."""
    for name in ("Manhattan32-CPP-Team-v0", TEAM):
        agent = find_agent("greedy").make(load_scenario(name))
        env = uavbench.parallel_env(name, num_uavs=3)
        several = 0
        for episode in range(4):
            env.reset(options={"split": "validation", "episode": episode})
            for _ in range(25):
                flying = [int(name[-1]) for name in env.agents]
                if not flying:
                    break
                states = [StateView(env.simulator, 0, u) for u in flying]
                goals = agent._goals(states)
                assert len(set(goals.values())) == len(goals)
                several += len(goals) == 3
                actions = agent.act_team([{}] * len(flying), [{"state": state} for state in states])
                env.step({f"uav_{u}": action for u, action in zip(flying, actions, strict=True)})
        assert several > 20


def test_more_uavs_do_more():
    for mission in ("CPP", "DH"):
        means = []
        for number in (1, 2, 3):
            world = load_scenario(f"Manhattan32-{mission}-Team-v0").with_uavs(number)
            records = list(evaluate(Job(find_agent("greedy"), world, "test"), range(40)))
            assert {record.uavs for record in records} == {number}
            means.append(np.mean([record.cral for record in records]))
        assert means[0] + 0.05 < means[1] < means[2]
