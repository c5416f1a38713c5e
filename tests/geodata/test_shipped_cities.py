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


def test_there_are_three_districts_with_both_missions():
    assert [f"{name}-{mission}-v0" for name in ("Helsinki32", "Helsinki50", "Kotka50") for mission in ("CPP", "DH")] == IDS


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
    fields = ("budget", "uavs", "rewards", "observation", "mission")
    if district == "Helsinki32":  # so that agents that were trained in Cities32 can be flown
        made, fields = uavbench.load_scenario(f"Cities32-{mission}-v0"), fields[:-1]
        height = {} if mission == "CPP" else {"altitude": 25.0}
        assert made.mission.model_copy(update=height) == shipped.mission
    assert [getattr(made, field) for field in fields] == [getattr(shipped, field) for field in fields]


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
