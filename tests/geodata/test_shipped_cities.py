"""The shipped maps of real districts are what the import makes today of the files that their scenarios name."""

import hashlib
import re
import shlex

import pytest
from commands import uavbench_command
from places import extract

import uavbench
from uavbench.world.resources import scenario_paths

IDS = [name for name in uavbench.list_scenarios() if uavbench.load_scenario(name).provenance]
NOTICE = (scenario_paths()["Block8-CPP-v0"].parent / "maps" / "NOTICE-OpenStreetMap.md").read_text(encoding="utf-8")


def parameters(scenario):
    """Return what a scenario says besides its name and its map: the values by their names, with a dot after each table's."""
    tables = {name: getattr(scenario, name).model_dump() for name in ("rewards", "observation", "mission")}
    inside = {f"{table}.{name}": value for table, values in tables.items() for name, value in values.items()}
    return {"budget": scenario.budget, "uavs": scenario.uavs, **inside}


def as_toml(value):
    """Return a number or a pair of numbers as the scenarios' files have it."""
    return str(list(value)) if isinstance(value, tuple) else str(value)


def test_there_are_three_districts_with_both_missions():
    districts = ("Helsinki32", "Helsinki50", "Kotka50")
    assert [f"{name}-{mission}-v0" for name in districts for mission in ("CPP", "DH")] == IDS
    assert re.findall(r"--out (\w+)-CPP-v0.toml$", NOTICE, re.MULTILINE) == list(districts)
    assert "makes all three maps again" in NOTICE


@pytest.mark.parametrize("name", IDS)
def test_the_import_makes_it_today(name, tmp_path):
    for library in ("osmium", "shapely", "pyproj"):
        pytest.importorskip(library, reason="importing cities needs pip install 'uavbench[cities]'")
    shipped = uavbench.load_scenario(name)
    district, mission, _ = name.split("-")
    (command,) = re.findall(rf"^uavbench (import .*) --out {district}-CPP-v0.toml$", NOTICE, re.MULTILINE)
    words = shlex.split(command)
    words[1] = str(extract(words[1]))
    out = tmp_path / "again.toml"
    done = uavbench_command(*words, "--mission", mission.lower(), "--out", out)
    assert done.exit_code == 0, done.output
    made = uavbench.load_scenario(out)
    assert made.rows == shipped.rows
    assert made.provenance == shipped.provenance
    before, after = parameters(made), parameters(shipped)
    by_hand = {(f"`{key}`", as_toml(before[key]), as_toml(after[key])) for key in after if before[key] != after[key]}
    assert set(re.findall(rf"^\| `{name}` \| (.*?) \| (.*?) \| (.*?) \|$", NOTICE, re.MULTILINE)) == by_hand
    if district == "Helsinki32":  # so that agents that were trained in Cities32 can be flown
        height = {} if mission == "CPP" else {"mission.altitude": 25.0}
        assert parameters(uavbench.load_scenario(f"Cities32-{mission}-v0")) | height == after


@pytest.mark.parametrize("name", IDS)
def test_the_notice_and_the_scenario_name_the_same_file(name):
    origin = uavbench.load_scenario(name).provenance
    assert origin.sha256 == hashlib.sha256(extract(origin.source).read_bytes()).hexdigest()
    assert f"| `{origin.source}` | `{origin.sha256}` |" in NOTICE
    assert origin.licence == "© OpenStreetMap contributors, ODbL 1.0"
    assert origin.licence in NOTICE


def test_helsinki_is_a_city():
    cells = "".join(uavbench.load_scenario("Helsinki50-CPP-v0").rows)
    assert 0.25 <= (cells.count("#") + cells.count("b")) / len(cells) <= 0.5
    assert cells.count("L") == 18
