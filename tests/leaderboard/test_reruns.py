"""Reruns: the agent takes the same actions again, is told nothing that its track does not show, and keeps its score."""

import errno
import os
import re
import shutil
import tomllib
from pathlib import Path

import pytest
import tomli_w
from boards import rewrite, row_of, rows, spoil
from commands import uavbench_command as uavbench

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.run import run
from uavbench.leaderboard.board import build
from uavbench.leaderboard.claims import is_built_in
from uavbench.leaderboard.reruns import Rerun, load_reruns, save_rerun
from uavbench.leaderboard.submission import SubmissionError, load_submission
from uavbench.leaderboard.submit import submit

OF_WEIGHTS = """
from pathlib import Path
class Agent:
    def __init__(self, scenario, weights):
        self.action = int(Path(weights).read_text())
    def act(self, observation, info):
        return self.action
"""


@pytest.mark.slow
def test_an_agent_that_takes_the_same_actions_again_raises_the_tier(submissions):
    folder = submissions / "random"
    assert uavbench("leaderboard", "rerun", folder, "--agent", "random", "--fresh", 0).exit_code == 0
    build(submissions)
    tiers = {(row["scenario"], row["name"]): row["tier"] for row in rows(submissions.parent)}
    assert tiers["Block8-CPP-v0", "random"] == tiers["Block8-DH-v0", "random"] == "rerun"
    assert tiers["Block8-CPP-v0", "greedy"] == "replayed"


@pytest.mark.slow
def test_a_part_that_was_run_again_is_counted_but_is_no_rerun(submissions):
    assert (
        uavbench("leaderboard", "rerun", submissions / "random", "--agent", "random", "--episodes", 7, "--fresh", 0).exit_code
        == 0
    )
    build(submissions)
    row = next(row for row in rows(submissions.parent) if row["name"] == "random")
    assert (row["tier"], row["rerun_episodes"]) == ("replayed", "7")


@pytest.mark.slow
def test_a_shorter_rerun_does_not_take_back_a_longer_one(submissions):
    for count in (5, 9, 3):
        told = uavbench("leaderboard", "rerun", submissions / "random", "--agent", "random", "--episodes", count, "--fresh", 0)
        assert told.exit_code == 0
    assert {rerun.episodes for rerun in load_reruns(submissions.parent / "reruns.csv").values()} == {9}


@pytest.mark.parametrize(
    ("field", "old", "new"),
    [("track", 'track = "observation"', 'track = "state"'), ("agent_sha256", 'agent_sha256 = "', 'agent_sha256 = "0')],
)
def test_an_agent_other_than_the_manifest_says_is_no_rerun(submissions, field, old, new):
    manifest = submissions / "random" / "Block8-CPP-v0" / "manifest.toml"
    text = manifest.read_text(encoding="utf-8").replace(old, new)
    manifest.write_text(re.sub(r'(agent_sha256 = ".{64}).*"', r'\1"', text), encoding="utf-8")
    told = uavbench("leaderboard", "rerun", manifest.parent, "--agent", "random")
    assert (told.exit_code, f": {field}: random has" in told.output) == (1, True), told.output
    assert not (submissions.parent / "reruns.csv").exists()


@pytest.mark.slow
def test_an_agent_is_run_again_with_the_weights_it_flew_with(tmp_path):
    (tmp_path / "mine.py").write_text(OF_WEIGHTS, encoding="utf-8")
    for name, action in (("weights", 2), ("others", 3)):
        (tmp_path / name).write_text(str(action), encoding="utf-8")
    agent, scenario = ("--agent", tmp_path / "mine.py"), ("--scenario", "Block8-CPP-v0")
    told = uavbench("evaluate", *agent, "--weights", tmp_path / "weights", *scenario, "--out", tmp_path / "results")
    assert told.exit_code == 0, told.output
    out = ("--out", tmp_path / "board" / "submissions")
    told = uavbench("submit", *(tmp_path / "results" / "Block8-CPP-v0").iterdir(), "--name", "Mine", "--authors", "A", *out)
    assert told.exit_code == 0, told.output
    again = ("leaderboard", "rerun", tmp_path / "board" / "submissions" / "mine", *agent, "--episodes", 5, "--fresh", 0)
    for given, wrong in (((), "weights are given by --weights"), (("--weights", tmp_path / "others"), "agent_sha256: ")):
        told = uavbench(*again, *given)
        assert (told.exit_code, wrong in told.output) == (1, True), told.output
    told = uavbench(*again, "--weights", tmp_path / "weights", "--decision-timeout", 30)
    assert told.exit_code == 0, told.output


