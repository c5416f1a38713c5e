"""The pages of the documentation say what the code does, where they give its names and numbers."""

import itertools
import math
import re
import tomllib
from pathlib import Path

import pytest
from record import EPISODES, EPISODES_OF_LARGE_MAPS

from uavbench import list_scenarios, load_scenario
from uavbench.bounds.coverage import coverage_bound
from uavbench.bounds.harvesting import harvesting_bound
from uavbench.leaderboard import page
from uavbench.leaderboard.published import PAPER_SCENARIOS
from uavbench.pictures import report
from uavbench.planning.coverage import search
from uavbench.planning.rates import expected_rates
from uavbench.simulation.missions.coverage import camera_gain, camera_views
from uavbench.simulation.simulator import Simulator
from uavbench.simulation.state_view import StateView
from uavbench.world.cells import CELL_NAMES, CHARACTERS
from uavbench.world.city_source import Cities
from uavbench.world.generators import draw_cities
from uavbench.world.generators.parameters import CityParameters
from uavbench.world.resources import shipped_weights

ROOT = Path(__file__).parents[1]
# The first rows of tables.
SCENARIOS = "| scenarios | cells | cities | validation episodes | test episodes |"
TARGETS = "| scenarios | shapes (CPP) | cells that they cover (CPP) | devices (DH) |"


def text_of(name):
    """Return a page as one line, so that a test need not know where its lines end."""
    return " ".join((ROOT / name).read_text(encoding="utf-8").split())


@pytest.mark.parametrize("name", ["README.md", "docs/gallery.md", "docs/leaderboard.md", "leaderboard/README.md"])
def test_it_says_on_which_maps_flights_can_be_watched(name):
    side = math.isqrt(page._LARGEST)
    assert re.search(rf"maps of (up to|more than) {side}×{side} cells", text_of(name))


def test_the_leaderboards_rules_say_how_many_flights_the_page_has():
    text = text_of("docs/leaderboard.md")
    *more, fewest = (f"{count:,}" for count in page._ELSEWHERE)
    assert f"the first {', '.join(more)} or {fewest}" in text
    assert f"at most {page._ROOM:,} actions" in text


@pytest.mark.parametrize("name", ["docs/agents.md", "leaderboard/README.md"])
def test_it_names_the_scenarios_for_which_ddqn_has_weights(name):
    (said,) = re.findall(r"`ddqn` (?:is|\| policy \|)[^.|]*weights:? (?:for )?the paper's four, (.*?)(?:\.| \|)", text_of(name))
    assert {*PAPER_SCENARIOS, *re.findall(r"[\w-]+-v0", said)} == shipped_weights("ddqn").keys()


@pytest.mark.parametrize("name", ["Cities32-CPP-v0", "Manhattan32-CPP-v0"])
def test_what_the_page_on_agents_calls_works_in_every_scenario(name):
    (call,) = re.findall(r"`uavbench\.simulation\.missions\.coverage\.(camera_gain\(.*?\))`", text_of("docs/agents.md"))
    scenario = load_scenario(name)
    simulator = Simulator(scenario, 1)
    simulator.reset([0], "test", [3])
    gain = eval(call, {"camera_gain": camera_gain, "scenario": scenario, "state": StateView(simulator, 0)})
    assert gain.shape == scenario.shape
    assert gain.max() > 0
    assert (scenario.rows == ()) == (name == "Cities32-CPP-v0")


def test_pages_say_where_a_city_is_needed():
    agents, bounds = text_of("docs/agents.md"), text_of("docs/bounds.md")
    assert "`rows` (the map; `()` if there are [many cities](scenarios.md))" in agents
    assert "coverage_bound(…, city=city)" in bounds
    assert "harvesting_bound" in bounds


@pytest.mark.parametrize("function", [camera_views, camera_gain, search, expected_rates, coverage_bound, harvesting_bound])
def test_what_may_be_given_a_city_says_when_it_must(function):
    told = " ".join((function.__doc__ or "").split())
    assert "city : City, optional The city; by default the scenario's only one. In a scenario with many cities, give it" in told
    assert "ValueError" in told


def test_the_page_on_pictures_names_every_figure_of_a_report():
    rows = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs/pictures.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert rows == [*report._FIGURES, *report._CITY_FIGURES]


@pytest.mark.parametrize("name", ["docs/recipes.md", "docs/scenarios.md"])
def test_it_says_what_a_map_is_made_of(name):
    text = text_of(name)
    for character, meaning in zip(CHARACTERS, CELL_NAMES, strict=True):
        assert f"`{character}` {meaning}" in text
    assert "numbers 0 to 4" in text
    assert "Scenario.from_array" in text


