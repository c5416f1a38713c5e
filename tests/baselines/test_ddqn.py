"""DDQN: the paper's sizes, targets, memory; training that is the same however often it is interrupted."""

import os
import signal
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from uavbench import load_scenario
from uavbench.agent import AgentLoadError, find_agent
from uavbench.cli import app
from uavbench.evaluate import AgentError, Job, evaluate
from uavbench.metrics import compare
from uavbench.observation import Observer
from uavbench.resources import shipped_weights
from uavbench.simulator import Simulator
from uavbench.train import Point, TrainError, Training, read_config, train
from uavbench.weights import WeightsError, load_weights, save_weights

torch = pytest.importorskip("torch", reason="DDQN needs PyTorch: pip install 'uavbench[ddqn]'")
pytest.importorskip("safetensors", reason="DDQN needs safetensors: pip install 'uavbench[ddqn]'")

SOURCE = find_agent("ddqn")
DDQN = SOURCE.module()
CPP, DH = load_scenario("Block8-CPP-v0"), load_scenario("Block8-DH-v0")
TINY = replace(DDQN.CONFIGS["fast"], updates=40, environments=8, batch=4, segment=3, replay=256, prefill=64, validation=20)


def training(config=TINY, scenario=CPP, seed=0):
    return Training(SOURCE, scenario, "tiny", config, seed)


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
    learner = DDQN.Learner(CPP, replace(TINY, trace=trace), 0)
    found = learner._returns(rewards, ends, bootstraps)
    assert found == pytest.approx(returns(rewards, ends, bootstraps, TINY.discount, trace), abs=1e-5)
    if trace == 0.0:  # eq. 18
        assert found == pytest.approx(rewards + TINY.discount * np.where(ends, 0.0, bootstraps), abs=1e-6)


def test_double_q_takes_the_online_networks_action_and_the_target_networks_value():
    learner = DDQN.Learner(CPP, replace(TINY, batch=2, segment=1, trace=0.0, discount=1.0, rate=0.0, warmup=0, huber=0.0), 0)
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


@pytest.mark.parametrize("scenario", [CPP, DH], ids=["CPP", "DH"])
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
    learner = DDQN.Learner(CPP, replace(TINY, careful=1.0, anywhere=1.0, last_anywhere=1.0, environments=32), 0)
    state, home = learner._simulator.state, learner._simulator.city.home
    for _ in range(200):
        learner._act(explore=True)
        here = state.position[:, 0]
        assert (state.budget[:, 0] > home[here[:, 0], here[:, 1]]).all()
    assert not learner._replay.arrays["reward"].min() < -10 * TINY.reward_scale  # no crash
    careless = DDQN.Learner(CPP, replace(TINY, careful=0.0, environments=32), 0)
    for _ in range(100):
        careless._act(explore=True)
    assert careless._replay.arrays["reward"].min() < -10 * TINY.reward_scale


def weights_of(path):
    return {name: array.tobytes() for name, array in load_weights(path)[0].items()}


@pytest.mark.parametrize("scenario", [CPP, DH], ids=["CPP", "DH"])
def test_training_that_is_interrupted_ends_as_if_it_had_not_been(scenario, tmp_path):
    whole = train(training(scenario=scenario), tmp_path / "whole")

    def interrupt(updates):
        if updates == 27:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train(training(scenario=scenario), tmp_path / "parts", on_update=interrupt)
    with pytest.raises(TrainError, match="--resume"):
        train(training(scenario=scenario), tmp_path / "parts")
    updates = []
    parts = train(training(scenario=scenario), tmp_path / "parts", resume=True, on_update=updates.append)
    assert updates == list(range(28, 41))
    assert weights_of(whole.with_suffix(".checkpoint")) == weights_of(parts.with_suffix(".checkpoint"))
    assert weights_of(whole) == weights_of(parts)
    other = train(training(scenario=scenario, seed=1), tmp_path / "other")
    assert weights_of(other) != weights_of(whole)


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
    for name, reason in (("Manhattan32-CPP-v0", "another map than"), (DH.id, "another mission than")):
        with pytest.raises(AgentError, match=reason) as error:
            list(evaluate(Job(found, load_scenario(name), "validation"), range(1)))
        assert "\n" not in str(error.value)


