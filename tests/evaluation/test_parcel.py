"""An evaluation arrives as it was sent, or not at all."""

import pickle
import subprocess
import sys
from dataclasses import replace

import pytest

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.evaluation.parcel import ParcelError, pack, pack_scenario, unpack, unpack_scenario

SCENARIO = load_scenario("Block8-DH-v0")
OWN = """import helper
class Agent:
    def __init__(self, scenario): pass
    def act(self, observation, info): return helper.choose(info)
"""


def episodes(job):
    """What is flown, apart from times."""
    return [(r.episode, r.cr, r.landed, r.actions.tobytes()) for r in evaluate(job, range(3))]


def arrived(job):
    """The job as it arrives elsewhere."""
    return unpack(pickle.loads(pickle.dumps(pack(job))))


@pytest.fixture
def own(tmp_path):
    """An agent of two files, and a scenario with a map, frozen episodes and devices of its own."""
    (tmp_path / "agent").mkdir()
    (tmp_path / "agent" / "mine.py").write_text(OWN)
    (tmp_path / "agent" / "helper.py").write_text("def choose(info): return int(info['action_mask'].argmax())\n")
    place = tmp_path / "world" / "deep"
    place.mkdir(parents=True)
    folder = SCENARIO.path.parent
    (tmp_path / "world" / "map.txt").write_bytes((folder / SCENARIO.map).read_bytes())
    text = SCENARIO.path.read_text().replace('id = "Block8-DH-v0"', 'id = "Own-DH-v0"').replace(SCENARIO.map, "../map.txt")
    for split in ("validation", "test"):
        name = getattr(SCENARIO.splits, split).file
        (place / f"{split}.npz").write_bytes((folder / name).read_bytes())
        text = text.replace(name, f"{split}.npz")
    (place / "own.toml").write_text(text)
    return Job(find_agent(str(tmp_path / "agent" / "mine.py")), load_scenario(place / "own.toml"), "test")


def test_built_in_agents_and_shipped_scenarios_do_not_travel():
    job = Job(find_agent("greedy"), SCENARIO, "test", decision_timeout=7.0)
    parcel = pack(job)
    assert (parcel.agent, parcel.weights, parcel.scenario.files) == ((), (), ())
    assert len(pickle.dumps(parcel)) < 3_000
    found = arrived(job)
    assert (found.decision_timeout, found.split, found.scenario.id) == (7.0, "test", SCENARIO.id)
    assert episodes(found) == episodes(job)


def test_an_own_agent_and_an_own_scenario_travel_with_all_their_files(own, tmp_path):
    parcel = pack(own)
    assert [name for name, _ in parcel.agent] == ["mine.py", "helper.py"]
    sent = pickle.dumps(parcel)
    before = episodes(own)
    code = (
        "import pickle, sys\nfrom pathlib import Path\nfrom uavbench.evaluation.parcel import unpack\n"
        "from uavbench.evaluation.evaluate import evaluate\n"
        "job = unpack(pickle.load(open(sys.argv[1], 'rb')))\n"
        "print([(r.episode, r.cr, r.landed, r.actions.tobytes()) for r in evaluate(job, range(3))])\n"
    )
    (tmp_path / "parcel").write_bytes(sent)
    (tmp_path / "agent").rename(tmp_path / "gone")
    (tmp_path / "world").rename(tmp_path / "away")
    found = subprocess.run([sys.executable, "-c", code, tmp_path / "parcel"], capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    assert found.stdout.strip() == str(before)


def test_a_scenario_of_many_cities_travels(tmp_path):
    cities = load_scenario("Cities32-CPP-v0")
    (tmp_path / "cities.npz").write_bytes((cities.path.parent / cities.cities.frozen.file).read_bytes())
    text = cities.path.read_text().replace('id = "Cities32-CPP-v0"', 'id = "Own-CPP-v0"')
    text = text.replace(cities.cities.frozen.file, "cities.npz")
    for split in ("validation", "test"):
        name = getattr(cities.splits, split).file
        if name:
            (tmp_path / f"{split}.npz").write_bytes((cities.path.parent / name).read_bytes())
            text = text.replace(name, f"{split}.npz")
    (tmp_path / "own.toml").write_text(text)
    job = Job(find_agent("greedy"), load_scenario(tmp_path / "own.toml"), "test")
    assert episodes(arrived(job)) == episodes(job)


@pytest.mark.parametrize("fact", ["uavbench", "agent_sha256"])
def test_what_is_another_version_on_arrival_is_refused(fact):
    parcel = pack(Job(find_agent("greedy"), SCENARIO, "test"))
    facts = tuple((name, "another" if name == fact else value) for name, value in parcel.facts)
    with pytest.raises(ParcelError, match=f"greedy on Block8-DH-v0: its {fact} is .* and another where it was sent from"):
        unpack(replace(parcel, facts=facts))


def test_a_scenario_that_is_another_one_on_arrival_is_refused():
    parcel = pack_scenario(SCENARIO)
    with pytest.raises(ParcelError, match=r"Block8-DH-v0: its scenario_digest is .* and another where it was sent from"):
        unpack_scenario(replace(parcel, digest="another"))


def test_an_agent_whose_file_was_changed_on_the_way_is_refused(own):
    parcel = pack(own)
    name, content = parcel.agent[1]
    with pytest.raises(ParcelError, match="mine on Own-DH-v0: its agent_sha256"):
        unpack(replace(parcel, agent=(parcel.agent[0], (name, content.replace(b"argmax", b"argmin")))))


def test_what_cannot_be_sent_is_refused(own):
    with pytest.raises(ParcelError, match=r"pack\.mine: a module cannot be sent to other machines: name the agent's file"):
        pack(replace(own, source=replace(own.source, module_name="pack.mine")))
    in_memory = SCENARIO.from_array(["LL...", ".....", "..##.", "....."], id="Tiny-CPP-v0", budget=(10, 20))
    with pytest.raises(ParcelError, match=r"Tiny-CPP-v0: it is in no file"):
        pack(replace(own, scenario=in_memory))
