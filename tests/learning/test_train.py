"""Training, whoever learns: interrupted or not it ends alike, and what is damaged, foreign or wrong is said in a line."""

import hashlib
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import uavbench_command
from learning import CPP, DDQN, DH, SOURCE, TINY, spoilt, training, weights_of
from typer.testing import CliRunner

from uavbench import load_scenario
from uavbench.agents.agent import AgentLoadError, find_agent
from uavbench.agents.weights import WeightsError, load_weights, save_weights
from uavbench.cli.app import app
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.evaluation.results import load_result
from uavbench.learning.train import train
from uavbench.learning.training import TrainError, Training, read_config


@pytest.mark.parametrize(("scenario", "sent"), [(CPP, signal.SIGINT), (DH, signal.SIGTERM)], ids=["CPP", "DH"])
def test_training_that_is_interrupted_ends_as_if_it_had_not_been(scenario, sent, tmp_path):
    whole = train(training(scenario=scenario), tmp_path / "whole")

    def interrupt(updates):
        if updates == 27:
            os.kill(os.getpid(), sent)

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


def test_the_weights_that_are_kept_are_those_that_validate_best(tmp_path, monkeypatch):
    scores, seen = iter([0.3, 0.8, 0.5, 0.8]), []

    def validate(self, arrays, record, stopped):
        seen.append({name: array.copy() for name, array in arrays.items()})
        score = next(scores)
        return {"landed": 1.0, "cr": score, "cral": score}

    monkeypatch.setattr("uavbench.learning.train.Validation.scores", validate)
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
    monkeypatch.setattr("uavbench.learning.train._CHECKPOINT_SECONDS", 0.0)
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


def test_a_training_that_begins_from_weights_goes_on_from_what_they_know(tmp_path):
    first = train(training(), tmp_path / "first")
    untouched = replace(training(replace(TINY, updates=1, validation=1, learning_rate=0.0)), start=first)
    digest, known = hashlib.sha256(first.read_bytes()).hexdigest(), weights_of(first)
    moved = first.with_name("moved.safetensors")
    kept = train(untouched, tmp_path / "second", on_start=lambda done, updates: first.rename(moved))
    moved.rename(first)
    assert weights_of(kept) == known
    assert load_weights(kept)[1]["start_sha256"] == digest
    assert load_weights(first)[1]["start_sha256"] is None
    with pytest.raises(TrainError, match=r"its start_sha256 is .*, not None"):
        train(replace(untouched, start=None), tmp_path / "second", resume=True)


def test_weights_that_a_training_cannot_begin_from_are_refused(tmp_path):
    first = train(training(), tmp_path)
    with pytest.raises(WeightsError, match="there is no such file"):
        train(replace(training(), start=tmp_path / "none"), tmp_path / "second")
    with pytest.raises(WeightsError, match="another mission"):
        train(replace(training(scenario=DH), start=first), tmp_path / "second")
    mine = tmp_path / "mine.py"
    mine.write_text(SOURCE.path.read_text(encoding="utf-8").replace("def start_from", "def other"))
    with pytest.raises(TrainError, match=r"no start_from\(path\)"):
        train(Training(find_agent(str(mine)), CPP, "tiny", TINY, 0, first), tmp_path / "second")
    told = CliRunner().invoke(
        app, ["train", "ddqn", "--scenario", CPP.id, "--from", str(tmp_path / "none"), "--out", str(tmp_path)]
    )
    assert (told.exit_code, "there is no such file" in told.output) == (2, True), told.output
    assert not (tmp_path / "second").exists()


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


@pytest.mark.parametrize(("scenario", "names"), [(CPP, ["targets"]), (DH, ["device_count", "device_cell", "device_data"])])
def test_a_checkpoint_of_an_earlier_version_is_refused_by_saying_so(scenario, names, tmp_path):
    """They held the mission's part as columns of a table of episodes, and no array of its own."""
    train(training(scenario=scenario), tmp_path)
    checkpoint = training(scenario=scenario).files(tmp_path)[1]
    arrays, record = load_weights(checkpoint)
    old = {name: array for name, array in arrays.items() if not name.startswith("simulator.mission.")}
    save_weights(checkpoint, {**old, **{f"simulator.{name}": np.zeros(8) for name in names}}, record)
    with pytest.raises(WeightsError, match=rf"its ({'|'.join(names)}) does not fit: another version of") as error:
        train(training(scenario=scenario), tmp_path, resume=True)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("scenario", [CPP, DH])
def test_a_checkpoint_of_before_the_state_kept_counts_is_refused_by_saying_so(scenario, tmp_path):
    """It held the number of targets in each row instead."""
    train(training(scenario=scenario), tmp_path)
    checkpoint = training(scenario=scenario).files(tmp_path)[1]
    arrays, record = load_weights(checkpoint)
    kept = {f"simulator.{name}" for name in ("counts", "spots", "num_spots")}
    old = {name: array for name, array in arrays.items() if name not in kept}
    assert len(old) == len(arrays) - 3
    save_weights(checkpoint, {**old, "simulator.row_targets": np.zeros((8, 8), dtype=np.int32)}, record)
    with pytest.raises(WeightsError, match=r"or of another version: .*its counts does not fit") as error:
        train(training(scenario=scenario), tmp_path, resume=True)
    assert "\n" not in str(error.value)


def test_weights_of_a_learner_of_ones_own_fly_with_its_code(tmp_path):
    mine = tmp_path / "ddqn.py"  # called as a built-in
    text, decision = SOURCE.path.read_text(encoding="utf-8"), ".argmax(dim=1).cpu().numpy()"
    assert decision in text
    mine.write_text(text.replace(decision, f"{decision} * 0 + 5"))
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
    with pytest.raises(TrainError, match="--from starts from weights"):
        train(Training(found, CPP, "tiny", TINY, 0), tmp_path / "again")


