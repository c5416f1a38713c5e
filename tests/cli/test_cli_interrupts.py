"""Commands that are interrupted or killed: what was finished is kept, and nothing goes on in the background."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from uavbench.world.files import unpack_arrays

AGENTS = Path(__file__).parents[1] / "helpers" / "agents.py"


def command(*words):
    """Start a command as a process of its own, in a group of its own, that hears signals as one in a terminal does."""
    heard = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # a job in the background ignores it
    start = [sys.executable, "-c", f"{heard}; from uavbench.cli.app import app; app()", *map(str, words)]
    return subprocess.Popen(start, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def wait_for(condition):
    for _ in range(1200):
        if condition():
            return
        time.sleep(0.1)
    raise AssertionError("it does not come")


def slow_agent(tmp_path, act="act"):
    """Write an agent that takes its time; return its path, and the file that it makes when it has flown for a while."""
    agent, under_way = tmp_path / "slow.py", tmp_path / "under_way"
    agent.write_text(
        "import os, time\nclass Agent:\n    def __init__(self, s):\n"
        f"        open({str(tmp_path)!r} + f'/process-{{os.getpid()}}', 'w').close()\n"
        f"    def {act}(self, o, i):\n"
        "        batch = isinstance(i, list)\n"
        f"        if len(i) < 60 if batch else i['episode'] == 60: open({str(under_way)!r}, 'w').close()\n"
        "        time.sleep(0.06 if batch else 0.001); return [4] * len(i) if batch else 4\n"
    )
    return agent, under_way


def workers_of(tmp_path):
    """Return which processes an agent of `slow_agent` flies in that are still there."""
    there = [int(path.name.partition("-")[2]) for path in tmp_path.glob("process-*")]
    return [each for each in there if Path(f"/proc/{each}").exists()]


posix = pytest.mark.skipif(os.name == "nt", reason="sends signals, which Windows does not have")


@posix
@pytest.mark.parametrize(
    ("act", "workers", "sent"),
    [
        ("act", 1, signal.SIGTERM),
        ("act", 2, signal.SIGINT),
        pytest.param("act_batch", 2, signal.SIGTERM, marks=pytest.mark.slow),
    ],
)
def test_an_interrupted_run_keeps_what_was_finished_and_goes_on_to_the_same_result(tmp_path, act, workers, sent):
    agent, under_way = slow_agent(tmp_path, act)
    words = ["evaluate", "--agent", agent, "--scenario", "Block8-CPP-v0", "--workers", workers, "--episodes", 250]
    process = command(*words, "--out", tmp_path / "out")
    wait_for(under_way.exists)
    for each in workers_of(tmp_path):  # as a batch system does: to all processes of the job
        os.kill(each, sent)
    time.sleep(0.5)
    os.killpg(process.pid, sent)  # as a terminal does: to all processes of the group
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1, errors
    assert "interrupted\nfinished episodes are kept" in errors
    assert not workers_of(tmp_path)
    kept = unpack_arrays((tmp_path / "out" / "Block8-CPP-v0" / "slow.partial" / "records.npz").read_bytes())
    assert len(kept["episode"]) >= 50
    agent.write_text(agent.read_text())  # of the same digest
    if act == "act_batch":
        for out in ("out", "whole"):
            again = command(*words, "--out", tmp_path / out, *(["--resume"] if out == "out" else []))
            said = again.communicate(timeout=120)
            assert again.returncode == 0, said
        one, two = (tmp_path / out / "Block8-CPP-v0" / "slow" for out in ("out", "whole"))
        assert all((one / name).read_bytes() == (two / name).read_bytes() for name in ("episodes.csv", "actions.npz"))


@posix
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_another_interrupt_while_the_process_ends_changes_nothing(tmp_path, sent):
    """A terminal or a batch system may send its signal again; it can arrive as late as in Python's own shutdown."""
    code = (
        "import atexit, os, signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "import uavbench.cli.app, uavbench\n"
        "def interrupted(): raise KeyboardInterrupt\n"
        "uavbench.list_scenarios = interrupted\n"
        f"atexit.register(lambda: os.kill(os.getpid(), {int(sent)}))\n"
        "uavbench.cli.app.app(['list'])\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True, timeout=60)
    assert (ended.returncode, ended.stderr) == (1, "uavbench: interrupted\n")


@posix
def test_an_early_interrupt_says_so(tmp_path):
    """While the workers start, or before: there is nothing to keep yet."""
    agent, _ = slow_agent(tmp_path)
    for delay in (0.8, 1.6):
        words = ("evaluate", "--agent", agent, "--scenario", "Block8-CPP-v0", "--workers", 2, "--out", tmp_path / "out")
        process = command(*words)
        time.sleep(delay)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60)
        assert process.returncode in (1, 130, -signal.SIGINT), errors
        assert "out of memory" not in errors
        assert "exit status" not in errors


@posix
def test_workers_of_a_killed_process_end(tmp_path):
    agent, under_way = slow_agent(tmp_path)
    process = command("evaluate", "--agent", agent, "--scenario", "Block8-CPP-v0", "--workers", 2, "--out", tmp_path / "out")
    wait_for(under_way.exists)
    assert len(workers_of(tmp_path)) == 2
    process.kill()
    process.communicate(timeout=60)
    wait_for(lambda: not workers_of(tmp_path))


@posix
def test_interrupted_bounds_keep_what_was_done(tmp_path):
    pytest.importorskip("highspy")
    words = ("bound", "Manhattan32-CPP-v0", "--seconds", 600, "--workers", 2, "--out", tmp_path)
    process = command(*words)
    found = tmp_path / "Manhattan32-CPP-v0.csv"
    wait_for(found.is_file)  # the table begins with what is known already
    time.sleep(3.0)
    process.send_signal(signal.SIGTERM)  # as a batch system does that knows only the first process
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1, errors
    assert "interrupted; what is done is kept" in errors
    assert found.read_text().count("\n") == 1001
