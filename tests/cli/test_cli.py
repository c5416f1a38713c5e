"""The commands, as a user types them."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import uavbench
from uavbench.cli.app import app
from uavbench.world.cells import rows_of
from uavbench.world.shown_map import shown_city

AGENTS = Path(__file__).parents[1] / "helpers" / "agents.py"


@pytest.fixture
def call(tmp_path, monkeypatch):
    """Run a command in an empty folder; return its exit code and all it printed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*words):
        found = CliRunner().invoke(app, [str(word) for word in words])
        return found.exit_code, found.output

    return run


def test_the_main_job(call):
    assert call("new", "my_agent.py")[0] == 0
    code, text = call("check", "my_agent.py")
    assert code == 0
    assert "keeps the contract" in text
    code, text = call("evaluate", "--agent", "my_agent.py", "--scenario", "Manhattan32-CPP-v0", "--episodes", 30)
    assert code == 0
    for line in (r"Landed.*\[", r"CR .*\[", r"CRAL.*\[", "30/30"):
        assert re.search(line, text), line
    folder = "results/Manhattan32-CPP-v0/my_agent"
    assert Path(folder, "summary.json").is_file()
    code, text = call("replay", folder)
    assert code == 0
    assert "all 30 episodes reproduced" in text
    call("evaluate", "--agent", "greedy", "--episodes", 30)
    code, text = call("compare", "results/Manhattan32-CPP-v0/greedy", folder)
    assert code == 0
    assert re.search(r"CRAL.*\+\d\d\.\d.*\[\+", text)


def test_lists_and_shows_every_scenario(call):
    code, text = call("list")
    assert code == 0
    for name in uavbench.list_scenarios():
        assert name in text
        code, shown = call("show", name)
        assert code == 0
        assert uavbench.load_scenario(name).digest in shown
        assert rows_of(shown_city(uavbench.load_scenario(name), "test", 0))[0] in shown


def test_help_has_examples_for_every_command(call):
    def names(group):
        return [command.name or command.callback.__name__ for command in group.registered_commands]

    assert {"list", "evaluate", "bound", "train", "submit", "plot"} <= set(names(app))
    assert all(f"\n  {command}" in call("--help")[1] for command in names(app))
    nested = [(group.name, command) for group in app.registered_groups for command in names(group.typer_instance)]
    assert ("leaderboard", "build") in nested
    for words in [*((command,) for command in names(app)), *nested]:
        code, text = call(*words, "--help")
        assert code == 0
        assert f"\n    uavbench {' '.join(words)}" in text.split("Example")[1]
        assert "\\" not in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["show", "Manhatan32-CPP-v0"], "did you mean Manhattan32-CPP-v0?"),
        (["show", "manhattan32-cpp-v0"], "did you mean Manhattan32-CPP-v0?"),
        (["freeze", "Block8-CPP-v0"], "splits.validation.file: frozen already"),
        (["evaluate", "--agent", "greedy", "--weights", __file__], ": greedy takes no weights"),
        (["train", "nowhere.py"], "agent nowhere.py: there is no such file"),
        (
            ["evaluate", "--agent", "gredy"],
            "built in are belief_planner, boustrophedon, ddqn, greedy, imitation, macro_ppo, orienteering, planner, ppo, "
            "quick_planner, random, tsp",
        ),
        (["evaluate", "--agent", "random", "--scenario", "Block9"], "unknown scenario"),
        (["evaluate", "--agent", "random", "--split", "tset"], "--split"),
        (["evaluate", "--agent", "random", "--episodes", "5000"], "has 1000 test episodes"),
        (["evaluate", "--agent", f"{AGENTS}:Mute"], "has neither act"),
        (["replay", "nowhere"], "summary.json: there is no such file"),
        (["compare", "nowhere", "elsewhere"], "summary.json: there is no such file"),
        (["freeze", "nowhere.toml"], "there is no such file"),
        (["new", "no/such/folder.py"], "cannot write it"),
        (["new", f"{__file__}/agent.py"], "test_cli.py is a file, not a folder"),
        (["new", "my_agent"], "end in .py"),
        (["evaluate", "--agent", "random", "--out", __file__], "--out: cannot write"),
        (["evaluate", "--agent", "random", "--out", __file__], "test_cli.py is a file, not a folder"),
        (["show", "Block8-CPP-v0", "--save", f"{__file__}/map.png"], "test_cli.py is a file, not a folder"),
    ],
)
def test_bad_input_is_one_line_and_exit_status_2(call, words, message):
    code, text = call(*words)
    assert code == 2
    assert message in text
    assert text.count("\n") == 1
    assert not Path("results").exists()


