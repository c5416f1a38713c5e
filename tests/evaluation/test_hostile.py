"""Files that somebody else wrote: pipes, devices and folders in the place of files, sizes and counts beyond all bounds.

Each is refused at once and by one line. An alarm ends what would wait or count for ever.
"""

import json
import os
import shutil
import signal
import time

import numpy as np
import pytest
from running import job
from worlds import scenario

from uavbench import ScenarioError, UavbenchError, load_scenario
from uavbench.agents.agent import find_agent
from uavbench.agents.weights import load_weights
from uavbench.errors import one_line
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.evaluation.reference import load_reference
from uavbench.evaluation.replay import replay
from uavbench.evaluation.results import ResultError, load_result
from uavbench.evaluation.run import run
from uavbench.leaderboard.reruns import load_reruns
from uavbench.leaderboard.submission import load_submission
from uavbench.learning.training import read_config
from uavbench.world.files import check_plain, pack_arrays, read_bounded, read_text, read_toml, unpack_arrays

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no pipes among files")


@pytest.fixture
def at_once():
    """End what would take minutes."""

    def late(_signal, _frame):
        raise AssertionError("it waits, or counts")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(20)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    return run(job("greedy", "Block8-CPP-v0"), 3, tmp_path_factory.mktemp("out"))


@pytest.fixture
def result(flown, tmp_path):
    shutil.copytree(flown.folder, tmp_path / "result")
    return tmp_path / "result"


@pytest.fixture
def own(tmp_path):
    """A scenario of a user's own with frozen episodes."""
    source = load_scenario("Block8-CPP-v0").path
    shutil.copytree(source.parent, tmp_path / "scenarios", ignore=lambda _, names: [n for n in names if "Urban" in n])
    return tmp_path / "scenarios" / source.name


