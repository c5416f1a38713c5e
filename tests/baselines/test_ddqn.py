"""DDQN: the paper's sizes, targets, memory; training that is the same however often it is interrupted."""

from dataclasses import asdict, replace

import numpy as np
import pytest
import worlds
from learning import CPP, DDQN, DH, SOURCE, TINY, spoilt, torch, training

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.agents.weights import load_weights, save_weights
from uavbench.evaluation.evaluate import AgentError, Job, evaluate
from uavbench.evaluation.metrics import compare
from uavbench.learning.train import train
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator
from uavbench.world.city_source import Cities
from uavbench.world.resources import shipped_weights


@pytest.mark.parametrize(
    ("name", "options", "inputs", "parameters"),
    [
        ("Manhattan32-CPP-v0", {}, 4001, 1_173_702),
        ("Urban50-CPP-v0", {}, 3233, 977_094),
        ("Manhattan32-CPP-v0", {"local_size": 0, "global_scale": 1}, 48_401, None),
    ],
)
def test_sizes_are_those_of_the_paper(name, options, inputs, parameters):
    """Tables I and IV; the parameters printed there are those of six layers, not four."""
    observer = Observer(load_scenario(name).with_observation(options.get("local_size"), options.get("global_scale")))
    network = DDQN.Network(observer)
    assert network.inputs == inputs
    if parameters:
        assert sum(each.numel() for each in network.parameters()) == parameters
        six = {"local_shape": (6, *observer.local_shape[1:]), "global_shape": (6, *observer.global_shape[1:])}
        wide = DDQN.Network(type("Six", (), six))
        assert sum(each.numel() for each in wide.parameters()) == parameters + 1600


def test_values_depend_on_every_input():
    observer = Observer(load_scenario("Manhattan32-DH-v0"))
    network = DDQN.Network(observer, budget_scale=0.1)
    observation = {name: torch.rand(2, *values.shape[1:]) for name, values in observer.empty(1).items()}
    before = network(observation)
    assert before.shape == (2, 6)
    for name in observation:
        assert not torch.equal(network({**observation, name: observation[name] + 1.0}), before)


def returns(rewards, ends, bootstraps, discount, trace):
    """λ-returns by their definition: sums of n-step returns, each weighted by λ."""
    steps, batch = rewards.shape
    found = np.zeros_like(rewards)
    for b in range(batch):
        for t in range(steps):
            total, weight, past, factor = 0.0, 1.0, 0.0, 1.0
            for n in range(t, steps):
                past += factor * rewards[n, b]
                factor *= discount
                final = n == steps - 1 or ends[n, b]
                ahead = past + (0.0 if ends[n, b] else factor * bootstraps[n, b])
                share = weight if final else weight * (1 - trace)
                total += share * ahead
                weight *= trace
                if final:
                    break
            found[t, b] = total
    return found


@pytest.mark.parametrize("trace", [0.0, 0.7, 1.0])
def test_targets_are_lambda_returns_and_stop_where_episodes_end(trace):
    random = np.random.default_rng(0)
    rewards, ends = random.normal(size=(5, 7)).astype(np.float32), random.random((5, 7)) < 0.3
    bootstraps = random.normal(size=(5, 7)).astype(np.float32)
    learner = DDQN.Learner(CPP, replace(TINY, td_lambda=trace), 0)
    found = learner._returns(rewards, ends, bootstraps)
    assert found == pytest.approx(returns(rewards, ends, bootstraps, TINY.discount, trace), abs=1e-5)
    if trace == 0.0:  # eq. 18
        assert found == pytest.approx(rewards + TINY.discount * np.where(ends, 0.0, bootstraps), abs=1e-6)


def test_double_q_takes_the_online_networks_action_and_the_target_networks_value():
    learner = DDQN.Learner(
        CPP, replace(TINY, batch=2, segment=1, td_lambda=0.0, discount=1.0, learning_rate=0.0, lr_warmup=0, huber=0.0), 0
    )
    learner.advance()
    with torch.no_grad():
        for own, slow in ((learner.network, 1.0), (learner._target, 2.0)):
            for each in own.parameters():
                each.zero_()
            own.dense[-1].bias.copy_(slow * torch.tensor([0.0, 3.0, 1.0, 0.0, 0.0, 0.0]) if slow == 1.0 else torch.arange(6.0))
    seen = {}
    learner._returns = lambda rewards, ends, bootstraps: seen.setdefault("bootstraps", bootstraps) * 0.0
    learner._learn()
    assert (seen["bootstraps"] == 1.0).all()  # the target network's value of action 1, not its own best


