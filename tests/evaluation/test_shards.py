"""A result that is merged from shards is the one of an evaluation in one piece; everything else is refused."""

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from uavbench import UavbenchError, load_scenario
from uavbench.agents.agent import find_agent
from uavbench.cli.app import app
from uavbench.evaluation.evaluate import AgentError, Job
from uavbench.evaluation.kept import FILE, read_kept, write_kept
from uavbench.evaluation.replay import replay
from uavbench.evaluation.results import ResultError, load_result
from uavbench.evaluation.run import run, run_shard
from uavbench.evaluation.shards import Shard, merge, read_shard
from uavbench.world.locks import held

SCENARIO = load_scenario("Block8-DH-v0")
N = 10


def job(agent="random", split="test", scenario=SCENARIO):
    return Job(find_agent(agent), scenario, split)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A folder with three shards, and one with a shard that is the whole."""
    three, whole = tmp_path_factory.mktemp("three"), tmp_path_factory.mktemp("whole")
    for k in (1, 2, 3):
        run_shard(job(), Shard(k, 3, N), three)
    run_shard(job(), Shard(1, 1, N), whole)
    return three, whole


@pytest.fixture
def shards(tmp_path, flown):
    """The folders of three shards."""
    shutil.copytree(flown[0], tmp_path / "results")
    return sorted((tmp_path / "results" / "Block8-DH-v0").iterdir())


@pytest.fixture
def whole(flown):
    """The folder of a shard that has all episodes; tests only read it."""
    return next((flown[1] / "Block8-DH-v0").iterdir())


def test_shards_have_each_episode_once():
    for count in range(1, N + 1):
        parts = [Shard(k, count, N).numbers for k in range(1, count + 1)]
        assert sorted(number for part in parts for number in part) == list(range(N))
        assert max(map(len, parts)) - min(map(len, parts)) <= 1


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "1/0", "-1/3", "1/3/3", "", "a/b", "1 / 3", "11/11", "1/1000000000"])
def test_what_is_no_shard_is_refused(text):
    with pytest.raises(ResultError, match="--shard "):
        read_shard(text, N)
    assert str(read_shard("3/10", N)) == "3/10"


def test_merged_shards_are_the_result_of_an_evaluation_in_one_piece(tmp_path, shards):
    whole = run(job(), N, tmp_path / "whole")
    seen = []
    merged = merge(shards[::-1], tmp_path / "merged", on_shard=seen.append)
    assert seen == shards[::-1]
    assert merged.folder == tmp_path / "merged" / "Block8-DH-v0" / "random"
    for name in ("episodes.csv", "actions.npz"):
        assert (merged.folder / name).read_bytes() == (whole.folder / name).read_bytes()
    times = {"wall_time", "workers", "decisions_per_second"}
    assert {k: v for k, v in merged.summary.items() if k not in times} == {
        k: v for k, v in whole.summary.items() if k not in times
    }
    assert merged.summary["workers"] == 3
    assert replay(merged) == []
    assert merge(shards, tmp_path / "merged").summary["episodes"] == N  # again


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ([0, 1], r"3 of 10 episodes are in no shard, the first of them 2; not given: shards 3/3"),
        ([0, 1, 2, 1], r"episode 1 is in .*shard-2-of-3 and in .*shard-2-of-3: give each shard once"),
        ([], "no shard is given"),
    ],
)
def test_gaps_and_overlaps_are_refused(tmp_path, shards, given, reason):
    with pytest.raises(ResultError, match=reason):
        merge([shards[k] for k in given], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


@pytest.mark.parametrize(
    ("name", "other"),
    [("agent", "greedy"), ("split", "validation"), ("episodes", 11), ("scenario", "Block8-CPP-v0")],
)
def test_shards_of_different_evaluations_are_refused(tmp_path, shards, name, other):
    scenario = load_scenario(other) if name == "scenario" else SCENARIO
    what = job(other if name == "agent" else "random", other if name == "split" else "test", scenario)
    strange = run_shard(what, Shard(3, 3, other if name == "episodes" else N), tmp_path / "other")
    with pytest.raises(ResultError, match=f"is of another evaluation than .*: its {name}"):
        merge([*shards[:2], strange], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def changed(folder, tmp_path, **facts):
    """A copy of a shard with another identity."""
    kept = read_kept(folder)
    kept.identity |= facts
    write_kept(tmp_path / "changed", kept)
    return tmp_path / "changed"


@pytest.mark.parametrize(
    ("facts", "reason"),
    [
        ({"agent": "../up"}, "identity is not complete"),
        ({"agent": ".."}, "identity is not complete"),
        ({"agent": 3}, "identity is not complete"),
        ({"episodes": "10"}, "identity is not complete"),
        ({"shard": "1/1"}, "does not have the episodes of shard 1/1"),
        ({"shard": "9/3"}, "--shard 9/3"),
        ({"scenario_digest": "0"}, "another version of Block8-DH-v0"),
        ({"split": "none"}, "none"),
    ],
)
def test_identities_that_cannot_be_are_refused(tmp_path, shards, whole, facts, reason):
    strange = changed(shards[0] if "shard" in facts else whole, tmp_path, **facts)
    with pytest.raises((ResultError, ValueError), match=reason):
        merge([strange], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_numbers_that_do_not_follow_from_the_actions_are_refused(tmp_path, whole):
    kept = read_kept(whole)
    record = kept.records[4]
    kept.records[4] = type(record)(**{**vars(record), "cr": record.cr + 0.25})
    write_kept(tmp_path / "changed", kept)
    with pytest.raises(ResultError, match="the numbers of episode 4 do not follow from its actions"):
        merge([tmp_path / "changed"], tmp_path / "merged")


@pytest.mark.parametrize("content", [b"", b"nothing", None])
def test_folders_that_hold_no_shard_are_refused(tmp_path, content):
    (tmp_path / "folder").mkdir()
    if content is not None:
        (tmp_path / "folder" / FILE).write_bytes(content)
    with pytest.raises(ResultError, match=r"holds no shard|damaged|not a"):
        merge([tmp_path / "folder"], tmp_path / "merged")
    with pytest.raises(ResultError, match="holds no shard"):
        merge([run(job(), N, tmp_path / "results").folder], tmp_path / "merged")


def test_a_shard_is_kept_replaced_or_refused_as_a_result_is(tmp_path):
    flown = []
    how = {"on_record": lambda record: flown.append(record.episode)}
    folder = run_shard(job(), Shard(1, 2, N), tmp_path, **how)
    assert sorted(flown) == [0, 2, 4, 6, 8]
    before = (folder / FILE).read_bytes()
    assert run_shard(job(), Shard(1, 2, N), tmp_path, resume=True, **how) == folder
    assert len(flown) == 5
    run_shard(job(), Shard(1, 2, N), tmp_path, **how)
    assert len(flown) == 10
    with pytest.raises(ResultError, match=r"holds a shard of another evaluation \(its split"):
        run_shard(job(split="validation"), Shard(1, 2, N), tmp_path)
    assert read_kept(folder).records.keys() == {0, 2, 4, 6, 8}
    assert read_kept(folder).identity["split"] == "test"
    run_shard(job(split="validation"), Shard(1, 2, N), tmp_path, overwrite=True)
    assert read_kept(folder).identity["split"] == "validation"
    assert len(before) > 0


def test_an_interrupted_shard_goes_on(tmp_path):
    path = tmp_path / "agent.py"
    text = "class Agent:\n    def __init__(self, s): pass\n    def act(self, o, i):\n        {}\n        return 4\n"
    path.write_text(text.format("assert i['episode'] < 5 or __import__('os').path.exists('" + str(tmp_path / "go") + "')"))
    mine = Job(find_agent(str(path)), SCENARIO, "test")
    with pytest.raises(AgentError) as told:
        run_shard(mine, Shard(2, 2, N), tmp_path / "results")
    assert "--resume goes on" in "".join(told.value.__notes__)
    (tmp_path / "go").touch()
    flown = []
    folder = run_shard(mine, Shard(2, 2, N), tmp_path / "results", resume=True, on_record=flown.append)
    assert sorted(record.episode for record in flown) == [1, 3, 5, 7, 9]
    assert sorted(path.name for path in folder.parent.iterdir()) == ["agent.shard-2-of-2"]


def test_one_evaluation_is_not_run_twice_at_the_same_time(tmp_path):
    with held(tmp_path / "Block8-DH-v0" / "random.partial"):
        with pytest.raises(ResultError, match=r"random\.partial is in use: another process runs this evaluation now"):
            run(job(), N, tmp_path)
        with pytest.raises(ResultError, match="is in use"):
            run(job(), N, tmp_path, resume=True)
        run_shard(job(), Shard(1, 1, N), tmp_path)  # something else
    assert run(job(), N, tmp_path).summary["episodes"] == N
    assert sorted(path.name for path in (tmp_path / "Block8-DH-v0").iterdir()) == ["random", "random.shard-1-of-1"]


def test_the_commands_fly_and_merge(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner = CliRunner()
    words = ["evaluate", "--agent", "greedy", "--scenario", "Block8-DH-v0", "--episodes", "5"]
    for k in (1, 2):
        found = runner.invoke(app, [*words, "--shard", f"{k}/2", "--workers", str(k)])
        assert found.exit_code == 0, found.output
        assert f"results/Block8-DH-v0/greedy.shard-{k}-of-2" in found.stdout
    folders = [f"results/Block8-DH-v0/greedy.shard-{k}-of-2" for k in (1, 2)]
    found = runner.invoke(app, ["merge", *folders])
    assert found.exit_code == 0, found.output
    assert "CRAL" in found.stdout
    with (tmp_path / "results" / "Block8-DH-v0" / "greedy" / "episodes.csv").open() as file:
        assert [int(row["episode"]) for row in csv.DictReader(file)] == [0, 1, 2, 3, 4]
    for wrong, code in ((["merge", folders[0]], 2), ([*words, "--shard", "3/2"], 2), (["merge"], 2)):
        found = runner.invoke(app, wrong)
        assert found.exit_code == code
        assert "Traceback" not in found.output


def test_the_example_for_slurm_runs_with_processes(tmp_path):
    example = Path(__file__).parents[2] / "docs" / "examples" / "submitit_shards.py"
    words = ["--agent", "greedy", "--scenario", "Block8-DH-v0", "--episodes", "5", "--shards", "2", "--cluster", "local"]
    found = subprocess.run([sys.executable, example, *words], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    result = load_result(tmp_path / "results" / "Block8-DH-v0" / "greedy")
    assert f"CRAL {100 * result.metrics['cral'].mean:.1f} %" in found.stdout
    assert result.summary["workers"] == 2


def test_a_scenario_of_ones_own_may_have_moved(tmp_path):
    own = tmp_path / "here" / "own.toml"
    for path in SCENARIO.path.parent.glob("*/Block8*"):
        place = own.parent / path.relative_to(SCENARIO.path.parent)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, place)
    own.write_text(SCENARIO.path.read_text().replace('id = "Block8-DH-v0"', 'id = "Own-DH-v0"'))
    folder = run_shard(job(scenario=load_scenario(str(own))), Shard(1, 1, N), tmp_path / "results")
    assert merge([folder], tmp_path / "merged").summary["scenario_file"] == str(own)
    moved = shutil.move(tmp_path / "here", tmp_path / "moved")
    with pytest.raises(UavbenchError, match=r"own\.toml"):
        merge([folder], tmp_path / "again")
    assert merge([folder], tmp_path / "again", scenario=str(moved / "own.toml")).summary["episodes"] == N
    assert json.loads((tmp_path / "again" / "Own-DH-v0" / "random" / "summary.json").read_text())["scenario_file"] == str(
        moved / "own.toml"
    )