def in_place_of(path, kind):
    """Put something else in the place of a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    else:
        with path.open("wb") as file:
            file.truncate(2**33)  # which takes no room on the disk


def frozen(own):
    from uavbench.world.episode import frozen_columns

    return frozen_columns(load_scenario(own), "test")


READERS = {
    "scenario": lambda own, result, kind: (in_place_of(own, kind), load_scenario(own)),
    "map": lambda own, result, kind: (in_place_of(own.parent / "maps" / "Block8.txt", kind), load_scenario(own)),
    "episodes": lambda own, result, kind: (in_place_of(own.parent / "episodes" / "Block8-CPP-v0-test.npz", kind), frozen(own)),
    "reference": lambda own, result, kind: (in_place_of(own, kind), load_reference(own, load_scenario("Block8-CPP-v0"))),
    "summary": lambda own, result, kind: (in_place_of(result / "summary.json", kind), load_result(result)),
    "table": lambda own, result, kind: (in_place_of(result / "episodes.csv", kind), load_result(result)),
    "actions": lambda own, result, kind: (in_place_of(result / "actions.npz", kind), load_result(result)),
    "manifest": lambda own, result, kind: (in_place_of(result / "manifest.toml", kind), load_submission(result)),
    "reruns": lambda own, result, kind: (in_place_of(own, kind), load_reruns(own)),
    "weights": lambda own, result, kind: (in_place_of(own, kind), load_weights(own)),
    "model": lambda own, result, kind: (
        in_place_of(own.with_suffix(".onnx"), kind),
        find_agent(str(own.with_suffix(".onnx"))).make(load_scenario("Block8-CPP-v0")),
    ),
    "agent": lambda own, result, kind: (in_place_of(own.with_suffix(".py"), kind), find_agent(str(own.with_suffix(".py")))),
    "configuration": lambda own, result, kind: (in_place_of(own, kind), read_config(find_agent("ddqn"), str(own))),
    "records": lambda own, result, kind: (
        in_place_of(own.parent / "Block8-CPP-v0" / "greedy.partial" / "records.npz", kind),
        run(job("greedy", "Block8-CPP-v0"), 3, own.parent, resume=True),
    ),
}


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "large"])
@pytest.mark.parametrize("reader", READERS)
@pytest.mark.usefixtures("at_once")
def test_only_plain_files_of_bounded_size_are_read(reader, kind, own, result):
    if reader == "manifest":
        (result / "summary.json").unlink()
    if reader in ("weights", "configuration"):
        pytest.importorskip("torch")
    if reader == "model":
        pytest.importorskip("onnxruntime")
    with pytest.raises((UavbenchError, ValueError)) as caught:
        READERS[reader](own, result, kind)
    assert "\n" not in str(caught.value)
    assert any(word in str(caught.value) for word in ("plain file", "larger than")), str(caught.value)


def test_what_cannot_be_read_is_said_in_one_line(tmp_path):
    for name, reason in (
        ("none", "no such file"),
        ("none/below", "no such file"),
        ("n\0", "no file can"),
        ("n" * 300, "too long"),
    ):
        with pytest.raises(UavbenchError, match=reason):
            read_bounded(tmp_path / name, 10)
    (tmp_path / "ten").write_bytes(b"0123456789")
    assert read_bounded(tmp_path / "ten", 10) == b"0123456789"
    check_plain(tmp_path / "ten", 10)
    with pytest.raises(UavbenchError, match="ten: is larger than 9 bytes"):
        read_bounded(tmp_path / "ten", 9)
    (tmp_path / "latin").write_bytes("é".encode("latin-1"))
    with pytest.raises(UavbenchError, match=r"latin: is not text in UTF-8 \(byte 0 is 0xe9\)"):
        read_text(tmp_path / "latin", 10)
    (tmp_path / "mark").write_bytes(b"\xef\xbb\xbfa\r\nb")
    assert read_text(tmp_path / "mark", 10) == "a\nb"


@pytest.mark.parametrize(
    "text",
    [
        ".".join("a" * 30_000) + " = 1",
        "x = {" + ".".join("a" * 30_000) + " = 1}",
        "[" + ".".join("a" * 16_000) + "]\n" + "\n".join(f"{k:x} = 1" for k in range(4_000)),
        '"\u2028".' * 12_000 + "a = 1",
        "x = " + "[" * 30_000,
        "x = " + "1" * 30_000,
    ],
    ids=["dotted", "inline", "header", "separators", "brackets", "digits"],
)
@pytest.mark.usefixtures("at_once")
def test_toml_that_takes_a_parser_minutes_is_refused_at_once(text, tmp_path):
    path = tmp_path / "manifest.toml"
    path.write_text(text, encoding="utf-8")
    started = time.process_time()
    with pytest.raises(UavbenchError, match=r"manifest\.toml: "):
        read_toml(path)
    assert time.process_time() - started < 2


def test_a_count_in_a_summary_takes_no_memory(result):
    text = (result / "summary.json").read_text()
    summary = {**json.loads(text), "episodes": 2_000_000_000_000}
    (result / "summary.json").write_text(json.dumps(summary))
    found = load_result(result)
    with pytest.raises(UavbenchError, match="does not hold"):
        replay(found)
    with pytest.raises(UavbenchError, match="does not hold"):
        found.scores()


MAP = ("L" + "." * 1023, *("." * 1024 for _ in range(1023)))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"observation": {"local_size": 2049, "global_scale": 3}}, "observation.local_size: 2049 exceeds 2047"),
        ({"mission": {"kind": "coverage", "camera_size": 5, "shapes": (30000, 30000), "target_fraction": (0, 1)}}, "100"),
    ],
)
def test_sizes_have_bounds_and_the_reason_is_said(changes, reason):
    with pytest.raises(ValueError, match=reason):
        scenario(MAP, **changes)


def test_a_large_map_is_frozen_and_flown_in_batches():
    """1,024 × 1,024 cells times 1,000 episodes were 4 GB at once."""
    from uavbench.simulation.memory import episodes_at_once

    assert episodes_at_once(scenario(MAP)) <= 16
    assert all(episodes_at_once(load_scenario(name)) >= 250 for name in ("Urban50-CPP-Team-v0", "Manhattan32-DH-Long-v0"))


def test_batches_do_not_change_what_is_frozen(monkeypatch):
    from uavbench.simulation import freeze

    loaded = load_scenario("Block8-DH-v0")
    whole = pack_arrays(freeze.draw(loaded, "validation"))
    monkeypatch.setattr(freeze, "episodes_at_once", lambda _: 7)
    assert pack_arrays(freeze.draw(loaded, "validation")) == whole


@pytest.mark.slow
def test_episodes_that_no_file_can_hold_are_not_frozen(tmp_path):
    many = scenario(MAP, splits={"test": {"episodes": 30_000}}, path=str(tmp_path / "big.toml"), budget=(1, 2))
    from uavbench.simulation.freeze import freeze

    with pytest.raises(ScenarioError, match=r"splits\.test\.episodes: .* MB"):
        freeze(many)


def test_what_others_say_is_one_line_whatever_they_do():
    class SilentError(Exception):
        def __str__(self):
            raise RuntimeError

    assert one_line(SilentError()) == "SilentError, which cannot say what it is"
    assert one_line("a\n\x1b[31mb\u202e") == "a ?[31mb?"
    assert len(one_line("x" * 10**6)) <= 301


RECORDS = {
    "identity is a list": lambda a: a | {"identity": np.array("[]")},
    "identity is deep": lambda a: a | {"identity": np.array("[" * 100_000)},
    "identity lacks a name": lambda a: a | {"identity": np.array("{}")},
    "a column is missing": lambda a: {name: array for name, array in a.items() if name != "cr"},
    "a column is short": lambda a: a | {"cr": a["cr"][:-1]},
    "a column is text": lambda a: a | {"cr": a["cr"].astype(str)},
    "a column is no column": lambda a: a | {"episode": np.array(3)},
    "a number is not finite": lambda a: a | {"seconds": a["seconds"] * np.nan},
    "an episode is there twice": lambda a: a | {"episode": a["episode"] * 0},
    "an episode is negative": lambda a: a | {"episode": a["episode"] - 1},
    "an episode is out of range": lambda a: a | {"episode": a["episode"] + 2**40},
    "lengths are negative": lambda a: a | {"lengths": a["lengths"] * -1},
    "lengths are too long": lambda a: a | {"lengths": a["lengths"] + 1},
    "actions are flat": lambda a: a | {"actions": a["actions"].reshape(-1)},
    "actions are others": lambda a: a | {"actions": a["actions"] * 0},
    "a score is another": lambda a: a | {"cr": a["cr"] / 2},
    "the return is another": lambda a: a | {"total_reward": a["total_reward"] + 1},
    "spent is text": lambda a: a | {"spent": np.array("long")},
    "spent is infinite": lambda a: a | {"spent": np.array(np.inf)},
    "spent is negative": lambda a: a | {"spent": np.array(-1.0)},
}


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    """The records of a run that was interrupted."""
    out = tmp_path_factory.mktemp("interrupted")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uavbench.evaluation.run.evaluate_with", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(job("greedy", "Block8-CPP-v0"), 3, out)
    return (out / "Block8-CPP-v0" / "greedy.partial" / "records.npz").read_bytes()


@pytest.fixture
def path(tmp_path, records):
    """The file of these records, in a folder of its own."""
    file = tmp_path / "Block8-CPP-v0" / "greedy.partial" / "records.npz"
    file.parent.mkdir(parents=True)
    file.write_bytes(records)
    return file


@pytest.mark.parametrize("change", RECORDS)
def test_crafted_records_of_an_interrupted_run_do_not_become_a_result(change, tmp_path, path):
    path.write_bytes(pack_arrays(RECORDS[change](unpack_arrays(path.read_bytes()))))
    with pytest.raises(ResultError, match=r"records\.npz: damaged .* delete its folder") as caught:
        run(job("greedy", "Block8-CPP-v0"), 3, tmp_path, resume=True)
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("path")
def test_records_of_an_interrupted_run_that_nobody_changed_become_a_result(tmp_path):
    flying = job("greedy", "Block8-CPP-v0")
    flown: list[int] = []
    assert replay(run(flying, 3, tmp_path, resume=True, on_record=lambda record: flown.append(record.episode))) == []
    assert flown == [0, 1, 2]


def interrupted(crew, flying, numbers):
    yield from evaluate(flying, numbers[:2], crew)
    raise KeyboardInterrupt


AGENT = """
class Silent(ValueError):
    def __str__(self):
        raise RuntimeError