CITIES = {"generator": "mixed-v0", "shape": (12, 10), "validation": 2, "test": 2}
REMEMBERED = {
    "CPP": CPP,
    "DH": DH,
    "layer": worlds.scenario(CPP.rows, worlds.SURVEILLANCE),
    "cities": worlds.scenario((), cities=Cities.model_validate(CITIES), budget=(5, 9)),
}


@pytest.mark.parametrize("scenario", REMEMBERED.values(), ids=REMEMBERED)
def test_memory_gives_back_what_was_observed(scenario):
    number, length = 4, 16
    simulator, observer = Simulator(scenario, number), Observer(scenario)
    slots = np.arange(number)
    simulator.reset(slots, "train", slots)
    replay, random, history = DDQN.Replay(scenario, number, number * length), np.random.default_rng(0), []
    for _ in range(40):  # more than fit
        seen = observer.empty(number)
        observer.write(simulator.state, slots, seen)
        actions = random.integers(0, 6, number)
        replay.add_states(simulator.state)
        simulator.step(actions)
        done = simulator.state.done[:, 0].copy()
        replay.add_results(actions, simulator.state.reward[:, 0], done)
        history.append((seen, actions, simulator.state.reward[:, 0].copy(), done))
        if done.any():
            simulator.reset(np.flatnonzero(done), "train", 100 + len(history) + np.flatnonzero(done))
    kept = [
        (number_, t) for t in range(40 - length, 40 - 3) for number_ in range(number)
    ]  # where segments of three steps may begin
    found = set()
    for k in range(30):
        observation, actions, rewards, ends = replay.sample(6, 3, np.random.default_rng(k))
        maps = {name: values.numpy().reshape(4, 6, *values.shape[1:]) for name, values in observation.items()}
        for b in range(6):
            matches = [
                (e, t)
                for e, t in kept
                if all(
                    np.array_equal(actions[i, b], history[t + i][1][e])
                    and np.allclose(rewards[i, b], history[t + i][2][e], atol=1e-6)
                    and ends[i, b] == history[t + i][3][e]
                    for i in range(3)
                )
                and all(
                    np.allclose(maps[name][i, b], history[t + i][0][name][e], rtol=1e-3, atol=1e-6)
                    for i in range(4)
                    for name in maps
                )
            ]
            assert matches
            found.update(matches)
            if b == 0:
                assert any(t == 40 - 4 for _, t in matches)  # the newest that is complete
    assert len(found) > 0.8 * len(kept)


def test_careful_environments_never_lose_the_way_home():
    learner = DDQN.Learner(
        CPP, replace(TINY, safe_exploration=1.0, random_start_fraction=1.0, last_random_start_fraction=1.0, num_envs=32), 0
    )
    state, home = learner._simulator.state, learner._simulator.city.distance_to_landing
    for _ in range(200):
        learner._act(explore=True)
        here = state.position[:, 0]
        assert (state.budget[:, 0] > home[here[:, 0], here[:, 1]]).all()
    assert not learner._replay.arrays["reward"].min() < -10 * TINY.reward_scale  # no crash
    careless = DDQN.Learner(CPP, replace(TINY, safe_exploration=0.0, num_envs=32), 0)
    for _ in range(100):
        careless._act(explore=True)
    assert careless._replay.arrays["reward"].min() < -10 * TINY.reward_scale


def test_weights_tell_how_they_came_about_and_fly(tmp_path):
    kept = train(training(), tmp_path)
    record = load_weights(kept)[1]
    assert record["scenario"] == CPP.id
    assert record["config"]["updates"] == 40
    assert {"uavbench", "python", "torch"} <= record["versions"].keys()
    found = find_agent(str(kept))
    assert found.name == "ddqn-tiny-0"
    records = list(evaluate(Job(found, CPP, "validation"), range(5)))
    assert len(records) == 5
    assert found.trained_on == CPP.id
    for name, reason in (("Manhattan32-CPP-v0", "have local_size 9, not 17"), (DH.id, "another mission than")):
        with pytest.raises(AgentError, match=reason) as error:
            list(evaluate(Job(found, load_scenario(name), "validation"), range(1)))
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "array", "reason"),
    [
        ("dense.6.bias", np.full(6, np.nan, dtype=np.float32), "dense.6.bias: holds numbers that are not finite"),
        ("dense.6.bias", np.zeros(5, dtype=np.float32), r"dense.6.bias has shape \(5,\), expected \(6,\)"),
        ("dense.6.bias", None, r"dense.6.bias has shape None, expected \(6,\)"),
        ("budget_scale", np.ones(2), r"budget_scale has shape \(2,\), expected \(1,\)"),
    ],
)
def test_weights_that_do_not_fit_are_refused_in_one_line(name, array, reason, tmp_path):
    kept = train(training(), tmp_path)
    arrays, record = load_weights(kept)
    save_weights(kept, spoilt(arrays, name, array), record)
    with pytest.raises(AgentError, match=reason) as error:
        list(evaluate(Job(find_agent(str(kept)), CPP, "validation"), range(1)))
    assert "\n" not in str(error.value)


