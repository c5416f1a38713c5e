"""Finding and loading agents."""

from pathlib import Path

import numpy as np
import pytest

from uavbench import load_scenario
from uavbench.agents.agent import AgentLoadError, find_agent
from uavbench.evaluation.evaluate import AgentError, Job, evaluate
from uavbench.world.resources import baseline_paths

AGENTS = Path(__file__).parents[1] / "helpers" / "agents.py"


@pytest.mark.parametrize("name", ["random", "greedy"])
def test_a_built_in_is_its_file(name):
    by_name, by_path = find_agent(name), find_agent(str(baseline_paths()[name]))
    assert (by_name.name, by_name.sha256) == (name, by_path.sha256)
    assert by_name.load() is by_path.load()


def test_a_class_can_be_named():
    source = find_agent(f"{AGENTS}:Many")
    assert (source.name, source.track, source.calls) == ("agents.Many", "observation", ("act", "act_batch"))
    assert find_agent(f"{AGENTS}:Seer").track == "state"
    assert find_agent(f"{AGENTS}:One").calls == ("act",)
    assert type(source.make(load_scenario("Block8-CPP-v0"))).__name__ == "Many"


@pytest.mark.parametrize(
    ("name", "alone", "team"),
    [
        ("One", "act", "act"),
        ("Many", "act_batch", "act_batch"),
        ("Together", "act", "act_team"),
        ("OnlyTogether", "act_team", "act_team"),
    ],
)
def test_it_decides_by_the_method_that_fits_the_scenario(name, alone, team):
    source = find_agent(f"{AGENTS}:{name}")
    assert source.call(load_scenario("Block8-CPP-v0")) == alone
    assert source.call(load_scenario("Manhattan32-CPP-Team-v0")) == team


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (
            "gredy",
            "built in are belief_planner, boustrophedon, ddqn, greedy, imitation, macro_ppo, orienteering, planner, ppo, "
            "quick_planner, random, tsp",
        ),
        ("missing.py", "missing.py: there is no such file"),
        ("missing.py:Class", "missing.py: there is no such file"),
    ],
)
def test_what_is_not_there_is_refused(spec, message):
    with pytest.raises(AgentLoadError, match=message):
        find_agent(spec)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "has no class Agent; name yours as"),
        (":Absent", "has no class Absent"),
        (":not_a_class", "has no class not_a_class"),
        (":Mute", "has neither act"),
        (":Cheater", "track is 'everything'"),
        (":TogetherButBlind", "act_team decides by all that the team sees: set track = 'state'"),
    ],
)
def test_what_does_not_keep_the_contract_is_refused(name, message):
    with pytest.raises(AgentLoadError, match=message):
        find_agent(f"{AGENTS}{name}").load()


@pytest.mark.parametrize(
    ("signature", "weights", "message"),
    [
        ("self", None, r"Agent\(\) cannot be called with \(scenario\); write __init__\(self, scenario\)"),
        ("self, scenario, weights", None, "weights are given by --weights FILE"),
        ("self, scenario", "w", r"mine\.py takes no weights"),
    ],
)
def test_a_class_that_is_made_otherwise_is_refused(tmp_path, signature, weights, message):
    path = tmp_path / "mine.py"
    path.write_text(f"class Agent:\n    def __init__({signature}): pass\n    def act(self, o, i): return 4\n")
    if weights:
        weights = tmp_path / weights
        weights.write_bytes(b"")
    with pytest.raises(AgentLoadError, match=message):
        find_agent(str(path), weights).load()


def test_an_agent_declines_what_it_says_it_does_not_fly(tmp_path):
    """By its own word: a mistake in it is none."""
    path = tmp_path / "mine.py"
    text = "class Agent:\n    def __init__(self, s):\n        LINE\n    def act(self, o, i): return 4\n"
    scenario = load_scenario("Block8-CPP-v0")
    for line, reason in {"raise ValueError('not this')": "not this", "int('x')": None, "raise KeyError('x')": None}.items():
        path.write_text(text.replace("LINE", line))
        with pytest.raises(AgentError) as told:
            list(evaluate(Job(find_agent(str(path)), scenario, "test"), [0]))
        assert getattr(told.value, "reason", None) == reason


def test_a_mistake_while_flying_is_traced(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        "class Agent:\n    def __init__(self, s): pass\n    def act(self, o, i):\n        raise ValueError('lost')\n"
    )
    with pytest.raises(AgentError, match=r"raised ValueError: lost\nTraceback"):
        list(evaluate(Job(find_agent(str(path)), load_scenario("Block8-CPP-v0"), "test"), [0]))


def test_a_file_that_does_not_import_is_refused(tmp_path):
    path = tmp_path / "broken.py"
    path.write_text("import nothing_of_this_name\n")
    with pytest.raises(AgentLoadError, match=r"broken\.py: needs nothing_of_this_name, which is not installed"):
        find_agent(str(path)).load()


def test_an_agent_may_import_its_neighbours(tmp_path):
    (tmp_path / "my_neighbour_module.py").write_text("ACTION = 4\n")
    path = tmp_path / "mine.py"
    path.write_text(
        "from my_neighbour_module import ACTION\n"
        "class Agent:\n    def __init__(self, s): pass\n    def act(self, o, i): return ACTION\n"
    )
    assert find_agent(str(path)).make(load_scenario("Block8-CPP-v0")).act({}, {}) == 4


def test_an_edited_file_is_loaded_anew(tmp_path):
    path = tmp_path / "mine.py"
    text = "class Agent:\n    def __init__(self, s): pass\n    def act(self, o, i): return 4\n"
    path.write_text(text)
    assert find_agent(str(path)).load()(None).act({}, {}) == 4
    path.write_text(text.replace("4\n", "3\n"))
    assert find_agent(str(path)).load()(None).act({}, {}) == 3


def test_a_template_that_does_not_fit_on_the_disk_leaves_no_file(tmp_path, monkeypatch):
    from uavbench.agents.agent import AgentLoadError, write_template

    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full to write to")
    opened = Path.open

    def full(self, *words, **named):
        if self.suffix == ".py" and "x" in words:
            opened(self, *words, **named).close()
            return opened(Path("/dev/full"), "w", encoding="utf-8")
        return opened(self, *words, **named)

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(AgentLoadError, match="No space left"):
        write_template(tmp_path / "mine.py")
    assert list(tmp_path.iterdir()) == []


def test_own_weights_fly_on_the_scenario_of_ones_own_that_they_were_trained_on(tmp_path):
    pytest.importorskip("safetensors", reason="weights need the extra ddqn")
    from uavbench.agents.weights import save_weights, training_facts

    shipped = load_scenario("Block8-CPP-v0").path
    text = shipped.read_text().split("[splits")[0].replace("Block8-CPP-v0", "Mine-v0")
    scenario = tmp_path / "mine.toml"
    scenario.write_text(text.replace("maps/Block8.txt", str(shipped.parent / "maps" / "Block8.txt")))
    agent, weights = tmp_path / "mine.py", tmp_path / "mine.safetensors"
    agent.write_text("class Agent:\n    def __init__(self, s, w): pass\n    def act(self, o, i): return 4\n")
    save_weights(weights, {"w": np.zeros(1)}, {"agent": "mine", **training_facts(load_scenario(scenario))})
    assert find_agent(str(agent), weights).trained_on == str(scenario)
    scenario.rename(tmp_path / "moved.toml")
    with pytest.raises(AgentLoadError, match=r"trained on Mine-v0, a scenario of your own: name its file with --scenario FILE"):
        _ = find_agent(str(agent), weights).trained_on
