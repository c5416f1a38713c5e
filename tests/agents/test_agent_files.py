"""The files that an agent is made of: what it imports is its own, and its digest covers what it imports."""

import pickle
import subprocess
import sys

import pytest

from uavbench import load_scenario
from uavbench.agents.agent import AgentLoadError, find_agent
from uavbench.agents.agent_files import agent_files
from uavbench.world.resources import baseline_paths, shipped_weights

BLOCK8 = load_scenario("Block8-CPP-v0")
AGENT = "from {module} import ACTION\nclass Agent:\n    def __init__(self, s): pass\n    def act(self, o, i): return ACTION\n"


def agent(folder, action, module="helper_of_mine"):
    """Write an agent that takes its action from a neighbour; return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{module}.py").write_text(f"ACTION = {action}\n")
    (folder / "agent.py").write_text(AGENT.format(module=module))
    return folder / "agent.py"


def action(spec):
    return find_agent(str(spec)).make(BLOCK8).act({}, {})


def test_each_agent_gets_its_own_neighbour(tmp_path):
    one, two = agent(tmp_path / "one", 1), agent(tmp_path / "two", 2)
    assert [action(one), action(two), action(one)] == [1, 2, 1]


def test_a_neighbour_comes_before_what_is_installed(tmp_path, monkeypatch):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "helper_of_all.py").write_text("ACTION = 0\n")
    monkeypatch.syspath_prepend(tmp_path / "site")
    import helper_of_all  # pyright: ignore[reportMissingImports]

    assert helper_of_all.ACTION == 0
    assert action(agent(tmp_path / "mine", 3, "helper_of_all")) == 3


def test_a_neighbour_does_not_replace_pythons_own_modules(tmp_path):
    path = agent(tmp_path, 3)
    (tmp_path / "colorsys.py").write_text("raise ImportError('the neighbour')\n")
    path.write_text(f"import colorsys, numpy\n{path.read_text()}")
    assert action(path) == 3


def test_an_edited_neighbour_is_loaded_anew(tmp_path):
    path = agent(tmp_path, 1)
    assert action(path) == 1
    (tmp_path / "helper_of_mine.py").write_text("ACTION = 2\n")  # of the same size, within the same second
    assert action(path) == 2


def test_a_package_in_the_current_folder_is_found(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    agent(tmp_path / "package_of_mine", 4)
    (tmp_path / "package_of_mine" / "agent.py").write_text(AGENT.format(module="package_of_mine.helper_of_mine"))
    (tmp_path / "package_of_mine" / "__init__.py").touch()
    assert action("package_of_mine/agent.py") == 4


def test_a_module_is_an_agent(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    agent(tmp_path / "module_of_mine", 3)
    (tmp_path / "module_of_mine" / "agent.py").write_text(AGENT.format(module=".helper_of_mine"))
    (tmp_path / "module_of_mine" / "__init__.py").touch()
    found = find_agent("module_of_mine.agent:Agent")
    assert (found.name, action("module_of_mine.agent:Agent")) == ("agent", 3)
    before = found.digest(BLOCK8)
    (tmp_path / "module_of_mine" / "helper_of_mine.py").write_text("ACTION = 1\n")
    assert find_agent("module_of_mine.agent:Agent").digest(BLOCK8) != before
    with pytest.raises(AgentLoadError, match=r"there is no module module_of_mine\.other"):
        find_agent("module_of_mine.other:Agent")


@pytest.mark.parametrize("name", sorted(baseline_paths()))
def test_a_built_in_has_one_digest_however_it_is_called(name, monkeypatch):
    path = baseline_paths()[name]
    monkeypatch.chdir(path.parents[1])
    scenario = load_scenario("Manhattan32-CPP-v0")
    digests = {find_agent(spec).digest(scenario) for spec in (name, str(path), f"{path.parent.name}/{path.name}")}
    assert len(digests) == 1
    if scenario.id in shipped_weights(name):
        assert digests != {find_agent(name).sha256}


def test_the_digest_covers_what_is_imported(tmp_path):
    path = agent(tmp_path, 1)
    (tmp_path / "helper_of_mine.py").write_text("import deeper_helper\nACTION = 1\n")
    (tmp_path / "deeper_helper.py").touch()
    (tmp_path / "stranger.py").touch()
    assert {each.name for each in agent_files(path)} == {"agent.py", "helper_of_mine.py", "deeper_helper.py"}
    before = find_agent(str(path)).digest(BLOCK8)
    (tmp_path / "stranger.py").write_text("# not imported")
    assert find_agent(str(path)).digest(BLOCK8) == before
    (tmp_path / "deeper_helper.py").write_text("# imported")
    assert find_agent(str(path)).digest(BLOCK8) != before


def test_what_is_imported_within_a_function_counts_too(tmp_path):
    path = agent(tmp_path, 1)
    (tmp_path / "late_helper.py").touch()
    path.write_text(path.read_text() + "def late():\n    import late_helper\n")
    assert tmp_path / "late_helper.py" in agent_files(path)


def test_baselines_that_are_imported_count():
    baselines = baseline_paths()
    assert baselines["planner"] in agent_files(baselines["belief_planner"])
    assert agent_files(baselines["random"]) == [baselines["random"]]


def test_line_ends_do_not_count(tmp_path):
    path = agent(tmp_path, 1)
    before = find_agent(str(path)).digest(BLOCK8)
    for each in (path, tmp_path / "helper_of_mine.py"):
        each.write_bytes(each.read_bytes().replace(b"\n", b"\r\n"))
    assert find_agent(str(path)).digest(BLOCK8) == before


@pytest.mark.parametrize("name", ["..py", "a b/.hidden.py", " .py"])
def test_a_name_that_no_result_can_have_is_refused(tmp_path, name):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(AGENT.replace("{module}", "math"))
    with pytest.raises(AgentLoadError, match="give another name with --name NAME"):
        find_agent(str(path))
    assert find_agent(str(path), name="mine").name == "mine"
    for bad in ("a/b", "..", "", "x\ny", "a:b"):
        with pytest.raises(AgentLoadError, match=r"--name: .*results are filed under it"):
            find_agent("greedy", name=bad)


def test_a_link_keeps_its_name(tmp_path):
    (tmp_path / "linked.py").symlink_to(agent(tmp_path / "there", 1))
    assert find_agent(str(tmp_path / "linked.py")).name == "linked"
    assert action(tmp_path / "linked.py") == 1


def test_an_agent_is_sent_to_another_process_as_its_path(tmp_path):
    """What is cached of it, a class that only this process knows, stays here."""
    path = agent(tmp_path, 1)
    code = (
        "import pickle, sys; from uavbench.agents.agent import find_agent\n"
        f"source = find_agent({str(path)!r}); source.load()\n"
        "sys.stdout.buffer.write(pickle.dumps(source))"
    )
    packed = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout
    assert pickle.loads(packed).make(BLOCK8).act({}, {}) == 1