def test_what_does_not_hold_is_not_run_again(submissions):
    spoil(submissions / "random" / "Block8-CPP-v0")
    told = uavbench("leaderboard", "rerun", submissions / "random" / "Block8-CPP-v0", "--agent", "random")
    assert (told.exit_code, "damaged" in told.output) == (1, True), told.output


def test_another_agent_is_found_out_at_its_first_other_action(submissions):
    told = uavbench("leaderboard", "rerun", submissions / "random", "--agent", "greedy")
    assert told.exit_code == 1
    assert "random/Block8-CPP-v0: track: greedy has state" in told.output
    path = submissions / "random" / "Block8-CPP-v0" / "manifest.toml"  # and when it claims to be that agent
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    table["result"] |= {"track": "state", "agent_sha256": find_agent("greedy").sha256}
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    told = uavbench("leaderboard", "rerun", path.parent, "--agent", "greedy")
    assert told.exit_code == 1
    assert re.search(r"random/Block8-CPP-v0: episode \d+: greedy takes other actions from step \d+ on", told.output)
    assert load_reruns(submissions.parent / "reruns.csv") == {}


@pytest.mark.slow
def test_a_rerun_of_other_actions_does_not_count(submissions):
    assert uavbench("leaderboard", "rerun", submissions / "random", "--agent", "random", "--fresh", 0).exit_code == 0
    for name in ("actions.npz", "episodes.csv", "manifest.toml"):
        content = (submissions / "greedy" / "Block8-CPP-v0" / name).read_bytes()
        (submissions / "random" / "Block8-CPP-v0" / name).write_bytes(content.replace(b'name = "greedy"', b'name = "random"'))
    shutil.rmtree(submissions / "random" / "Block8-DH-v0")  # of the other track
    build(submissions)
    row = next(row for row in rows(submissions.parent) if (row["name"], row["scenario"]) == ("random", "Block8-CPP-v0"))
    assert row["tier"] == "replayed"


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["Block8-CPP-v0", "Block8-DH-v0"])
def test_a_rerun_on_another_track_does_not_count(submissions, scenario):
    """What was executed saw the observation: an edited manifest cannot say otherwise and keep the tier."""
    assert uavbench("leaderboard", "rerun", submissions / "random", "--agent", "random", "--fresh", 0).exit_code == 0
    for path in (submissions / "random").glob("*/manifest.toml"):
        text = path.read_text(encoding="utf-8")
        path.write_text(text.replace('track = "observation"', 'track = "state"'), encoding="utf-8")
    build(submissions)
    row = next(row for row in rows(submissions.parent) if (row["name"], row["scenario"]) == ("random", scenario))
    assert (row["track"], row["tier"], row["rerun_episodes"]) == ("state", "replayed", "0")


PLAYBACK = """
import numpy as np

class Agent:
    track = "observation"

    def __init__(self, scenario):
        with np.load({folder!r} + "/actions.npz") as table:
            self.actions = np.split(table["actions"][:, 0], table["offsets"][1:-1])

    def reset(self, info):
        self.flight = iter(self.actions[info["episode"]].tolist())

    def act(self, observation, info):
        return next(self.flight, 5)
"""


PEEKS = """
import gc

class Agent:
    track = "observation"
    simulator = None

    def __init__(self, scenario):
        pass

    def act(self, observation, info):
        if self.simulator is None:
            self.simulator = any(type(each).__name__ == "Simulator" for each in gc.get_objects())
        return 4 if self.simulator else int(info["action_mask"].argmax())
"""