def test_weights_of_ones_own_are_refused_on_another_mission_too(tmp_path):
    """Though the agent does not look."""
    mine = tmp_path / "mine.py"
    mine.write_text("class Agent:\n    def __init__(self, s, w): pass\n    def act(self, o, i): return 4\n")
    weights = tmp_path / "w.safetensors"
    save_weights(weights, {"a": np.zeros(1)}, {"agent": "mine", "scenario": CPP.id})
    assert find_agent(str(mine), weights).trained_on == CPP.id
    find_agent(str(mine), weights).make(CPP)
    with pytest.raises(WeightsError, match="another mission than that of Block8-DH-v0"):
        find_agent(str(mine), weights).make(DH)


def test_weights_of_ones_own_scenario_fly_where_they_fit(tmp_path):
    """Scenarios that do not come with the suite are known by what the record says of them."""
    mine = CPP.model_copy(update={"id": "Mine-CPP-v0"})
    kept = train(training(replace(TINY, updates=2, validation=2), mine), tmp_path)
    source = find_agent(str(kept))
    source.make(mine)
    source.make(mine.model_copy(update={"id": "Mine-CPP-v1", "budget": (5, 10)}))
    rows = ("." + mine.rows[0][1:], *mine.rows[1:])
    elsewhere = mine.model_copy(update={"id": "Mine-CPP-v2", "rows": rows})
    refused = {
        "another mission than that of Mine-DH-v0": DH.model_copy(update={"id": "Mine-DH-v0"}),
        "observations have layers 4, not 6 as those of Mine-CPP-v0": mine.model_copy(update={"uavs": (1, 2)}),
        "observations have local_size 9, not 7 as those": mine.with_observation(local_size=7),
        "observations have global_scale 3, not 5 as those": mine.with_observation(global_scale=5),
        "another map than that of Mine-CPP-v2.*--transfer": elsewhere,
    }
    for reason, scenario in refused.items():
        with pytest.raises(WeightsError, match=f"trained on Mine-CPP-v0, .*{reason}"):
            source.make(scenario)
        if scenario is not elsewhere:
            with pytest.raises(WeightsError, match=reason):
                replace(source, transfer=True).make(scenario)
    replace(source, transfer=True).make(elsewhere)
    with pytest.raises(WeightsError, match="another map"):
        train(replace(training(scenario=elsewhere), start=kept), tmp_path / "second")


@pytest.mark.slow
def test_shipped_weights_fly_another_map_on_purpose_only_and_the_result_says_so(tmp_path):
    shipped = load_scenario("Manhattan32-CPP-v0")
    text = shipped.path.read_text(encoding="utf-8").split("[splits")[0].replace(shipped.id, "Mine-CPP-v0")
    (tmp_path / "mine.toml").write_text(text.replace(shipped.map, "mine.txt"))
    (tmp_path / "mine.txt").write_text("\n".join([shipped.rows[0].replace(".", "N", 1), *shipped.rows[1:]]))
    weights = SOURCE.path.parent / "weights" / "ddqn-Manhattan32-CPP-v0.safetensors"
    words = ["evaluate", "--agent", weights, "--episodes", "2", "--out", tmp_path / "results", "--scenario"]
    told = uavbench_command(*words, tmp_path / "mine.toml")
    assert (told.exit_code, "another map than that of Mine-CPP-v0" in told.output) == (1, True), told.output
    for scenario, said in ((tmp_path / "mine.toml", True), (shipped.id, None)):
        told = uavbench_command(*words, scenario, "--transfer")
        assert told.exit_code == 0, told.output
        folder = tmp_path / "results" / load_scenario(str(scenario)).id / weights.stem
        assert load_result(folder).summary.get("transfer") is said
        assert uavbench_command("replay", folder).exit_code == 0


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("validation: int", "validating: int", "CONFIGS: tiny: it has no field validation"),
        ("def snapshot", "def snap", "Learner: it has no snapshot"),
    ],
)
def test_a_learner_that_lacks_something_is_refused_at_once(tmp_path, old, new, reason):
    mine = tmp_path / "mine.py"
    text = (
        "from dataclasses import dataclass\n"
        "@dataclass(frozen=True)\nclass Config:\n    updates: int = 2\n    validation: int = 1\n"
        "CONFIGS = {'tiny': Config()}\n"
        "class Agent:\n    def __init__(self, s, w): pass\n    def act(self, o, i): return 4\n"
        "class Learner:\n    updates = samples = 0\n    def __init__(self, scenario, config, seed): pass\n"
        "    def advance(self): self.updates += 1; return {}\n    def weights(self): return {}\n"
        "    def snapshot(self): return {}\n    def resume(self, arrays): pass\n"
    )
    assert old in text
    mine.write_text(text)
    words = ["train", str(mine), "--config", "tiny", "--scenario", CPP.id, "--out", str(tmp_path / "runs")]
    assert CliRunner().invoke(app, words).exit_code == 0
    mine.write_text(text.replace(old, new))
    told = CliRunner().invoke(app, [*words, "--seed", "1"])
    assert (told.exit_code, reason in told.output) == (2, True), told.output


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["imitation", "--scenario", "City128-DH-v0"], "imitation: City128-DH-v0: its maps are too large for a teacher"),
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
        ("learning_rate = nan", "learning_rate: nan is not"),
        ("temperature = 0", "temperature: 0"),
        ("buffer_size = 1000", "buffer_size: 1000 is too small: num_envs = 128 and segment = 8 need 1280 steps"),
        ("updates =", "is not TOML"),
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