def test_the_weights_that_are_kept_are_those_that_validate_best(tmp_path, monkeypatch):
    scores, seen = iter([0.3, 0.8, 0.5, 0.8]), []

    def validate(training, learner, folder, seconds):
        seen.append({name: array.copy() for name, array in learner.weights().items()})
        score = next(scores)
        return Point(learner.updates, learner.samples, seconds, 1.0, score, score)

    monkeypatch.setattr("uavbench.train._validate", validate)
    kept = train(training(replace(TINY, validation=10)), tmp_path)
    arrays, record = load_weights(kept)
    assert all(np.array_equal(arrays[name], seen[3][name]) for name in arrays)  # of two alike the later one
    scores = iter([0.3, 0.8, 0.5, 0.7])
    kept = train(training(replace(TINY, validation=10), seed=1), tmp_path)
    arrays, record = load_weights(kept)
    assert all(np.array_equal(arrays[name], seen[5][name]) for name in arrays)
    assert [point["updates"] for point in record["curve"]] == [10, 20]


def test_a_kill_after_weights_were_kept_makes_no_difference(tmp_path, monkeypatch):
    """The checkpoint is older than the weights then; the same updates are made again."""
    monkeypatch.setattr("uavbench.train._CHECKPOINT_SECONDS", 0.0)
    saved = []

    def keep(updates):
        if updates == 15:
            saved.append(checkpoint.read_bytes())

    checkpoint = training().files(tmp_path)[1]
    kept = train(training(), tmp_path, on_update=keep)
    whole = weights_of(kept), weights_of(checkpoint)
    checkpoint.write_bytes(saved[0])
    (checkpoint.parent / f".{checkpoint.name}.123").write_bytes(b"left by a process that was killed")
    train(training(), tmp_path, resume=True)
    assert (weights_of(kept), weights_of(checkpoint)) == whole
    assert not list(checkpoint.parent.glob(".*.123"))


def test_weights_that_are_gone_are_asked_for(tmp_path):
    kept = train(training(), tmp_path)
    kept.unlink()
    with pytest.raises(TrainError, match="the best weights so far are gone"):
        train(training(), tmp_path, resume=True)


def spoilt(arrays, name, array):
    found = {**arrays, name: array}
    return {key: value for key, value in found.items() if value is not None}


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("replay.reward", np.zeros(1, dtype=np.float32)),
        ("replay.reward", None),
        ("optimizer.99.exp_avg", np.zeros(3, dtype=np.float32)),
        ("surprise", np.zeros(3)),
        ("network.dense.0.bias", np.full(256, np.nan, dtype=np.float32)),
        ("counters", np.zeros(4, dtype=np.int32)),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_refused(name, array, tmp_path):
    train(training(), tmp_path)
    checkpoint = training().files(tmp_path)[1]
    arrays, record = load_weights(checkpoint)
    save_weights(checkpoint, spoilt(arrays, name, array), record)
    with pytest.raises(WeightsError, match="damaged") as error:
        train(training(), tmp_path, resume=True)
    assert "\n" not in str(error.value)
    save_weights(checkpoint, arrays, {key: value for key, value in record.items() if key != "curve"})
    with pytest.raises(WeightsError, match="damaged"):
        train(training(), tmp_path, resume=True)


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


def test_weights_of_a_learner_of_ones_own_fly_with_its_code(tmp_path):
    mine = tmp_path / "ddqn.py"  # called as a built-in
    mine.write_text(SOURCE.path.read_text(encoding="utf-8").replace(".argmax(dim=1).numpy()", ".argmax(dim=1).numpy() * 0 + 5"))
    source = find_agent(str(mine))
    kept = train(Training(source, CPP, "tiny", replace(TINY, updates=2, validation=2), 0), tmp_path)
    with pytest.raises(AgentLoadError, match=r"weights of your own ddqn: --agent ddqn.py --weights"):
        find_agent(str(kept))
    found = find_agent(str(mine), kept)
    assert found.name == "ddqn-tiny-0"
    assert all(record.steps == 1 for record in evaluate(Job(found, CPP, "test"), range(5)))
    assert found.digest(CPP) not in (source.digest(CPP), find_agent("ddqn", kept).digest(CPP))
    with pytest.raises(AgentLoadError, match="no such file"):
        find_agent(str(mine), tmp_path / "none")
    model = tmp_path / "m.onnx"
    model.write_bytes(b"")
    with pytest.raises(AgentLoadError, match="leave --weights out"):
        find_agent(str(model), kept)
    with pytest.raises(TrainError, match="begins without any"):
        train(Training(found, CPP, "tiny", TINY, 0), tmp_path / "again")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["pilot", "--scenario", "Block8-DH-v0"], "pilot: Block8-DH-v0: pilot learns nothing in DH"),
        (["ddqn", "--scenario", "Manhattan32-CPP-Team-v0"], "ddqn: ddqn learns to fly one UAV"),
        (["ddqn", "--scenario", "Block8-CPP-v0", "--out", "FILE"], "cannot write"),
        (["greedy"], "cannot be trained"),
    ],
)
def test_train_says_in_one_line_what_it_cannot_do(words, reason, tmp_path):
    (tmp_path / "file").write_text("")
    told = CliRunner().invoke(app, ["train", *(str(tmp_path / "file") if word == "FILE" else word for word in words)])
    assert (told.exit_code, reason in told.output) == (2, True), told.output
    assert "Traceback" not in told.output