def submitted(submissions, folder, name, text):
    """Evaluate and submit an agent on Block8-CPP-v0; return its file."""
    path = folder / f"{name}.py"
    path.write_text(text, encoding="utf-8")
    result = run(Job(find_agent(str(path)), load_scenario("Block8-CPP-v0"), "test"), 1000, folder / "results")
    submit([result], submissions, name=name, authors=["M. Allory"])
    return path


@pytest.mark.slow
def test_an_agent_that_plays_back_public_flights_is_found_out_on_fresh_episodes(submissions, tmp_path):
    path = submitted(submissions, tmp_path, "playback", PLAYBACK.format(folder=str(submissions / "greedy" / "Block8-CPP-v0")))
    board = build(submissions)
    assert board.alike == ["playback/Block8-CPP-v0 took the same actions as greedy/Block8-CPP-v0"]
    row = row_of(submissions, "playback")
    assert (row["rank"], row["track_known_by"], row["tier"]) == ("", "claim", "replayed")
    assert "is a claim, until the agent is run again" in row["note"]
    told = uavbench("leaderboard", "rerun", submissions / "playback", "--agent", path, "--fresh", 50, "--key", 11)
    assert told.exit_code == 0, told.output
    assert "on 50 fresh episodes DOES NOT AGREE with the submitted one: -" in told.output
    build(submissions)
    row = row_of(submissions, "playback")
    assert (row["rank"], row["tier"], row["rerun_episodes"], row["fresh_episodes"]) == ("", "replayed", "1000", "50")
    assert float(row["fresh_difference_high"]) < -10
    assert "DOES NOT AGREE" in row["note"]
    assert row_of(submissions, "random")["rank"] == "1"  # of its track: it comes with uavbench


def test_an_agent_that_looks_for_the_simulator_finds_none_when_it_is_run_again(submissions, tmp_path):
    path = submitted(submissions, tmp_path, "peeks", PEEKS)
    told = uavbench("leaderboard", "rerun", submissions / "peeks", "--agent", path, "--episodes", 3, "--fresh", 0)
    assert (told.exit_code, "takes other actions from step 0 on" in told.output) == (1, True), told.output


@pytest.mark.slow
def test_an_honest_agent_is_ranked_when_it_was_run_again(submissions, tmp_path):
    text = (Path(__file__).parents[1] / "helpers" / "agents.py").read_text(encoding="utf-8").replace("class One", "class Agent")
    path = submitted(submissions, tmp_path, "honest", text.split("class Many")[0])
    told = uavbench("leaderboard", "rerun", submissions / "honest", "--agent", path, "--fresh", 100)
    assert (told.exit_code, "on 100 fresh episodes agrees with the submitted one" in told.output) == (0, True), told.output
    build(submissions)
    row = row_of(submissions, "honest")
    assert (row["tier"], row["track_known_by"], row["note"]) == ("rerun", "rerun", "")
    assert row["rank"]
    found = load_reruns(submissions.parent / "reruns.csv")["honest/Block8-CPP-v0"]
    assert (found.fresh, found.agrees) == (100, True)
    assert found.fresh_key > 2**40  # by chance, so that nobody knows it before
    told = uavbench("leaderboard", "rerun", submissions / "honest", "--agent", path, "--episodes", 2, "--fresh", 0)
    assert load_reruns(submissions.parent / "reruns.csv")["honest/Block8-CPP-v0"] == found