LEARNER = """
from dataclasses import dataclass
@dataclass(frozen=True)
class Config:
    updates: int = 1
    validation: int = 1
CONFIGS = {"tiny": Config()}
class Agent:
    def __init__(self, s, w): pass
    def act(self, o, i): return 4
class Learner:
    updates = samples = 0
    def __init__(self, scenario, config, seed): pass
    def advance(self): self.updates += 1; return {}
    def weights(self): return {}
    def snapshot(self): return {}
    def resume(self, arrays): pass
"""


@pytest.fixture
def awkward():
    """The path of an agent that a shell would take apart."""
    folder = Path("my agents [1]")
    folder.mkdir()
    return folder / "it's mine.py"


def test_the_command_after_new_can_be_pasted(call, awkward):
    text = call("new", awkward)[1]
    assert shlex.split(text.split("next:")[1]) == ["uavbench", "check", str(awkward)]


def test_the_command_after_training_can_be_pasted(call, awkward):
    pytest.importorskip("safetensors", reason="weights need the extra ddqn")
    awkward.write_text(LEARNER)
    text = call("train", awkward, "--config", "tiny", "--scenario", "Block8-CPP-v0", "--out", awkward.parent)[1]
    (kept,) = awkward.parent.glob("Block8-CPP-v0/*.safetensors")
    words = ["uavbench", "evaluate", "--agent", str(awkward), "--weights", str(kept), "--scenario", "Block8-CPP-v0"]
    assert shlex.split(text.split("next:")[1]) == words


def test_paths_are_printed_as_they_are(call):
    folder = Path("[bold]results")
    assert (
        str(folder / "Block8-CPP-v0" / "random")
        in call("evaluate", "--agent", "random", "--scenario", "Block8-CPP-v0", "--episodes", 2, "--out", folder)[1]
    )
    assert str(folder / "Block8-CPP-v0.csv") in call("bound", "Block8-CPP-v0", "--episodes", 0, "--out", folder)[1]


def test_new_does_not_overwrite(call):
    Path("mine.py").write_text("precious")
    code, text = call("new", "mine.py")
    assert code == 2
    assert "exists already" in text
    assert Path("mine.py").read_text() == "precious"


@pytest.mark.parametrize(
    ("name", "message"),
    [("Raises", "RuntimeError: lost my way"), ("WrongShape", "[1, 2]"), ("NotANumber", "nan"), ("OutOfRange", "returned 6")],
)
def test_a_failing_agent_is_exit_status_1_and_its_episodes_are_kept(call, name, message):
    code, text = call("evaluate", "--agent", f"{AGENTS}:{name}", "--scenario", "Block8-DH-v0")
    assert code == 1
    assert f"agents.{name} on Block8-DH-v0, test episode 3, step 3: " in text
    assert message in text
    assert "--resume" in text
    assert Path(f"results/Block8-DH-v0/agents.{name}.partial/records.npz").is_file()
    code, text = call("check", f"{AGENTS}:{name}")
    assert code == 1
    assert text.count("\n") == 1
    assert message in text


@pytest.mark.parametrize(
    ("agent", "scenario", "message"),
    [("tsp", "Block8-CPP-v0", "tsp on Block8-CPP-v0: tsp"), ("boustrophedon", "Block8-DH-v0", "CPP")],
)
def test_what_an_agent_does_not_fly_it_says_itself(call, agent, scenario, message):
    """In a line: there is nothing to trace, and nothing that --resume could go on with."""
    code, text = call("evaluate", "--agent", agent, "--scenario", scenario)
    assert code == 1
    assert message in text
    assert not {"Traceback", "--resume"} & set(text.split())


