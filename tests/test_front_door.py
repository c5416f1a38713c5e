"""The front door: what `import uavbench` offers, as a program uses it."""

import ast
import doctest
import gc
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import uavbench

REFERENCE = (Path(__file__).parents[1] / "docs" / "reference.md").read_text(encoding="utf-8")
PUBLIC = [name for name in uavbench.__all__ if not name.startswith("__")]


class Uniform:
    """Decides at random among the valid actions."""

    def __init__(self, scenario=None):
        self.scenario = scenario

    def reset(self, info):
        self.random = np.random.default_rng(info["seed"])

    def act(self, observation, info):
        return self.random.choice(np.flatnonzero(info["action_mask"]))


def test_the_names_are_those_that_type_checkers_see():
    tree = ast.parse(Path(uavbench.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    typed = {alias.name for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert set(uavbench._LAZY) <= typed
    assert set(uavbench._LAZY) <= set(uavbench.__all__)
    assert dir(uavbench) == sorted(uavbench.__all__)


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_name_is_there_and_documented(name):
    found = getattr(uavbench, name)
    assert inspect.getdoc(found)
    assert re.search(rf"\b{name}\b", REFERENCE)
    if inspect.isfunction(found):
        assert ">>>" in (inspect.getdoc(found) or "")


@pytest.mark.parametrize(
    "module",
    [
        "uavbench",
        "uavbench.agents.agent",
        "uavbench.evaluation.front",
        "uavbench.evaluation.replay",
        "uavbench.evaluation.results",
        "uavbench.pictures.plot",
        "uavbench.world.scenario",
    ],
)
def test_the_examples_of_the_docstrings_hold(module, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = doctest.testmod(importlib.import_module(module))
    assert done.attempted > 0
    assert done.failed == 0


def test_what_is_not_public_is_no_attribute():
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = uavbench.nothing
    with pytest.warns(DeprecationWarning, match="scenario_ids is now list_scenarios"):
        assert uavbench.scenario_ids() == uavbench.list_scenarios()


def test_importing_it_leaves_the_heavy_libraries_alone():
    code = "import sys, uavbench; print([m for m in ('numba', 'pandas', 'matplotlib', 'torch') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_an_object_scores_as_its_class_and_as_its_file(tmp_path):
    path = tmp_path / "uniform.py"
    path.write_text("import numpy as np\n\n\n" + inspect.getsource(Uniform).replace("class Uniform", "class Agent"))
    tables = [
        uavbench.evaluate(agent, "Block8-CPP-v0", episodes=30, workers=workers).episodes()
        for agent, workers in ((Uniform(), 0), (Uniform, 0), (path, 0), (str(path), 2))
    ]
    for table in tables[1:]:
        assert table.equals(tables[0])


def test_a_result_is_replayed_compared_and_drawn(tmp_path):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    greedy = uavbench.evaluate("greedy", "Block8-DH-v0", episodes=20, out=tmp_path)
    assert (greedy.folder, greedy.summary["agent"]) == (tmp_path.absolute() / "Block8-DH-v0" / "greedy", "greedy")
    assert uavbench.replay(greedy) == []
    again = uavbench.load_result(greedy.folder)
    assert again.episodes().equals(greedy.episodes())
    uniform = uavbench.evaluate(Uniform, "Block8-DH-v0", episodes=20, name="uniform")
    assert uniform.summary["agent"] == "uniform"
    assert uavbench.compare(greedy.folder, uniform)["cral"].difference.mean > 0
    figure, (left, right) = pyplot.subplots(1, 2)
    assert uavbench.plot(greedy, ax=left) is left
    assert uavbench.plot(str(greedy.folder), 3, ax=right) is right
    assert left.get_title() != right.get_title()
    pyplot.close(figure)


def test_a_result_that_is_not_asked_for_leaves_nothing_behind():
    result = uavbench.evaluate("random", "Block8-CPP-v0", episodes=2)
    folder = result.folder
    assert folder.is_dir()
    del result
    gc.collect()
    assert not folder.exists()


def test_a_city_of_ones_own_is_flown_replayed_and_observed():
    rows = np.full((9, 12), ".")
    rows[0, :2] = "L"
    rows[4, 2:9] = "#"
    scenario = uavbench.Scenario.from_array(rows, id="Wall-CPP-v0", budget=(20, 40))
    assert scenario.shape == (9, 12)
    assert scenario.observation.local_size == 17
    result = uavbench.evaluate("greedy", scenario, episodes=5)
    assert uavbench.replay(result) == []
    assert result.metrics["landed"].mean == 1.0
    env = uavbench.make(scenario, split="test", order="cycle")
    assert env.reset(seed=0)[0]["local"].shape == (4, 17, 17)


def test_a_scenario_whose_digest_was_read_may_be_the_model_of_another():
    like = uavbench.load_scenario("Block8-CPP-v0")
    assert like.digest
    assert uavbench.Scenario.from_array(["LL..", "....", "..b.", "...."], like=like).digest != like.digest


def test_other_rewards_and_budgets_are_another_scenario():
    plain = uavbench.load_scenario("Manhattan32-DH-v0")
    other = plain.with_rewards(crash=-10.0, collect=2.0)
    assert other.digest != plain.digest
    assert (other.rewards.crash, other.rewards.movement) == (-10.0, plain.rewards.movement)
    short = plain.with_budget(5, 9)
    assert short.splits.test.file is None
    env = uavbench.make(short, split="test", order="cycle")
    budgets = {int(env.reset()[0]["budget"][0]) for _ in range(50)}
    assert budgets == set(range(5, 10))
    result = uavbench.evaluate("greedy", short, episodes=3)
    assert uavbench.replay(result) == []


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (lambda: uavbench.evaluate(object(), "Block8-CPP-v0"), "neither act"),
        (lambda: uavbench.evaluate("greedyy", "Block8-CPP-v0"), "greedyy"),
        (lambda: uavbench.evaluate("greedy", "Block9"), "unknown scenario"),
        (lambda: uavbench.evaluate("greedy", "Block8-CPP-v0", split="tst"), "split: 'tst'"),
        (lambda: uavbench.evaluate("greedy", "Block8-CPP-v0", episodes=0), "episodes: 0 is not an integer from 1 to 1000"),
        (lambda: uavbench.evaluate("greedy", "Block8-CPP-v0", episodes=1.5), "episodes: 1.5"),
        (lambda: uavbench.Scenario.from_array(["LL..", "....", "...."]), "map: 3 rows × 4 columns"),
        (lambda: uavbench.Scenario.from_array(["LL..", "....", "....", "...x"]), "map: row 3, column 3: unknown cell 'x'"),
        (lambda: uavbench.Scenario.from_array(["LL..", "....", "....", "...."], budgt=3), "budgt: unknown key"),
        (lambda: uavbench.load_result("nowhere"), "nowhere"),
    ],
)
def test_what_does_not_fit_is_one_kind_of_error(call, reason):
    with pytest.raises(uavbench.UavbenchError, match=re.escape(reason)):
        call()


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (lambda scenario: scenario.with_rewards(cras=1.0), "rewards.cras: unknown key"),
        (lambda scenario: scenario.with_rewards(crash=float("nan")), "rewards.crash"),
        (lambda scenario: scenario.with_budget(9, 5), "budget: the lower bound 9 exceeds"),
        (lambda scenario: uavbench.make(scenario, budget=7), "budget: 7 is not a pair"),
        (lambda scenario: uavbench.make(scenario, start="here"), "start: 'here' is not one of landing, anywhere"),
        (lambda scenario: uavbench.make_vec(scenario, 2, rewards={"a": 1}), "rewards.a: unknown key"),
    ],
)
def test_a_wrong_argument_names_the_field(call, reason):
    with pytest.raises(ValueError, match=re.escape(reason)):
        call(uavbench.load_scenario("Block8-CPP-v0"))


def test_load_result_takes_a_text():
    with pytest.raises(uavbench.UavbenchError, match="there is no such file"):
        uavbench.load_result("results/nothing")