def table_under(name, head):
    """Return the rows of the table of a page that begins with the row ``head``, as lists of cells."""
    lines = (ROOT / name).read_text(encoding="utf-8").split(f"{head}\n")[1].splitlines()[1:]
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in itertools.takewhile(lambda each: each.startswith("|"), lines)
    ]


def scenarios_of(cell):
    """Return the scenarios on the maps or in the cities that a cell of a table names."""
    names = re.findall(r"`(\w+)`", cell)
    assert names
    return [load_scenario(name) for name in list_scenarios() if name.split("-")[0] in names]


def test_the_table_of_scenarios_has_all_of_them_with_their_numbers():
    told = []
    for maps, cells, cities, validation, test in table_under("docs/scenarios.md", SCENARIOS):
        for scenario in scenarios_of(maps):
            told.append(scenario.id)
            assert "{}×{}".format(*scenario.shape) in cells or scenario.shape[0] in range(64, 513)
            assert [f"{split.episodes:,}" for split in (scenario.splits.validation, scenario.splits.test)] == [validation, test]
            if scenario.cities is not None:
                assert cities == f"generated, {scenario.cities.test} for tests and {scenario.cities.validation} for validation"
            assert not scenario.team or f"`{scenario.id.split('-')[0]}` T" in maps
    assert sorted(told) == list_scenarios()


def test_the_rules_give_the_numbers_of_targets_of_every_scenario():
    told = []
    for maps, shapes, share, devices in table_under("docs/rules.md", TARGETS):
        for scenario in scenarios_of(maps):
            told.append(scenario.id)
            mission = scenario.mission
            if mission.kind == "coverage":
                low, high = mission.target_fraction
                assert ["{} to {}".format(*mission.shapes), f"{100 * low:.0f} to {100 * high:.0f} %"] == [shapes, share]
            else:
                assert "{} to {}".format(*mission.devices) == devices
                assert (mission.data, mission.communication_steps) == ((5.0, 20.0), 4)
    assert sorted(told) == list_scenarios()


def test_the_page_on_environments_says_how_many_episodes_there_are():
    usual, large = (load_scenario(name).splits for name in ("Manhattan32-CPP-v0", "City512-DH-v0"))
    told = f"`validation` ({usual.validation.episodes}; {large.validation.episodes} on `City64` to `City512`) or `test` "
    assert f"{told}({usual.test.episodes:,}; {large.test.episodes} on these)" in text_of("docs/environments.md")


def test_the_page_for_contributors_says_of_how_many_episodes_the_contract_is():
    few = {
        scenario.id.split("-")[0]
        for scenario in map(load_scenario, list_scenarios())
        if scenario.splits.test.episodes < EPISODES
    }
    assert few == {"City64", "City128", "City256", "City512"}
    assert f"of {EPISODES} episodes ({EPISODES_OF_LARGE_MAPS} on `City64` to `City512`)" in text_of("CONTRIBUTING.md")


def test_the_parameters_of_cities_that_the_page_on_scenarios_shows_are_the_defaults():
    blocks = re.findall(
        r"^```toml\n(.*?)^```", (ROOT / "docs/scenarios.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    (cities,) = [tomllib.loads(block)["cities"] for block in blocks if "[cities.parameters]" in block]
    defaults = CityParameters().model_dump(mode="json")
    assert cities["parameters"] == defaults


def test_the_page_on_results_describes_the_spread_over_cities():
    text = (ROOT / "docs/results.md").read_text(encoding="utf-8")
    assert "`cral_over_cities`" in text
    assert re.findall(r"^\| `(\w+)`(?:, `(\w+)`)? \|", text.split("`cral_over_cities`")[-1], re.MULTILINE) == [
        ("cities", ""),
        ("mean", ""),
        ("deviation", ""),
        ("tenth", "ninetieth"),
    ]


def test_the_reach_of_shipped_cities_is_what_the_docstrings_and_the_page_recommend():
    many = [scenario for scenario in map(load_scenario, list_scenarios()) if scenario.cities]
    for scenario in many:
        same = [other for other in many if other.cities == scenario.cities]  # with both missions, and with teams
        assert 2 * scenario.cities.reach == min(other.budget[1] for other in same)
    for told in (draw_cities.__doc__, Cities.__doc__, text_of("docs/scenarios.md")):
        assert re.search("half (of )?the largest budget", " ".join(told.split()), re.IGNORECASE)
