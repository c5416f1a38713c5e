"""Runs: interrupted ones end in the same result, and nothing that was flown is lost."""

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from running import AGENTS, N, files, job

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import AgentError, Job
from uavbench.evaluation.results import ResultError
from uavbench.evaluation.run import run


def interrupt(out, stopped, episodes=N, workers=1):
    """Run until the agent fails or is interrupted in episode 3."""
    with pytest.raises((AgentError, KeyboardInterrupt)):
        run(stopped, episodes, out, workers=workers)


@pytest.fixture
def stoppable(tmp_path):
    """An agent that stops at episode 7 for as long as a file is there."""
    stop = tmp_path / "stop"
    stop.touch()
    path = tmp_path / "mine.py"
    path.write_text(
        "import os, sys\n"
        f"sys.path.insert(0, {str(AGENTS.parent)!r})\n"
        "import agents\n"
        "class Agent(agents.One):\n"
        "    def act(self, observation, info):\n"
        f"        if info['episode'] == 7 and os.path.exists({str(stop)!r}):\n"
        "            raise WHAT\n"
        "        return super().act(observation, info)\n"
    )
    return path, stop


@pytest.mark.parametrize(("what", "workers"), [("KeyboardInterrupt", 1), ("ValueError('no')", 1), ("ValueError('no')", 2)])
def test_an_interrupted_run_resumes_to_the_same_result(stoppable, tmp_path, what, workers):
    path, stop = stoppable
    path.write_text(path.read_text().replace("WHAT", what))
    mine = Job(find_agent(str(path)), load_scenario("Block8-DH-v0"), "test")
    interrupt(tmp_path / "broken", mine, workers=workers)
    folder = tmp_path / "broken" / "Block8-DH-v0"
    assert [found.name for found in folder.iterdir()] == ["mine.partial"]
    with pytest.raises(ResultError, match=r"unfinished run of mine .* of 20 episodes done: finish it with --resume"):
        run(mine, N, tmp_path / "broken")
    stop.unlink()
    seen = []
    resumed = run(mine, N, tmp_path / "broken", resume=True, on_record=lambda r: seen.append(r.episode))
    assert sorted(seen) == list(range(N))
    whole = run(mine, N, tmp_path / "whole")
    assert files(resumed.folder) == files(whole.folder)
    assert [found.name for found in folder.iterdir()] == ["mine"]


def test_a_run_does_not_resume_as_another(stoppable, tmp_path):
    path, stop = stoppable
    path.write_text(path.read_text().replace("WHAT", "ValueError('no')"))
    scenario = load_scenario("Block8-DH-v0")
    interrupt(tmp_path, Job(find_agent(str(path)), scenario, "test"))
    stop.unlink()
    for changed, episodes, name in (
        (Job(find_agent(str(path)), scenario, "validation"), N, "split"),
        (Job(find_agent(str(path)), scenario, "test"), N + 1, "episodes"),
    ):
        with pytest.raises(ResultError, match=f"its {name} is"):
            run(changed, episodes, tmp_path, resume=True)
    path.write_text(path.read_text() + "\n")
    with pytest.raises(ResultError, match="its agent_sha256 is"):
        run(Job(find_agent(str(path)), scenario, "test"), N, tmp_path, resume=True)
    (tmp_path / "Block8-DH-v0" / "mine.partial" / "records.npz").write_bytes(b"PK\x03\x04 not it")
    with pytest.raises(ResultError, match=r"records\.npz: damaged"):
        run(Job(find_agent(str(path)), scenario, "test"), N, tmp_path, resume=True)


def test_another_run_does_not_replace_an_unfinished_one(stoppable, tmp_path):
    path, stop = stoppable
    path.write_text(path.read_text().replace("WHAT", "ValueError('no')"))
    scenario = load_scenario("Block8-DH-v0")
    mine = Job(find_agent(str(path)), scenario, "test")
    interrupt(tmp_path, mine)
    stop.unlink()
    kept = (tmp_path / "Block8-DH-v0" / "mine.partial" / "records.npz").read_bytes()
    for changed, episodes in ((replace(mine, split="validation"), N), (mine, 5)):
        with pytest.raises(ResultError, match=r"of 20 test episodes done: finish it first, give another --out, or --overwrite"):
            run(changed, episodes, tmp_path)
        assert (tmp_path / "Block8-DH-v0" / "mine.partial" / "records.npz").read_bytes() == kept
    assert run(mine, 5, tmp_path, overwrite=True).summary["episodes"] == 5


