"""An agent apart: the same flights as in one process, nothing of the simulator in its reach, and a clear line when it fails."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from running import AGENTS

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.agents.apart import ApartSource
from uavbench.evaluation.evaluate import AgentError, Job, evaluate

AGENT = """
import gc, os, sys, time
import numpy as np

class Agent:
    def __init__(self, scenario):
        print("what an agent prints is no answer")
        {init}

    def act(self, observation, info):
        {act}
"""


def source_of(tmp_path, act="return 4", init="pass"):
    path = tmp_path / "mine.py"
    path.write_text(AGENT.format(act=act, init=init), encoding="utf-8")
    return find_agent(str(path))


def fly(source, scenario="Block8-DH-v0", episodes=2, limit=60.0, **changes):
    job = Job(ApartSource.of(source, limit), load_scenario(scenario), "test", limit)
    return list(evaluate(replace(job, **changes), range(episodes)))


@pytest.mark.parametrize("name", ["random", f"{AGENTS}:One", f"{AGENTS}:Many"])
@pytest.mark.parametrize("scenario", ["Block8-CPP-v0", "Manhattan32-DH-Team-v0"])
def test_it_flies_as_in_one_process(name, scenario):
    source = find_agent(name)
    together = list(evaluate(Job(source, load_scenario(scenario), "test"), range(5)))
    apart = fly(source, scenario, 5)
    assert [record.actions.tolist() for record in apart] == [record.actions.tolist() for record in together]
    assert [record.total_reward for record in apart] == [record.total_reward for record in together]


def test_the_parent_never_imports_it(tmp_path):
    source = source_of(tmp_path)
    source.path.write_text(f"import os\nassert os.getpid() != {os.getpid()}\n" + source.path.read_text(), encoding="utf-8")
    assert len(fly(source)) == 2


def test_it_is_told_what_its_track_allows_and_holds_no_simulator(tmp_path):
    act = """
        assert sorted(info) == ["action_mask", "episode", "seed", "split", "uav"], info
        assert "uavbench.simulation.simulator" not in sys.modules
        frame = sys._getframe()
        while frame:
            assert not any("imulator" in type(value).__name__ for value in frame.f_locals.values())
            frame = frame.f_back
        assert not any("imulator" in type(each).__name__ for each in gc.get_objects())
        return 4"""
    assert len(fly(source_of(tmp_path, act), episodes=1)) == 1


def test_it_is_told_the_safe_actions_if_it_asks_for_them(tmp_path):
    source = source_of(tmp_path, "\n        return int((info['action_mask'] & info['safe_action_mask']).nonzero()[0][-1])")
    text = source.path.read_text(encoding="utf-8")
    source.path.write_text(text.replace("class Agent:\n", "class Agent:\n    safe_mask = True\n"), encoding="utf-8")
    assert len(fly(source, episodes=1)) == 1


@pytest.mark.parametrize(
    ("act", "message"),
    [
        ("raise KeyError('lost')", "episode 0, step 0: act() raised KeyError: 'lost'"),
        ("os._exit(0)", "step 0: act() failed: the agent's process ended with status 0"),
        ("sys.exit(3)", "step 0: act() raised SystemExit: 3"),
        ("return 9", "act() returned 9, expected an integer from 0 to 5"),
        ("return 1.0", "act() returned 1.0"),
        ("return object()", "act() raised TypeError"),
        ("return [4] * 10**6", "act() failed: the agent's process sent no answer (its answer has"),
        ("return np.array([[[4]]])", "act() returned [[[4]]]"),
    ],
)
def test_what_goes_wrong_is_said(tmp_path, act, message):
    with pytest.raises(AgentError) as error:
        fly(source_of(tmp_path, act))
    assert message in str(error.value)


def test_what_it_says_in_the_wrong_place_is_no_answer(tmp_path):
    """It may write whatever it likes to its parent: nothing of that is executed."""
    for junk in (b"junk", b"\xff\xff\xff\xff", b"\x02\0\0\0[]", b"\x01\0\0\0x"):
        act = f"[os.write(fd, {junk!r}) for fd in range(3, 9) if os.path.exists(f'/proc/self/fd/{{fd}}')]; os._exit(1)"
        with pytest.raises(AgentError, match="the agent's process"):
            fly(source_of(tmp_path, act))


@pytest.mark.parametrize(
    "act", ["while True: pass", "time.sleep(1000)", "import signal; signal.setitimer = None; time.sleep(1000)"]
)
def test_an_agent_that_takes_too_long_is_ended(tmp_path, act):
    started = time.monotonic()
    with pytest.raises(AgentError, match=r"act\(\) took longer than 2 s"):
        fly(source_of(tmp_path, act), limit=2.0)
    assert time.monotonic() - started < 30


def test_one_that_cannot_be_loaded_or_made_says_why(tmp_path):
    (tmp_path / "none.py").write_text("x = 1", encoding="utf-8")
    with pytest.raises(AgentError, match=r"__init__\(\) failed: .*none.py: has no class Agent"):
        fly(find_agent(str(tmp_path / "none.py")))
    with pytest.raises(AgentError, match=r"__init__\(\) raised ValueError: no weights"):
        fly(source_of(tmp_path, init="raise ValueError('no weights')"))


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks whether the process is there")
def test_it_ends_with_its_parent(tmp_path):
    pid = tmp_path / "pid"
    source = source_of(tmp_path, f"open({str(pid)!r}, 'w').write(str(os.getpid()) + '.')\n        while True: pass")
    code = f"""
from pathlib import Path
from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.agents.apart import ApartSource
from uavbench.evaluation.evaluate import Job, evaluate
list(evaluate(Job(ApartSource.of(find_agent({str(source.path)!r}), None), load_scenario("Block8-DH-v0"), "test", None), [0]))
"""
    with subprocess.Popen([sys.executable, "-c", code]) as parent:
        while not pid.exists() or not pid.read_text().endswith("."):
            time.sleep(0.1)
        parent.kill()
    child = Path("/proc") / pid.read_text().rstrip(".")
    for _ in range(100):
        if not child.exists() or "Z" in (child / "stat").read_text().rsplit(")", 1)[1].split()[0]:
            return
        time.sleep(0.1)
    pytest.fail("it goes on")


def test_fresh_episodes_are_others_and_look_like_those_of_the_split(tmp_path):
    told = tmp_path / "told"
    act = f"print(info['split'], info['episode'], info['seed'], file=open({str(told)!r}, 'a')); return 4"
    source = source_of(tmp_path, act)
    lines = []
    flown = {}
    for name, fresh in (("test", None), ("fresh", 1), ("again", 1), ("other", 2)):
        told.unlink(missing_ok=True)
        flown[name] = [(each.budget, each.cr) for each in fly(source, episodes=6, fresh=fresh)]
        lines.append(sorted(set(told.read_text().splitlines())))
    assert lines[0] == lines[1] == lines[2] == lines[3]
    assert flown["fresh"] == flown["again"]
    assert len({str(each) for each in flown.values()}) == 3


@pytest.mark.slow
def test_the_numbers_of_a_fresh_flight_do_not_depend_on_workers():
    source, scenario = find_agent("random"), load_scenario("Block8-DH-v0")
    job = Job(ApartSource.of(source, 60.0), scenario, "test", fresh=5)
    one, two = ({r.episode: r.cr for r in evaluate(job, range(40), workers)} for workers in (1, 2))
    assert one == two
    assert np.std(list(one.values())) > 0
