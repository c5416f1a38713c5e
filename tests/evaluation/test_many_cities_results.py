"""Results in many cities, from a user's own scenario to its report: frozen cities, clusters, and what is damaged."""

import json
import tomllib

import numpy as np
import pytest
from commands import uavbench_command

import uavbench
from uavbench.evaluation.cities import spread_over_cities
from uavbench.evaluation.metrics import mean_interval
from uavbench.simulation.freeze import freeze
from uavbench.world.maps import read_map
from uavbench.world.scenario import ScenarioError
from uavbench.world.shown_map import shown_city

EPISODES = 60
TOWNS = """id = "Towns-CPP-v0"
title = "Coverage of small towns"
budget = [10, 30]

[rewards]
movement = -0.2
safety = -1.0
crash = -150.0
collect = 0.4

[observation]
local_size = 5
global_scale = 3

[mission]
kind = "coverage"
camera_size = 3
shapes = [1, 3]
target_fraction = [0.1, 0.9]

[cities]
generator = "mixed-v0"
shape = [12, 10]
validation = 3
test = 6
reach = 15

[splits.validation]
episodes = 6

[splits.test]
episodes = 60
"""


@pytest.fixture(scope="module")
def towns(tmp_path_factory):
    """A user's own scenario in six test cities, frozen."""
    path = tmp_path_factory.mktemp("towns") / "towns.toml"
    path.write_text(TOWNS)
    frozen = uavbench_command("freeze", path)
    assert frozen.exit_code == 0, frozen.output
    lines = [line for line in frozen.output.splitlines() if not line.startswith("#")]
    path.write_text(TOWNS.split("[splits")[0] + "\n".join(lines))
    return path


@pytest.fixture(scope="module")
def flown(towns):
    """Results of two agents, by name."""
    out = towns.parent / "results"
    return {agent: uavbench.evaluate(agent, towns, out=out) for agent in ("greedy", "random")}


def test_freezing_keeps_the_cities_and_the_episodes(towns):
    scenario = uavbench.load_scenario(towns)
    named = tomllib.loads(towns.read_text())["cities"]["frozen"]
    with np.load(towns.parent / named["file"]) as cities:
        assert {name: cities[name].shape for name in cities} == {"validation": (3, 12, 10), "test": (6, 12, 10)}
        assert np.array_equal(cities["test"][4], shown_city(scenario, "test", 4))
    env = uavbench.make(scenario, split="test", order="cycle")
    for number in range(8):
        env.reset()
        assert np.array_equal(env.unwrapped.simulator.city_at(0).cells, shown_city(scenario, "test", number % 6))


def test_a_second_scenario_in_the_same_cities_keeps_their_file(towns, tmp_path):
    (tmp_path / "cities").mkdir()
    text = towns.read_text().split("[splits")[0]
    name = tomllib.loads(text)["cities"]["frozen"]["file"]
    (tmp_path / name).write_bytes((towns.parent / name).read_bytes())
    (tmp_path / "again.toml").write_text(text.replace("Towns-CPP-v0", "Again-CPP-v0", 1))
    frozen = uavbench_command("freeze", tmp_path / "again.toml")
    assert frozen.exit_code == 0, frozen.output
    assert "cities" not in frozen.output.replace(str(tmp_path), "")
    assert [path.name for path in (tmp_path / "cities").iterdir()] == [name.removeprefix("cities/")]