#: Names of fields of a configuration, by those that they had when the shipped weights were trained.
RENAMED = {
    "environments": "num_envs",
    "trace": "td_lambda",
    "replay": "buffer_size",
    "prefill": "learning_starts",
    "rate": "learning_rate",
    "last_rate": "last_learning_rate",
    "warmup": "lr_warmup",
    "flat": "lr_hold",
    "anywhere": "random_start_fraction",
    "last_anywhere": "last_random_start_fraction",
    "careful": "safe_exploration",
    "last_careful": "last_safe_exploration",
}


def test_shipped_weights_fly_as_the_paper_says():
    """A few episodes of each scenario; the leaderboard has all. In cities that it has not seen, the agent is weaker."""
    shipped, least = shipped_weights("ddqn"), {"Manhattan32": (0.9, 0.6), "Urban50": (0.9, 0.6), "Cities32": (0.75, 0.35)}
    assert shipped.keys() == {f"{city}-{mission}-v0" for city in least for mission in ("CPP", "DH")}
    for name, path in shipped.items():
        landed, cral = least[name.split("-")[0]]
        assert path.stat().st_size < 5_000_000
        record = load_weights(path)[1]
        config = {RENAMED.get(field, field): value for field, value in record["config"].items()}
        assert {"crash_scale": 1.0, **config} == asdict(DDQN.CONFIGS[record["config_name"]])
        assert (record["config_name"] == "finish") == (record.get("start_sha256") is not None)
        scenario = load_scenario(name)
        records = list(evaluate(Job(SOURCE, scenario, "validation"), range(50)))
        assert np.mean([record.landed for record in records]) > landed
        assert np.mean([record.cral for record in records]) > cral
        assert SOURCE.digest(scenario) not in (SOURCE.sha256, SOURCE.digest(CPP))


def test_a_crash_may_cost_more_and_nothing_else_does():
    rewards = []
    for scale in (1.0, 3.0):
        learner = DDQN.Learner(CPP, replace(TINY, crash_scale=scale, safe_exploration=0.0), 0)
        for _ in range(30):
            learner._act(explore=True)
        rewards.append(learner._replay.arrays["reward"][:30])
    less = rewards[1] != rewards[0]
    assert less.any()
    assert not less.all()
    np.testing.assert_allclose((rewards[1] - rewards[0])[less], 2.0 * TINY.reward_scale * CPP.rewards.crash, rtol=1e-5)
    assert learner._replay.arrays["done"][:30][less].all()


def test_the_papers_configuration_is_the_papers():
    """Section IV and the authors' configuration files."""
    paper = DDQN.CONFIGS["paper"]
    assert (paper.updates, paper.num_envs, paper.batch, paper.segment, paper.td_lambda) == (2_000_000, 1, 128, 1, 0.0)
    assert (paper.buffer_size, paper.learning_starts, paper.learning_rate, paper.amsgrad) == (50_000, 25_000, 3e-5, True)
    assert (paper.discount, paper.soft_update, paper.temperature) == (0.95, 0.005, 0.1)
    assert (paper.reward_scale, paper.budget_scale, paper.random_start_fraction, paper.safe_exploration, paper.clip) == (
        1.0,
        1.0,
        0.0,
        0.0,
        0.0,
    )
    learner = DDQN.Learner(CPP, replace(paper, learning_starts=100, updates=10), 0)
    for _ in range(3):
        learner.advance()
    assert learner.samples == 3 * 128


@pytest.mark.slow
@pytest.mark.parametrize("scenario", [CPP, DH], ids=["CPP", "DH"])
def test_a_minute_of_training_beats_random_clearly(scenario, tmp_path):
    config = replace(DDQN.CONFIGS["fast"], updates=1000, validation=200)
    kept = train(training(config, scenario), tmp_path)
    learned, random = (
        np.array([record.cral for record in evaluate(Job(find_agent(name), scenario, "test"), range(300))])
        for name in (str(kept), "random")
    )
    assert compare(learned, random).difference.low > 0.2