def test_a_built_in_agent_is_known_by_its_name_digest_and_track(submissions):
    build(submissions)
    assert row_of(submissions, "random")["track_known_by"] == row_of(submissions, "greedy")["track_known_by"] == "built-in"
    for name, old, new in (
        ("greedy", 'track = "state"', 'track = "observation"'),
        ("random", 'agent_sha256 = "', 'agent_sha256 = "0'),
        ("random", 'agent = "random"', 'agent = "greedy"'),
    ):
        copy = submissions.parent / "copy" / name / "Block8-CPP-v0"
        shutil.copytree(submissions / name / "Block8-CPP-v0", copy)
        manifest = copy / "manifest.toml"
        rewrite(manifest, old, new)
        manifest.write_text(
            re.sub(r'(agent_sha256 = ".{64}).*"', r'\1"', manifest.read_text(encoding="utf-8")), encoding="utf-8"
        )
        assert not is_built_in(load_submission(copy))
        shutil.rmtree(copy)


def test_reruns_of_before_there_were_fresh_episodes_are_read(submissions):
    path = submissions.parent / "reruns.csv"
    path.write_text("submission,track,agent_sha256,actions_sha256,episodes\na/b,state,0,1,7\n", encoding="utf-8")
    assert load_reruns(path) == {"a/b": Rerun("a/b", "state", "0", "1", 7)}
    save_rerun(path, Rerun("c/d", "state", "2", "3", 1000, 200, 2**61, 0.5, -0.1, -0.2, 0.0))
    assert load_reruns(path)["a/b"].agrees
    assert load_reruns(path)["c/d"].fresh_key == 2**61
    path.write_text(path.read_text(encoding="utf-8").replace("-0.2", "nan"), encoding="utf-8")
    with pytest.raises(SubmissionError, match=r"reruns\.csv: damaged in line 3"):
        load_reruns(path)


def test_a_damaged_table_of_reruns_is_an_error(submissions):
    (submissions.parent / "reruns.csv").write_text("submission,episodes\na,b\n")
    with pytest.raises(SubmissionError, match=r"reruns\.csv: damaged"):
        build(submissions)


def test_a_table_of_reruns_that_cannot_be_kept_is_found_before_the_flight(submissions, monkeypatch):
    path, words = (
        submissions.parent / "reruns.csv",
        ("leaderboard", "rerun", submissions / "random", "--agent", "random", "--fresh", 0),
    )
    assert uavbench(*words, "--episodes", 2).exit_code == 0
    good = path.read_text(encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.setattr("uavbench.leaderboard.reruns.evaluate_with", lambda *job: pytest.fail("it flies"))
        path.write_text(good.rstrip("\n")[:-1] + "x\n", encoding="utf-8")
        told = uavbench(*words)
        assert (told.exit_code, "reruns.csv: damaged in line 3" in told.output) == (1, True), told.output
        path.unlink()
        path.mkdir()
        told = uavbench(*words)
        assert (told.exit_code, "reruns.csv: is not a plain file" in told.output) == (1, True), told.output
    path.rmdir()
    with monkeypatch.context() as patch:
        patch.setattr("uavbench.leaderboard.reruns.evaluate_with", lambda *job: pytest.fail("it flies"))
        patch.setattr("uavbench.world.files.tempfile.TemporaryFile", lambda **where: _full())
        told = uavbench(*words)
        assert (told.exit_code, "reruns.csv: No space left" in told.output) == (1, True), told.output
    monkeypatch.setattr("uavbench.leaderboard.reruns.write_atomic", _full)
    told = uavbench(*words, "--episodes", 2)
    assert (told.exit_code, "reruns.csv: No space left" in told.output) == (1, True), told.output


def _full(*to):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_an_interrupted_rerun_writes_down_what_was_compared(submissions, monkeypatch):
    seen = []

    def advance(_progress, cral):
        seen.append(cral)
        if len(seen) == 6:
            raise KeyboardInterrupt

    monkeypatch.setattr("uavbench.cli.progress.EpisodesProgress.advance", advance)
    told = uavbench("leaderboard", "rerun", submissions / "greedy" / "Block8-CPP-v0", "--agent", "greedy", "--episodes", 20)
    assert (told.exit_code, "interrupted; the actions of 6 episodes are the same" in told.output) == (1, True), told.output
    assert [rerun.episodes for rerun in load_reruns(submissions.parent / "reruns.csv").values()] == [6]