@pytest.mark.parametrize(
    ("old", "new"), [('generator = "mixed-v0"', 'generator = "blocks-v0"'), ("reach = 15", "reach = 15\nlanding_cells = 9")]
)
def test_frozen_cities_of_another_generator_are_refused_until_drawn_anew(towns, tmp_path, old, new):
    text = towns.read_text()
    name = tomllib.loads(text)["cities"]["frozen"]["file"]
    (tmp_path / "cities").mkdir()
    (tmp_path / name).write_bytes((towns.parent / name).read_bytes())
    changed = tmp_path / "towns.toml"
    changed.write_text(text.split("[splits")[0])
    shown_city(uavbench.load_scenario(changed), "test", 0)
    assert old in text
    changed.write_text(text.split("[splits")[0].replace(old, new, 1).replace("Towns-CPP-v0", "Other-CPP-v0", 1))
    for act in (
        lambda: shown_city(uavbench.load_scenario(changed), "test", 0),
        lambda: freeze(uavbench.load_scenario(changed)),
    ):
        with pytest.raises(
            ScenarioError, match=r"cities\.frozen\.file: .*choose a new id, remove \[cities\.frozen\]"
        ) as caught:
            act()
        assert "\n" not in str(caught.value)
    changed.write_text(TOWNS.split("[splits")[0].replace(old, new, 1).replace("Towns-CPP-v0", "Other-CPP-v0", 1))
    changed.write_text(changed.read_text() + freeze(uavbench.load_scenario(changed)))
    shown_city(uavbench.load_scenario(changed), "test", 0)


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda path: path.unlink(), "there is no such file"),
        (lambda path: path.write_bytes(path.read_bytes() + b"x"), "it is not the frozen file"),
    ],
)
def test_a_damaged_file_of_cities_is_one_line(towns, tmp_path, damage, expected):
    text = towns.read_text()
    name = tomllib.loads(text)["cities"]["frozen"]["file"]
    (tmp_path / "cities").mkdir()
    (tmp_path / name).write_bytes((towns.parent / name).read_bytes())
    (tmp_path / "towns.toml").write_text(text.split("[splits")[0])
    damage(tmp_path / name)
    scenario = uavbench.load_scenario(tmp_path / "towns.toml")
    with pytest.raises(ScenarioError, match=expected) as caught:
        shown_city(scenario, "test", 0)
    assert "cities.frozen" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_intervals_and_the_spread_take_the_cities_into_account(flown):
    summary, cral = flown["greedy"].summary, flown["greedy"].episodes()["cral"].to_numpy()
    cities = np.arange(EPISODES) % 6
    clustered = mean_interval(cral, clusters=cities)
    assert summary["metrics"]["cral"] == {"mean": clustered.mean, "low": clustered.low, "high": clustered.high}
    assert clustered.high != mean_interval(cral).high
    spread = spread_over_cities(cral, cities)
    assert (summary["cral_over_cities"]["cities"], summary["cral_over_cities"]["deviation"]) == (6, spread.deviation)
    assert uavbench.replay(flown["greedy"]) == []
    difference = cral - flown["random"].episodes()["cral"].to_numpy()
    compared = uavbench.compare(flown["greedy"], flown["random"])["cral"].difference
    assert compared == mean_interval(difference, clusters=cities)


def test_a_replay_checks_the_spread(flown, tmp_path):
    folder = tmp_path / "result"
    folder.mkdir()
    for path in flown["random"].folder.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    summary = json.loads((folder / "summary.json").read_text())
    summary["cral_over_cities"]["ninetieth"] = 0.9
    (folder / "summary.json").write_text(json.dumps(summary))
    (wrong,) = uavbench.replay(uavbench.load_result(folder))
    assert wrong.startswith("summary.json: cral_over_cities.ninetieth is ")
    summary["cral_over_cities"] = [1, 2]
    (folder / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(uavbench.UavbenchError, match="not a summary that uavbench evaluate wrote"):
        uavbench.load_result(folder)


def test_a_report_shows_scores_against_properties_of_the_cities(flown, tmp_path):
    told = uavbench_command("report", *(result.folder for result in flown.values()), "--out", tmp_path / "r")
    assert told.exit_code == 0, told.output
    names = {path.name for path in (tmp_path / "r").iterdir()}
    assert {"cral_against_building_share.png", "cral_against_landing_distance.pdf"} <= names
    assert all(name in told.output for name in names)


def test_a_city_is_shown_and_saved_as_a_map(towns, tmp_path):
    path = tmp_path / "city.png"
    told = uavbench_command("show", towns, "--city", 5, "--save", path)
    assert told.exit_code == 0, told.output
    rows = read_map(path)
    assert rows[0] in told.output
    assert uavbench.Scenario.from_array(rows).shape == (12, 10)
    for options, expected in (
        (("--city", 6), "city: 6 is out of range; Towns-CPP-v0 has test cities 0 to 5"),
        (("--split", "tests"), "split: 'tests' is not one of train, validation, test"),
        (("--save", tmp_path / "city.txt"), "choose a name that ends in .png"),
    ):
        told = uavbench_command("show", towns, *options)
        assert told.exit_code == 2
        assert expected in told.output