def test_shipped_weights_fly_as_the_paper_says():
    """The reference agent on the paper's scenarios: a few episodes of each; the leaderboard has all."""
    shipped = shipped_weights("ddqn")
    assert {"Manhattan32-CPP-v0", "Manhattan32-DH-v0"} <= shipped.keys()
    for name, path in shipped.items():
        assert path.stat().st_size < 5_000_000
        assert load_weights(path)[1]["config"] == asdict(DDQN.CONFIGS["fast"])
        scenario = load_scenario(name)
        records = list(evaluate(Job(SOURCE, scenario, "validation"), range(50)))
        assert np.mean([record.landed for record in records]) > 0.9
        assert np.mean([record.cral for record in records]) > 0.6
        assert SOURCE.digest(scenario) not in (SOURCE.sha256, SOURCE.digest(CPP))


def test_damaged_and_foreign_files_are_refused_in_one_line(tmp_path):
    kept = train(training(), tmp_path)
    damaged = tmp_path / "damaged.safetensors"
    for content in (b"", b"junk" * 100, kept.read_bytes()[:-100]):
        damaged.write_bytes(content)
        with pytest.raises(AgentLoadError, match=r"damaged\.safetensors: damaged") as error:
            find_agent(str(damaged))
        assert "\n" not in str(error.value)
    from safetensors.numpy import save_file

    save_file({"x": np.zeros(3)}, damaged)
    with pytest.raises(AgentLoadError, match="no record of a training"):
        find_agent(str(damaged))
    save_weights(damaged, {"x": np.zeros(3)}, {"agent": "nobody"})
    with pytest.raises(AgentLoadError, match="nobody"):
        find_agent(str(damaged))
    with pytest.raises(AgentLoadError, match="there is no such file"):
        find_agent(str(tmp_path / "none.safetensors"))
    checkpoint = kept.with_suffix(".checkpoint")
    checkpoint.write_bytes(checkpoint.read_bytes()[:-1000])
    with pytest.raises(WeightsError, match="damaged"):
        train(training(), tmp_path, resume=True)
    save_weights(checkpoint, {"x": np.zeros(3)}, training(seed=5).record([]))
    with pytest.raises(TrainError, match="its seed is 5, not 0"):
        train(training(), tmp_path, resume=True)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("updats = 3", "updats: unknown"),
        ("updates = 'many'", "updates: 'many' is not of type int"),
        ("updates = 2.5", "updates: 2.5 is not of type int"),
        ("base = 'slow'", "base: 'slow'"),
        ("validation = 0", "validation: 0 is not from 1 to"),
        ("updates = -1", "updates: -1 is not from 1 to"),
        ("discount = 1.5", "discount: 1.5 is not from 0 to 1"),
        ("rate = nan", "rate: nan is not"),
        ("temperature = 0", "temperature: 0"),
        ("replay = 1000", "replay: 1000 steps: 128 environments need 10 each"),
        ("updates =", "cannot read"),
    ],
)
def test_a_wrong_configuration_names_the_field(text, reason, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(TrainError, match=reason):
        read_config(SOURCE, str(path))


def test_a_file_changes_what_it_names(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("base = 'paper'\nupdates = 7\ntemperature = 1")
    name, config = read_config(SOURCE, str(path))
    assert (name, config) == ("mine", replace(DDQN.CONFIGS["paper"], updates=7, temperature=1.0))
    assert read_config(SOURCE, "fast") == ("fast", DDQN.CONFIGS["fast"])
    for wrong in ("slow", str(Path("none.toml"))):
        with pytest.raises(TrainError, match="--config"):
            read_config(SOURCE, wrong)
    with pytest.raises(TrainError, match="cannot be trained"):
        read_config(find_agent("greedy"), "fast")


def test_the_papers_configuration_is_the_papers():
    """Section IV and the authors' configuration files."""
    paper = DDQN.CONFIGS["paper"]
    assert (paper.updates, paper.environments, paper.batch, paper.segment, paper.trace) == (2_000_000, 1, 128, 1, 0.0)
    assert (paper.replay, paper.prefill, paper.rate, paper.amsgrad) == (50_000, 25_000, 3e-5, True)
    assert (paper.discount, paper.soft_update, paper.temperature) == (0.95, 0.005, 0.1)
    assert (paper.reward_scale, paper.budget_scale, paper.anywhere, paper.careful, paper.clip) == (1.0, 1.0, 0.0, 0.0, 0.0)
    learner = DDQN.Learner(CPP, replace(paper, prefill=100, updates=10), 0)
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