def test_an_agent_that_was_edited_since_it_was_interrupted_starts_over(stoppable, tmp_path):
    path, stop = stoppable
    path.write_text(path.read_text().replace("WHAT", "ValueError('no')"))
    scenario = load_scenario("Block8-DH-v0")
    interrupt(tmp_path, Job(find_agent(str(path)), scenario, "test"))
    stop.unlink()
    path.write_text(path.read_text() + "\n")
    flown = []
    run(Job(find_agent(str(path)), scenario, "test"), N, tmp_path, on_record=lambda record: flown.append(record.episode))
    assert sorted(flown) == list(range(N))
    assert [found.name for found in (tmp_path / scenario.id).iterdir()] == ["mine"]


@pytest.fixture
def weighted(tmp_path):
    """An agent that takes the action which its weights hold; returns the job and the file of the weights."""
    weights = tmp_path / "weights"
    weights.write_text("4")
    (tmp_path / "mine.py").write_text(
        "from pathlib import Path\nclass Agent:\n    def __init__(self, scenario, weights):\n"
        "        self.action = int(Path(weights).read_text())\n"
        "    def act(self, observation, info):\n        return self.action\n"
    )
    return Job(find_agent(str(tmp_path / "mine.py"), weights), load_scenario("Block8-DH-v0"), "test"), weights


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("change", ["edit", "delete"])
def test_an_agent_whose_weights_change_while_it_flies_has_no_result(tmp_path, weighted, workers, change):
    mine, weights = weighted

    def edit(record):
        weights.write_text("5") if change == "edit" else weights.unlink(missing_ok=True)

    with pytest.raises(ResultError, match="files or weights changed while it flew"):
        run(mine, N, tmp_path / "out", workers=workers, on_record=edit)
    assert not list(tmp_path.glob("out/*/*"))


def test_what_was_flown_by_changed_weights_is_not_gone_on_with_when_the_old_ones_are_back(tmp_path, weighted, monkeypatch):
    """Not even what was kept before the change was found out."""
    monkeypatch.setattr("uavbench.evaluation.run._CHECKPOINT_SECONDS", 0.0)
    mine, weights = weighted
    flown = []

    def stop(record):
        if len(flown) == 5:
            weights.write_text("5")
        flown.append(record.episode)

    with pytest.raises(ResultError, match="nothing that it flew is kept") as told:
        run(mine, N, tmp_path / "out", on_record=stop)
    assert "--resume" not in str(getattr(told.value, "__notes__", ""))
    weights.write_text("4")
    flown.clear()
    run(mine, N, tmp_path / "out", resume=True, on_record=lambda record: flown.append(record.episode))
    assert flown == list(range(N))


def test_an_agent_that_changes_and_is_interrupted_keeps_nothing(tmp_path, weighted):
    mine, weights = weighted

    def stop(record):
        weights.write_text("5")
        raise KeyboardInterrupt

    with pytest.raises(ResultError, match="nothing that it flew is kept"):
        run(mine, N, tmp_path / "out", on_record=stop)
    assert not list(tmp_path.glob("out/*/*"))


def test_an_agent_that_is_saved_while_its_process_starts_has_no_result(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text("class Agent:\n    def __init__(self, s): pass\n    def act(self, o, i): return 4\n")
    mine = Job(find_agent(str(path)), load_scenario("Block8-DH-v0"), "test")
    with pytest.raises(ResultError, match="files or weights changed while it flew"):
        run(mine, N, tmp_path / "out", on_start=lambda: path.write_text(path.read_text().replace("4", "5")))
    assert not list(tmp_path.glob("out/*/*"))


def test_two_agents_of_one_name_do_not_replace_each_others_results(tmp_path):
    scenario = load_scenario("Block8-DH-v0")
    text = "class Agent:\n    def __init__(self, s): pass\n    def act(self, o, i): return 4\n"
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "agent.py").write_text(f"{text}# {folder}\n")
    one, two = (Job(find_agent(str(tmp_path / folder / "agent.py")), scenario, "test") for folder in ("a", "b"))
    before = files(run(one, N, tmp_path).folder)
    for resume in (False, True):
        with pytest.raises(ResultError, match=r"another agent that is called agent \(.*a.agent\.py\).*--name NAME"):
            run(two, N, tmp_path, resume=resume)
    assert files(tmp_path / scenario.id / "agent") == before
    named = Job(find_agent(str(tmp_path / "b" / "agent.py"), name="other"), scenario, "test")
    assert run(named, N, tmp_path).folder.name == "other"
    assert run(two, N, tmp_path, overwrite=True).summary["agent_file"] == str(tmp_path / "b" / "agent.py")
    edited = tmp_path / "b" / "agent.py"
    edited.write_text(f"{text}# edited\n")
    run(Job(find_agent(str(edited)), scenario, "test"), N, tmp_path)  # the same file, as it is now