class Odd:
    def __repr__(self):
        raise RuntimeError

class Agent:
    def __init__(self, scenario):
        WHERE
    def act(self, observation, info):
        return 4
"""


@pytest.mark.parametrize(
    "text",
    [
        AGENT.replace("WHERE", "raise Silent"),
        AGENT.replace("WHERE", "pass").replace("return 4", "raise Silent"),
        AGENT.replace("WHERE", "pass").replace("return 4", "return Odd()"),
        AGENT.replace("WHERE", "pass") + "raise Silent",
        AGENT.replace("WHERE", "pass") + "    track = Odd()",
    ],
    ids=["making", "acting", "answering", "importing", "track"],
)
def test_what_an_agent_raises_need_not_be_printable(text, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(text)
    source = find_agent(str(path))
    with pytest.raises(UavbenchError) as caught:
        run(Job(source, load_scenario("Block8-CPP-v0"), "test"), 2, tmp_path / "out")
    assert str(path.name) in str(caught.value) or "mine" in str(caught.value)


@pytest.mark.parametrize(
    "record",
    ["[" * 100_000, "[]", "7", '{"agent": [], "scenario": 3}', '{"agent": "ddqn", "scenario": {}}', "{", '{"agent": ["ddqn"]}'],
)
def test_crafted_records_of_a_training_are_one_line(record, tmp_path):
    safetensors = pytest.importorskip("safetensors.numpy")
    path = tmp_path / "crafted.safetensors"
    path.write_bytes(safetensors.save({"a": np.zeros(3, np.float32)}, metadata={"uavbench": record}))
    with pytest.raises(UavbenchError, match=r"crafted\.safetensors") as caught:
        find_agent(str(path))
    assert "\n" not in str(caught.value)
