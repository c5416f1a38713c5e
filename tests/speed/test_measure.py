"""`uavbench speed`: what is measured, beside what, and what is written. How fast it is, no test says."""

import json

import gymnasium as gym
import pytest
from commands import uavbench_command

from uavbench import load_scenario
from uavbench.speed import peers
from uavbench.speed.measure import BATCHES, SpeedError, cores, measure, prepare, report


@pytest.fixture(scope="module")
def speeds():
    return measure(prepare([load_scenario("Block8-CPP-v0")], peers=False), 2)


def test_each_interface_is_measured_alone_and_in_batches_on_one_core_and_on_all(speeds):
    threads = {1, cores()}
    expected = {("Env", 1, 1), ("VectorEnv", 1, 1), ("Simulator", 1, 1)}
    for interface in ("VectorEnv", "Simulator"):
        expected |= {(interface, batch, each) for batch in BATCHES[1:] for each in threads}
    assert {(speed.interface, speed.environments, speed.threads) for speed in speeds} == expected
    assert len(speeds) == len(expected)


def test_the_bytes_of_observations_and_their_copying_are_told(speeds):
    size = sum(space.shape[0] * 4 if len(space.shape) == 1 else 4 * space.low.size for space in _spaces())
    for speed in speeds:
        assert 0.0 < speed.microseconds < 1e6
        assert speed.bytes == (0 if speed.interface == "Simulator" else size)
        assert (speed.copying > 0.0) == (speed.interface == "VectorEnv")
        assert speed.steps_per_second == pytest.approx(1e6 / speed.microseconds)


def _spaces():
    return gym.make("uavbench/Block8-CPP-v0").observation_space.values()


def test_the_report_says_what_it_was_measured_on(speeds):
    read = json.loads(json.dumps(report(speeds)))
    assert read["machine"]["cores"] == cores()
    assert read["machine"]["processor"]
    assert set(read["versions"]) == {"uavbench", "python", "numpy", "numba"}
    assert [row["microseconds"] for row in read["speeds"]] == [speed.microseconds for speed in speeds]


def test_the_command_prints_a_table_and_writes_a_file(tmp_path, monkeypatch):
    monkeypatch.setattr("uavbench.speed.measure.BATCHES", (1, 4))
    path = tmp_path / "speed.json"
    done = uavbench_command("speed", "--scenario", "Block8-DH-v0", "--rounds", 1, "--no-peers", "--json", path)
    assert done.exit_code == 0, done.output
    assert "Block8-DH-v0" in done.output
    assert {row["task"] for row in json.loads(path.read_text())["speeds"]} == {"Block8-DH-v0"}


def test_teams_and_files_that_cannot_be_written_are_refused_in_a_line(tmp_path, monkeypatch):
    with pytest.raises(SpeedError, match="Manhattan32-DH-Team-v0 is for a team"):
        prepare([load_scenario("Manhattan32-DH-Team-v0")])
    refused = uavbench_command("speed", "--scenario", "Manhattan32-DH-Team-v0")
    assert (refused.exit_code, refused.output.count("\n")) == (2, 1)
    monkeypatch.setattr("uavbench.speed.measure.BATCHES", ())
    (tmp_path / "file").touch()
    for path in (tmp_path, tmp_path / "file" / "speed.json"):
        lost = uavbench_command("speed", "--scenario", "Block8-CPP-v0", "--rounds", 1, "--no-peers", "--json", path)
        assert (lost.exit_code, lost.output.count("\n")) == (2, 1)  # before anything is measured
        assert "--json: cannot write" in lost.output


@pytest.mark.parametrize("budget", [1, 2, 20_000])
def test_an_episode_of_any_length_is_measured_by_the_steps_that_are_taken(budget, monkeypatch):
    monkeypatch.setattr("uavbench.speed.measure.BATCHES", ())
    (env,) = prepare([load_scenario("Block8-CPP-v0").model_copy(update={"budget": (budget, budget)})], peers=False)
    counted, step = [], env.env.step
    monkeypatch.setattr(env.env, "step", lambda action: counted.append(step(action)))
    env.measure()
    assert len(counted) == env.steps == max(1, min(8192, budget - 1))


def test_peers_that_are_installed_are_measured_and_those_that_fail_are_named(monkeypatch):
    def lake(name):
        return peers._vector_peer(name, "SyncVectorEnv", gym.vector.SyncVectorEnv([lambda: gym.make(name)] * 2), 2)

    def broken(name):
        raise RuntimeError(f"{name} needs\nanother version")

    makers = {("gymnasium", "FrozenLake-v1"): lake, ("numpy", "Snake-v1"): broken, ("not_installed", "Maze-v1"): lake}
    monkeypatch.setattr(peers, "_MAKERS", makers)
    monkeypatch.setattr("uavbench.speed.measure.BATCHES", ())
    failures = []
    *_, peer = measure(prepare([load_scenario("Block8-CPP-v0")], on_failure=failures.append), 1)
    assert (peer.task, peer.interface, peer.environments, peer.bytes) == ("FrozenLake-v1", "SyncVectorEnv", 2, 8)
    assert peer.microseconds > 0.0
    assert failures == ["Snake-v1 of numpy cannot be measured: RuntimeError: Snake-v1 needs another version"]