def test_an_unfinished_run_is_not_replaced_by_that_of_another_agent_of_its_name(stoppable, tmp_path):
    path, _ = stoppable
    path.write_text(path.read_text().replace("WHAT", "ValueError('no')"))
    scenario = load_scenario("Block8-DH-v0")
    interrupt(tmp_path, Job(find_agent(str(path)), scenario, "test"))
    kept = (tmp_path / "Block8-DH-v0" / "mine.partial" / "records.npz").read_bytes()
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "mine.py").write_text(
        "class Agent:\n    def __init__(self, s): pass\n    def act(self, o, i): return 4\n"
    )
    with pytest.raises(ResultError, match="of another agent of that name"):
        run(Job(find_agent(str(tmp_path / "b" / "mine.py")), scenario, "test"), N, tmp_path)
    assert (tmp_path / "Block8-DH-v0" / "mine.partial" / "records.npz").read_bytes() == kept


def test_what_lies_beside_a_result_stays(tmp_path):
    folder = run(job(), N, tmp_path).folder
    (folder / "notes.txt").write_text("precious")
    (folder / "figures").mkdir()
    run(job(), N, tmp_path)
    assert (folder / "notes.txt").read_text() == "precious"
    assert (folder / "figures").is_dir()


def test_an_agent_that_goes_elsewhere_leaves_its_results_where_they_were_asked_for(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    path = tmp_path / "mine.py"
    path.write_text(
        f"import os\nos.chdir({str(tmp_path / 'elsewhere')!r})\n"
        "class Agent:\n    def __init__(self, s): pass\n    def act(self, o, i): return 4\n"
    )
    result = run(Job(find_agent("mine.py"), load_scenario("Block8-DH-v0"), "test"), N, Path("results"))
    assert result.folder == tmp_path / "results" / "Block8-DH-v0" / "mine"
    assert (result.folder / "summary.json").is_file()


def test_a_result_that_cannot_be_written_is_said(tmp_path):
    folder = tmp_path / "Block8-DH-v0"
    folder.mkdir()
    (folder / job().source.name).write_text("in the way")
    with pytest.raises(ResultError, match="--out: cannot write"):
        run(job(), N, tmp_path)
    assert (folder / job().source.name).read_text() == "in the way"


@pytest.mark.parametrize("seconds", [0, 60])
def test_a_disk_that_fills_up_meanwhile_is_said_and_what_was_kept_before_stays(tmp_path, monkeypatch, stoppable, seconds):
    def full(path, content):
        raise OSError(28, "No space left on device", str(path))

    path, stop = stoppable
    path.write_text(path.read_text().replace("WHAT", "ValueError"))
    mine = Job(find_agent(str(path)), load_scenario("Block8-DH-v0"), "test")
    interrupt(tmp_path, mine)
    partial = tmp_path / "Block8-DH-v0" / "mine.partial" / "records.npz"
    kept = partial.read_bytes()
    monkeypatch.setattr("uavbench.evaluation.kept.write_atomic", full)
    monkeypatch.setattr("uavbench.evaluation.run._CHECKPOINT_SECONDS", seconds)
    if seconds:  # the agent fails, and what it did cannot be kept: both are said
        with pytest.raises(AgentError, match="episode 7") as told:
            run(mine, N, tmp_path, resume=True)
    else:
        stop.unlink()
        with pytest.raises(ResultError, match=r"--out: cannot write .*records\.npz: No space") as told:
            run(mine, N, tmp_path, resume=True)
    said = "\n".join([str(told.value), *getattr(told.value, "__notes__", [])])
    assert (said.count("records.npz: No space left"), "are kept" in said) == (1, False)
    assert partial.read_bytes() == kept


def test_a_failed_run_leaves_the_earlier_result_alone(tmp_path):
    good = run(job(), N, tmp_path)
    before = files(good.folder)
    bad = tmp_path / "Block8-DH-v0" / "agents.Raises"
    shutil.copytree(good.folder, bad)
    with pytest.raises(AgentError):
        run(job("Raises"), N, tmp_path)
    assert files(bad) == before


def test_a_script_that_runs_at_its_top_level_is_not_run_again_by_the_workers(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from pathlib import Path\nfrom uavbench import load_scenario\nfrom uavbench.agents.agent import find_agent\n"
        "from uavbench.evaluation.evaluate import Job\nfrom uavbench.evaluation.run import run\nprint('once')\n"
        "job = Job(find_agent('random'), load_scenario('Block8-CPP-v0'), 'test')\n"
        "print(run(job, 3, Path('results')).summary['episodes'])\n"
    )
    found = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stdout) == (0, "once\n3\n"), found.stderr