def test_all_are_all_that_an_agent_flies(call, monkeypatch):
    monkeypatch.setattr("uavbench.evaluation.run.scenario_paths", lambda: ["Block8-CPP-v0", "Block8-DH-v0"])
    code, text = call("evaluate", "--agent", "tsp", "--scenario", "all", "--episodes", 3)
    assert code == 0, text
    assert "Block8-CPP-v0: left out: tsp" in text
    assert [path.name for path in Path("results").iterdir()] == ["Block8-DH-v0"]


def test_a_terminal_without_all_letters_shows_question_marks():
    environment = {**os.environ, "LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    words = [sys.executable, "-m", "uavbench", "list"]
    found = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    assert "32?32" in found.stdout


def test_the_package_is_a_command():
    found = subprocess.run([sys.executable, "-m", "uavbench", "--version"], capture_output=True, text=True, check=True)
    assert found.stdout.startswith("uavbench ")


def test_submissions_are_compared_and_replayed_too(call):
    made = Path(__file__).parents[2] / "leaderboard" / "submissions"
    greedy, random = made / "greedy" / "Block8-CPP-v0", made / "random" / "Block8-CPP-v0"
    code, text = call("compare", greedy, random)
    assert code == 0, text
    assert re.search(r"CRAL.*\+\d\d\.\d.*\[\+", text)
    code, text = call("replay", random)
    assert (code, "all 1000 episodes reproduced" in text) == (0, True), text


def test_a_timeout_is_exit_status_1(call):
    words = ("--agent", f"{AGENTS}:Slow", "--scenario", "Block8-DH-v0", "--decision-timeout", 1)
    code, text = call("evaluate", *words)
    assert code == 1
    assert "longer than 1 s" in text
    code, text = call("check", f"{AGENTS}:Slow", "--scenario", "Block8-DH-v0", "--decision-timeout", 0.5)
    assert (code, "longer than 0.5 s" in text) == (1, True), text


def test_check_names_the_place_in_the_agents_file(call):
    assert re.search(r'lost my way \(File ".*agents\.py", line \d+, in answer\)', call("check", f"{AGENTS}:Raises")[1])


def test_an_agent_that_exits_is_a_failing_agent(call):
    for command in (("check", f"{AGENTS}:Exits"), ("evaluate", "--agent", f"{AGENTS}:Exits", "--scenario", "Block8-DH-v0")):
        code, text = call(*command)
        assert code == 1
        assert "raised SystemExit" in text


def test_a_better_result_is_not_overwritten_unasked(call):
    words = ("evaluate", "--agent", "random", "--scenario", "Block8-CPP-v0", "--episodes")
    assert call(*words, 20)[0] == 0
    for fewer in ((10,), (30, "--split", "validation")):
        code, text = call(*words, *fewer)
        assert code == 2
        assert "holds a result of 20 test episodes: give another --out, or --overwrite" in text
    assert call(*words, 10, "--overwrite")[0] == 0
    assert call(*words, 30)[0] == 0


def test_check_finds_an_agent_that_remembers(call):
    code, text = call("check", f"{AGENTS}:Remembers")
    assert code == 1
    assert 'take randomness from info["seed"]' in text


def test_without_a_terminal_long_commands_print_plain_lines(call, monkeypatch):
    words = ("evaluate", "--agent", "random", "--scenario", "Block8-CPP-v0", "--episodes", 20, "--overwrite")
    assert "so far" not in call(*words)[1]  # it does not take half a minute
    monkeypatch.setattr("uavbench.cli.progress._LINE_SECONDS", 0.0)
    code, text = call(*words)
    assert code == 0, text
    assert re.search(r"^random on Block8-CPP-v0: 20 of 20, CRAL \d+\.\d %, 0:00:\d\d so far", text, re.MULTILINE)


def test_a_scenario_that_fails_does_not_keep_the_others_from_being_flown(call, tmp_path):
    agent = tmp_path / "half.py"
    agent.write_text(
        "class Agent:\n    def __init__(self, s): self.kind = s.mission.kind\n"
        "    def act(self, o, i): return 4 if self.kind == 'harvesting' else 9\n"
    )
    scenarios = [word for name in ("Block8-CPP-v0", "Block8-DH-v0") for word in ("--scenario", name)]
    code, text = call("evaluate", "--agent", agent, "--episodes", 5, *scenarios)
    assert code == 1
    assert "half on Block8-CPP-v0, test episode 0, step 0: act() returned 9" in text
    assert Path("results/Block8-DH-v0/half/summary.json").is_file()


def test_results_can_be_filed_under_another_name(call):
    words = ("evaluate", "--agent", "random", "--scenario", "Block8-CPP-v0", "--episodes", 3, "--name")
    code, text = call(*words, "by chance")
    assert code == 0, text
    assert Path("results/Block8-CPP-v0/by chance/summary.json").is_file()
    code, text = call(*words, "../elsewhere")
    assert (code, "--name: '../elsewhere': holds characters that names of files cannot have" in text) == (2, True), text


def test_freezes_a_users_own_scenario(call, tmp_path):
    shipped = uavbench.load_scenario("Block8-CPP-v0").path
    text = shipped.read_text().split("[splits")[0].replace("Block8-CPP-v0", "Mine-v0")
    text = text.replace("maps/Block8.txt", str(shipped.parent / "maps" / "Block8.txt"))
    path = tmp_path / "mine.toml"
    path.write_text(text)
    before = uavbench.load_scenario(path)
    code, lines = call("freeze", path)
    assert code == 0
    path.write_text(text + lines)
    after = uavbench.load_scenario(path)
    assert after.splits.test.sha256 is not None
    assert after.digest != before.digest
    from uavbench.world.episode import frozen_columns

    assert frozen_columns(after, "test") is not None


def test_freezing_writes_both_files_or_none(call, tmp_path):
    shipped = uavbench.load_scenario("Block8-CPP-v0").path
    text = shipped.read_text().split("[splits")[0].replace("Block8-CPP-v0", "Mine-v0")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("maps/Block8.txt", str(shipped.parent / "maps" / "Block8.txt")))
    (tmp_path / "episodes" / "Mine-v0-test.npz").mkdir(parents=True)
    code, told = call("freeze", path)
    assert (code, "Mine-v0-test.npz: cannot write it" in told) == (2, True), told
    assert [each.name for each in (tmp_path / "episodes").iterdir()] == ["Mine-v0-test.npz"]


