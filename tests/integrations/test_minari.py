"""An agent's flights as a dataset of Minari: what is in it are the episodes, step for step."""

import gymnasium as gym
import numpy as np
import pytest
from commands import uavbench_command

import uavbench
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job

needed = pytest.mark.integrations


@pytest.fixture
def minari():
    return pytest.importorskip("minari", reason="needs the extra: pip install -e '.[dataset]'")


@needed
@pytest.mark.parametrize("name", ["Block8-CPP-v0", "Block8-DH-v0"])
def test_a_dataset_holds_the_episodes_step_for_step(minari, name, tmp_path, monkeypatch):
    told = uavbench_command("dataset", name, "--agent", "greedy", "--episodes", 45, "--out", tmp_path, "--workers", 2)
    assert told.exit_code == 0, told.output
    assert str(tmp_path / "uavbench" / name.removesuffix("-v0") / "greedy-v0") in told.output
    assert {path.name for path in tmp_path.iterdir()} == {"uavbench"}
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    found = minari.load_dataset(f"uavbench/{name.removesuffix('-v0')}/greedy-v0")
    assert found.total_episodes == 45
    env = uavbench.make(name)
    scores = uavbench.evaluate("greedy", name, split="train", episodes=45).episodes()
    for number, episode in enumerate(found.iterate_episodes()):
        observation, info = env.reset(options={"split": "train", "episode": number})
        for t, action in enumerate(episode.actions):
            for key, values in observation.items():
                assert np.array_equal(episode.observations[key][t], values)
            assert np.array_equal(episode.infos["action_mask"][t], info["action_mask"])
            observation, reward, terminated, _, info = env.step(action)
            assert episode.rewards[t] == reward
            assert episode.terminations[t] == terminated
        assert terminated
        assert episode.infos["cr"][-1] == scores["cr"][number]
    again = found.recover_environment()
    assert isinstance(again.unwrapped, type(env))
    assert isinstance(found.observation_space, gym.spaces.Dict)


@needed
def test_what_cannot_be_written_leaves_nothing(minari, tmp_path):
    words = ("dataset", "Block8-CPP-v0", "--agent", "random", "--episodes", 3, "--out", tmp_path)
    assert uavbench_command(*words).exit_code == 0
    before = sorted(path for path in tmp_path.rglob("*"))
    for more, reason in (
        ((), "exists already"),
        (("--name", "../x-v0"), "is not of the form"),
        (("--name", "x"), "is not of the form"),
    ):
        told = uavbench_command(*words, *more)
        assert (told.exit_code, reason in told.stderr) == (2, True), told.stderr
    broken = tmp_path.parent / "broken.py"
    lines = ("class Agent:", "    def __init__(self, scenario): pass", "    def act(self, o, i): raise OSError('no')")
    broken.write_text("\n".join(lines))
    told = uavbench_command("dataset", "Block8-CPP-v0", "--agent", broken, "--episodes", 3, "--out", tmp_path)
    assert told.exit_code == 2
    assert sorted(path for path in tmp_path.rglob("*")) == before


def test_teams_and_other_splits_have_none(tmp_path):
    from uavbench.integrations.minari import DatasetError, write_dataset

    with pytest.raises(DatasetError, match="is for teams"):
        write_dataset(Job(find_agent("random"), uavbench.load_scenario("Manhattan32-DH-Team-v0"), "train"), 3, tmp_path)
    with pytest.raises(DatasetError, match="of the train split"):
        write_dataset(Job(find_agent("random"), uavbench.load_scenario("Block8-CPP-v0"), "test"), 3, tmp_path)
    assert list(tmp_path.iterdir()) == []
