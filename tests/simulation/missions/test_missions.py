"""A user's own mission: docs/missions.md followed to the letter, and what goes wrong on the way."""

import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from commands import uavbench_command
from worlds import COVERAGE, SURVEILLANCE, scenario

from uavbench import ScenarioError, list_scenarios, load_scenario, parallel_env
from uavbench.agents.agent import find_agent
from uavbench.envs.env import UAVEnv
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.evaluation.results import load_result
from uavbench.evaluation.run import run
from uavbench.pictures.plot import legend
from uavbench.pictures.report import _amounts, _compare
from uavbench.pictures.watch import recorded_scenes
from uavbench.simulation.observation import Observer
from uavbench.simulation.simulator import Simulator
from uavbench.simulation.state_view import StateView
from uavbench.world.parameters import Coverage, Harvesting, MissionParameters
from uavbench.world.registry import MissionError, register_mission

TESTS = Path(__file__).parents[2]
DOCS = (TESTS.parent / "docs" / "missions.md").read_text(encoding="utf-8")


def block(language):
    """Return the one code block of the documentation in a language."""
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", DOCS, re.MULTILINE | re.DOTALL)
    return found


@pytest.fixture
def patrol(tmp_path, monkeypatch):
    """The documentation's scenario, in the current folder."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(TESTS / "helpers" / "surveillance.py", tmp_path)
    (tmp_path / "harbour.txt").write_text(block("text"))
    path = tmp_path / "patrol.toml"
    path.write_text(block("toml"), encoding="utf-8")
    return path


def edit(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_the_documentation_followed_to_the_letter(patrol):
    assert "```{literalinclude} ../tests/helpers/surveillance.py\n" in DOCS
    for line in block("sh").splitlines():
        found = uavbench_command(*shlex.split(line)[1:])
        assert found.exit_code == 0, (line, found.output)
    for name in ("flight.png", "flight.gif", "report/comparison.md", "episodes/Patrol-v0-test.npz"):
        assert Path(name).stat().st_size > 100
    with patrol.open("a", encoding="utf-8") as file:
        file.write("\n" + uavbench_command("freeze", patrol).stdout)
    frozen = load_scenario(patrol)
    assert frozen.splits.test.file
    run(Job(find_agent("random"), frozen, "test"), 30, Path("frozen"))
    records = [load_result(Path(out, "Patrol-v0", "random")).episodes() for out in ("results", "frozen")]
    assert records[0].equals(records[1])


def test_two_workers_fly_what_one_does(patrol):
    job = Job(find_agent("random"), load_scenario(patrol), "test")
    one, two = (sorted(evaluate(job, range(30), workers), key=lambda record: record.episode) for workers in (1, 2))
    assert [replace(r, seconds=0.0, actions=r.actions.tobytes()) for r in one] == [
        replace(r, seconds=0.0, actions=r.actions.tobytes()) for r in two
    ]


@pytest.mark.slow
def test_it_is_trained_and_what_was_trained_flies(patrol):
    import learning  # which skips the test without PyTorch

    from uavbench.learning.train import train

    mine = load_scenario(patrol)
    config = replace(learning.TINY, updates=6, validation=3)
    whole = train(learning.training(config, mine), Path("whole"))
    training = learning.training(config, mine)
    train(training, Path("parts"), seconds=0.0)
    parts = train(training, Path("parts"), resume=True)
    assert learning.weights_of(whole) == learning.weights_of(parts)
    assert uavbench_command("evaluate", "--agent", whole, "--scenario", patrol, "--episodes", 3).exit_code == 0


@pytest.mark.parametrize("words", [("evaluate", "--agent"), ("export",)])
def test_weights_run_no_code_of_the_scenario_that_they_name(patrol, words):
    pytest.importorskip("safetensors")
    from uavbench.agents.weights import save_weights

    edit(Path("surveillance.py"), '"""Surv', 'open("ran", "w").close()\n"""Surv')
    record = {"agent": "ddqn", "scenario": "Patrol-v0", "scenario_file": str(patrol)}
    save_weights(Path("strange.safetensors"), {"x": np.zeros(3)}, record)
    found = uavbench_command(*words, "strange.safetensors", *(["model.onnx"] if words == ("export",) else []))
    assert found.exit_code == 2
    assert f"mission.file: it is code, and runs only if you name the scenario yourself: --scenario {patrol}" in found.stderr
    assert not Path("ran").exists()


@pytest.mark.parametrize("agent", ["planner", "greedy", "orienteering", "tsp", "boustrophedon", "belief_planner"])
def test_agents_for_other_missions_decline_in_one_line(patrol, agent):
    found = uavbench_command("evaluate", "--agent", agent, "--scenario", patrol, "--episodes", 2)
    assert found.exit_code == 1
    (line,) = [line for line in found.stderr.splitlines() if line.startswith("uavbench: ")]
    assert "Patrol-v0" in line
    assert "Traceback" not in found.output + found.stderr


def test_bounds_decline_in_one_line(patrol):
    found = uavbench_command("bound", patrol, "--episodes", 1)
    assert found.exit_code == 2
    assert found.stderr == ("uavbench: Patrol-v0: mission.kind: bounds are for coverage and harvesting, not surveillance\n")


def test_after_resuming_it_pays_what_it_would_have_paid(patrol):
    """It paid for sites that had been seen a moment ago: their cooldowns were lost."""
    mine = load_scenario(patrol)
    first, second = Simulator(mine, 4), Simulator(mine, 4)
    first.reset(range(4), "test", range(4))
    actions = np.random.default_rng(0).integers(0, 5, (19, 4))
    for each in actions[:9]:
        first.step(each)
    second.resume(first.snapshot())
    for each in actions[9:]:
        first.step(each)
        second.step(each)
        assert np.array_equal(first.state.reward, second.state.reward)
        assert np.array_equal(first.mission.wait, second.mission.wait)
    assert (first.mission.wait > 0).any()


def test_a_site_pays_again_after_the_cooldown(patrol):
    env = UAVEnv(patrol)
    sites = np.zeros((8, 8), dtype=bool)
    sites[0, 0] = sites[7, 7] = True
    env.reset(options={"start": [1, 1], "budget": 40, "sites": sites})
    observations, rewards = zip(*(env.step(4)[:2] for _ in range(12)), strict=True)
    assert rewards == pytest.approx([0.8] + 9 * [-0.2] + [0.8] + [-0.2])
    assert [obs["local"][3, 3, 3] for obs in observations] == 12 * [0.0]
    assert env.simulator.outcomes([0])["cr"] == [0.5]
    assert StateView(env.simulator, 0).wait[0, 0] == 9
    with pytest.raises(AttributeError, match="Patrol-v0 has no device_cell: its mission is surveillance"):
        _ = StateView(env.simulator, 0).device_cell


@pytest.mark.parametrize("uavs", [None, (2, 2)])
@pytest.mark.parametrize("scale", [1, 3])
def test_its_own_layer_is_observed_as_the_target_map_is(uavs, scale):
    rows = ("LL.....", ".......", "..#....", ".......", "....N..", ".......")
    mine = scenario(rows, SURVEILLANCE, uavs=uavs).with_observation(5, scale)
    simulator, observer, most = Simulator(mine, 3), Observer(mine), mine.max_uavs
    simulator.reset(range(3), "train", range(3))
    for each in np.random.default_rng(0).integers(0, 5, (9, 3, 2)):
        simulator.step(each if mine.team else each[:, 0])
    assert observer.layers[-1] == "wait"
    state, batch = simulator.state, observer.empty(3 * most)
    observer.write(state, np.arange(3 * most), batch)
    assert np.array_equal(state.layers[:, 0], np.maximum(simulator.mission.wait, 0))
    for n in range(3 * most):
        (r, c), layer = state.position[n // most, n % most], state.layers[n // most, 0]
        centred = np.zeros((11, 13))
        centred[5 - r : 11 - r, 6 - c : 13 - c] = layer
        assert np.array_equal(batch["local"][n, -1], centred[3:8, 4:9])
        high, wide = 11 // scale, 13 // scale
        means = centred[: high * scale, : wide * scale].reshape(high, scale, wide, scale).mean(axis=(1, 3))
        assert np.allclose(batch["global"][n, -1], means)
        for name in ("local", "global"):
            assert np.array_equal(batch[name][n, 3] > 0, _where(state.target[n // most], r, c, name, scale))
    assert state.layers.any()


def _where(target, r, c, name, scale):
    """Return which cells of a map show a target."""
    centred = np.zeros((11, 13), dtype=bool)
    centred[5 - r : 11 - r, 6 - c : 13 - c] = target > 0
    if name == "local":
        return centred[3:8, 4:9]
    high, wide = 11 // scale, 13 // scale
    return centred[: high * scale, : wide * scale].reshape(high, scale, wide, scale).any(axis=(1, 3))


def test_environments_show_its_own_layer():
    rows = ("LL......", "........", "..##....", "..##....", "......N.", "........")
    env, team = UAVEnv(scenario(rows, SURVEILLANCE)), parallel_env(scenario(rows, SURVEILLANCE, uavs=(2, 2)))
    observation = env.reset(seed=0)[0]
    assert observation["local"].shape == (5, 5, 5)
    team.reset(seed=0)
    for action in (1, 1, 2, 1, 2, 4):
        observation = env.step(action)[0]
        assert env.observation_space.contains(observation)
        observations = team.step(dict.fromkeys(team.agents, action))[0]
        assert team.observation_space("uav_0").contains(observations["uav_0"])
        assert observations["uav_0"]["local"].shape == (7, 5, 5)
        assert team.state_space.contains(team.state())
        assert np.array_equal(team.state()[6], team.simulator.state.layers[0, 0])
    assert team.state()[6].max() <= 4 == env.observation_space["local"].high[4].max()


def test_pictures_say_what_the_mission_says(patrol):
    mine = load_scenario(patrol)
    result = run(Job(find_agent("random"), mine, "test"), 20, Path("out"))
    labels = [entry.get_label() for entry in legend(recorded_scenes(result, 0, str(patrol))[-1])]
    assert {"site that pays", "site that was seen", "movement"} < set(labels)
    assert not [label for label in labels if "device" in label or "cover" in label]
    amounts = _amounts(_compare([result], str(patrol), {}))
    assert set(amounts) <= {5, 6, 7, 8}


def test_the_missions_file_is_part_of_the_digest(patrol):
    digest = load_scenario(patrol).digest
    path = Path("surveillance.py")
    text = path.read_bytes()
    path.write_bytes(text.replace(b"\n", b"\r\n"))
    assert load_scenario(patrol).digest == digest
    path.write_bytes(text.replace(b"= 1.0", b"= 2.0"))
    edited = load_scenario(patrol)
    assert edited.digest != digest
    assert (edited.mission.largest_target, edited.mission.kind) == (2.0, "surveillance")
    elsewhere = Path("elsewhere")
    elsewhere.mkdir()
    for name in ("surveillance.py", "harbour.txt", "patrol.toml"):
        shutil.move(name, elsewhere)
    assert load_scenario(elsewhere / "patrol.toml").digest == edited.digest


def test_a_result_runs_no_code(patrol):
    result = run(Job(find_agent("random"), load_scenario(patrol), "test"), 5, Path("out"))
    edit(Path("surveillance.py"), '"""Surv', 'open("ran", "w").close()\n"""Surv')
    found = uavbench_command("replay", result.folder)
    assert found.exit_code == 2
    assert f"mission.file: it is code, and runs only if you name the scenario yourself: --scenario {patrol}" in found.stderr
    assert not Path("ran").exists()
    assert uavbench_command("replay", result.folder, "--scenario", patrol).exit_code == 2
    assert Path("ran").exists()


LITERAL = 'kind: Literal["surveillance"]'


@pytest.mark.parametrize(
    ("name", "old", "new", "reason"),
    [
        ("patrol.toml", 'kind = "surveillance"', 'kind = "racing"', "mission.kind: 'racing' is not 'surveillance', which surv"),
        ("patrol.toml", 'kind = "surveillance"\n', "", "mission.kind: is missing"),
        ("patrol.toml", "surveillance.py", "none.py", "mission.file: .*none.py: there is no such file$"),
        ("patrol.toml", '"surveillance.py"', '"."', "mission.file: .*it is a folder|is not a plain file"),
        ("patrol.toml", '"surveillance.py"', '"surveillance.py"\nsha256 = "00"', "mission.file: .* has the SHA-256 .* not 00"),
        ("patrol.toml", "cooldown = 10", "cooldown = 0", "mission.cooldown: Input should be greater than"),
        ("patrol.toml", "cooldown = 10", "cooldwon = 10", "mission.cooldwon: unknown key"),
        ("patrol.toml", "sites = [5, 8]", "sites = [5, 800]", "mission.sites: up to 800 sites, and the map has"),
        ("surveillance.py", '"""Surv', 'raise OSError("no")\n"""Surv', "mission.file: importing .* raised OSError: no$"),
        ("surveillance.py", "def make(", "def mkae(", "mission.file: .* Surveillance: it does not define make$"),
        ("surveillance.py", LITERAL, "kind: str", "mission.file: .* its kind must be a Literal of one text"),
        ("surveillance.py", LITERAL, 'kind: Literal["coverage"]', "mission.file: .* the kind 'coverage' is taken: choose"),
        ("surveillance.py", "class Surveillance(MissionParameters)", "class Surveillance", "defines no subclass of Mission"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(patrol, name, old, new, reason):
    edit(Path(name), old, new)
    with pytest.raises(ScenarioError, match=reason) as raised:
        load_scenario(patrol)
    assert str(raised.value).startswith(f"{patrol}: ")
    assert "\n" not in str(raised.value)


def test_a_file_that_was_edited_since_is_not_flown_by_workers(patrol):
    mine = load_scenario(patrol)
    again, arguments = mine.mission.__reduce_ex__(2)
    assert again(*arguments) == mine.mission
    edit(Path("surveillance.py"), '"""Surv', '"""surv')
    with pytest.raises(ValueError, match="it is another file, or was edited since"):
        again(*arguments)


def test_a_mission_is_registered_once_and_whole():
    class Whole(Coverage):
        kind: Literal["test-whole"]

    class Again(Harvesting):
        kind: Literal["test-whole"]

    class Half(MissionParameters):
        kind: Literal["test-half"]

    register_mission(Whole)
    register_mission(Whole)
    assert scenario(["LL..", "....", "....", "...."], {**COVERAGE, "kind": "test-whole"}).mission.kind == "test-whole"
    with pytest.raises(MissionError, match="Again: the kind 'test-whole' is taken by"):
        register_mission(Again)
    with pytest.raises(MissionError, match="Half: it does not define exact, largest_target, make, targets"):
        register_mission(Half)


def test_scenarios_are_read_without_a_compiler():
    code = "import sys, uavbench; [uavbench.load_scenario(name) for name in uavbench.list_scenarios()]; assert 'numba' not in "
    subprocess.run([sys.executable, "-c", code + "sys.modules"], check=True)


def test_only_those_who_are_made_for_a_mission_ask_for_its_kind():
    """What is for all missions knows none of them."""
    package = TESTS.parent / "uavbench"
    own = {package / "simulation" / "missions", package / "planning", package / "bounds"}
    for path in package.rglob("*.py"):
        if not own & set(path.parents):
            assert not re.search(r"mission\.kind [!=]=|isinstance\([^)]*(Coverage|Harvesting)", path.read_text()), path


def test_shipped_scenarios_name_no_files():
    assert all(load_scenario(name).mission.file is None for name in list_scenarios())