def test_check_needs_no_more_episodes_than_there_are(call, tmp_path):
    shipped = uavbench.load_scenario("Block8-CPP-v0").path
    text = shipped.read_text().split("[splits")[0].replace("maps/Block8.txt", str(shipped.parent / "maps" / "Block8.txt"))
    path = tmp_path / "mine.toml"
    path.write_text(f"{text.replace('Block8-CPP-v0', 'Mine-v0')}\n[splits.validation]\nepisodes = 3\n")
    code, told = call("check", "random", "--scenario", path)
    assert code == 0, told


@pytest.mark.parametrize("words", [("check", "random"), ("evaluate", "--agent", "random")])
@pytest.mark.parametrize("seconds", ["0", "-1", "nan"])
def test_no_time_at_all_is_refused(call, words, seconds):
    code, told = call(*words, "--decision-timeout", seconds)
    assert (code, "'--decision-timeout'" in told) == (2, True), told
    assert not Path("results").exists()


def test_any_time_may_be_allowed(call, tmp_path):
    words = ("--agent", "random", "--scenario", "Block8-CPP-v0", "--episodes", 2, "--out", tmp_path)
    code, told = call("evaluate", *words, "--decision-timeout", "inf")
    assert code == 0, told


def test_help_and_import_leave_the_heavy_libraries_alone():
    code = (
        "import sys, uavbench, uavbench.cli.app\n"
        "print([m for m in ('numba', 'pandas', 'matplotlib', 'torch') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.parametrize("words", [("list",), ("show", "Block8-CPP-v0")])
def test_scenarios_are_shown_without_waiting_for_a_compiler(words):
    program = (
        "import sys\nfrom uavbench.cli.app import app\n"
        f"try:\n    app({list(words)!r})\nexcept SystemExit:\n    pass\n"
        "print('imported:', *({'numba', 'joblib', 'torch', 'matplotlib', 'pandas', 'scipy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "Block8-CPP-v0" in done.stdout
    assert done.stdout.splitlines()[-1].strip() == "imported:"
