"""Scenarios: loaded by id or path, refused with one clear error, identified by a digest."""

import shutil

import numpy as np
import pytest
from worlds import scenario

from uavbench import ScenarioError, list_scenarios, load_scenario
from uavbench.world.resources import scenario_paths

PAPER = ["Manhattan32-CPP-v0", "Manhattan32-DH-v0", "Urban50-CPP-v0", "Urban50-DH-v0"]
MAP = "....\n.LL.\n..N.\n.#..\n"


@pytest.fixture
def own(tmp_path):
    """A user's own scenario: a copy of Block8-CPP without frozen episodes, on a map of 4×4."""
    text = scenario_paths()["Block8-CPP-v0"].read_text().split("[splits")[0].replace("maps/Block8.txt", "my.txt")
    text = text.replace("Block8-CPP-v0", "Mine-v0").replace("local_size = 9", "local_size = 5")
    (tmp_path / "my.txt").write_text(MAP)
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return path


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_all_ids_load():
    assert set(PAPER) < set(list_scenarios())
    assert {f"{name[:-3]}-Long-v0" for name in PAPER} < set(list_scenarios())
    for name in list_scenarios():
        assert load_scenario(name).id == name == load_scenario(f"uavbench/{name}").id


@pytest.mark.parametrize(
    ("name", "counts", "budget"),
    [
        ("Manhattan32-CPP-v0", (18, 70, 254, 682), (50, 150)),
        ("Manhattan32-DH-v0", (18, 70, 254, 682), (50, 150)),
        ("Urban50-CPP-v0", (40, 60, 636, 1764), (150, 250)),
        ("Urban50-DH-v0", (40, 60, 636, 1764), (100, 200)),
        ("Urban50-DH-Long-v0", (40, 60, 636, 1764), (150, 300)),
        ("Manhattan32-CPP-Team-v0", (18, 70, 254, 682), (50, 150)),
        ("Manhattan32-DH-Team-v0", (18, 70, 254, 682), (50, 150)),
        ("Urban50-CPP-Team-v0", (40, 60, 636, 1764), (150, 250)),
        ("Urban50-DH-Team-v0", (40, 60, 636, 1764), (100, 200)),
    ],
)
def test_the_papers_scenarios_have_the_papers_values(name, counts, budget):
    found = load_scenario(name)
    cells = "".join(found.rows)
    assert tuple(cells.count(kind) for kind in "LN#.") == counts
    assert found.budget == budget
    assert found.uavs == ((1, 3) if "Team" in name else None)
    coverage = found.mission.kind == "coverage"
    assert found.rewards.movement == (-0.1 if name.startswith("Urban50-DH") else -0.2)
    assert (found.rewards.safety, found.rewards.crash) == (-1, -150)
    assert found.rewards.collect == (0.4 if coverage else 1.0)
    assert found.observation.local_size == 17
    assert found.observation.global_scale == (3 if "Manhattan" in name else 5)
    if coverage:
        assert (found.mission.shapes, found.mission.target_fraction) == ((3, 8), (0.2, 0.5))
    else:
        assert (found.mission.devices, found.mission.data) == ((3, 10), (5, 20))
        assert found.mission.edge_snr == (-25 if "Manhattan" in name else -30)


def test_a_users_own_scenario_loads_and_flies(own):
    found = load_scenario(own)
    assert (found.id, found.shape, found.splits.test.episodes) == ("Mine-v0", (4, 4), 1000)
    assert load_scenario(str(own)) == found


@pytest.mark.parametrize(
    ("old", "new", "field", "reason"),
    [
        ("camera_size = 5", "camera_size = 5\ncamra = 1", "mission.camra", "unknown key"),
        ("budget =", "bugdet = [1, 2]\nbudget =", "bugdet", "unknown key"),
        ("budget = [10, 30]", "budget = [30, 10]", "budget", "30 exceeds the upper bound 10"),
        ("budget = [10, 30]", "budget = [0, 10]", "budget.0", "greater than or equal to 1"),
        ("budget = [10, 30]", "", "budget", "is missing"),
        ("budget = [10, 30]", "budget = [true, 30]", "budget.0", "valid integer"),
        ("budget = [10, 30]", "budget = [10, 30.0]", "budget.1", "valid integer"),
        ("budget = [10, 30]", "budget = 30", "budget", "a pair [low, high]"),
        ("title =", "titel =", "titel", "unknown key"),
        ('id = "Mine-v0"', 'id = "Block8-CPP-v0"', "id", "is a shipped scenario and means something else"),
        ("shapes = [1, 3]", "shapes = [3, 1]", "mission.shapes", "3 exceeds the upper bound 1"),
        (
            "target_fraction = [0.2, 0.5]",
            "target_fraction = [0.2, 1.5]",
            "mission.target_fraction.1",
            "less than or equal to 1",
        ),
        ("local_size = 5", "local_size = 4", "observation.local_size", "4 is even"),
        ("local_size = 5", "local_size = 9", "observation.local_size", "9 exceeds 7"),
        ("crash = -150.0", "crash = nan", "rewards.crash", "finite"),
        ('kind = "coverage"', 'kind = "racing"', "mission.kind", "'racing' is not 'coverage' or 'harvesting'"),
        ('id = "Mine-v0"', 'id = "my city"', "id", "as in MyCity-CPP-v0"),
        ('id = "Mine-v0"', 'id = "Mine-v٣"', "id", "as in MyCity-CPP-v0"),
        ('map = "my.txt"', 'map = "no.txt"', "map", "there is no such file"),
        ("camera_size = 5", "camera_size = 4", "mission.camera_size", "1, 3, 5 or 7"),
        ("budget =", "rows = []\nbudget =", "rows", "unknown key"),
        ("[rewards]", "[rewards", "TOML", "is not TOML"),
    ],
)
def test_a_wrong_value_is_one_error_that_names_file_field_and_reason(own, old, new, field, reason):
    edit(own, old, new)
    with pytest.raises(ScenarioError) as caught:
        load_scenario(own)
    message = str(caught.value)
    assert str(own) in message
    assert field in message
    assert reason in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("....\n.LL\n..N.\n.#..\n", "row 1 has 3 cells"),
        ("....\n.LX.\n..N.\n.#..\n", "row 1, column 2: unknown cell 'X'"),
        ("....\n....\n..N.\n.#..\n", "no landing cell"),
        ("L#..\n##..\n..L.\n....\n", "the landing zone at (0, 0) is unreachable"),
        ("LN..\nNN..\n..L.\n....\n", "unreachable"),
        ("....\n.##.\n#LL#\n.##.\n", "unreachable: no free cell leads to it"),
        ("..#L\n...#\nL...\n....\n", "unreachable"),
        (".L.\n...\n...\n...\n", "4 to 1024"),
        ("", "4 to 1024"),
    ],
)
def test_a_wrong_map_is_one_error_that_names_its_file(own, text, reason):
    (own.parent / "my.txt").write_text(text)
    with pytest.raises(ScenarioError) as caught:
        load_scenario(own)
    assert str(own.parent / "my.txt") in str(caught.value)
    assert reason in str(caught.value)


def test_too_many_devices_for_the_map_are_refused(own):
    dh = scenario_paths()["Block8-DH-v0"].read_text().split("[splits")[0].replace("maps/Block8.txt", "my.txt")
    own.write_text(dh.replace("local_size = 9", "local_size = 5").replace("devices = [1, 3]", "devices = [1, 14]"))
    with pytest.raises(ScenarioError, match=r"mission\.devices: up to 14 .* the map has 13"):
        load_scenario(own)


@pytest.mark.parametrize("name", ["Manhatan32-CPP-v0", "missing.toml", "x"])
def test_an_unknown_scenario_is_refused_with_a_hint(name):
    with pytest.raises(ScenarioError, match=r"did you mean Manhattan32-CPP-v0|no such file|known are"):
        load_scenario(name)


def test_a_changed_frozen_file_is_refused(tmp_path):
    from uavbench.world.episode import frozen_columns

    shutil.copytree(scenario_paths()["Block8-CPP-v0"].parent, tmp_path / "scenarios")
    frozen = tmp_path / "scenarios" / "episodes" / "Block8-CPP-v0-test.npz"
    content = bytearray(frozen.read_bytes())
    content[-5000] ^= 1
    frozen.write_bytes(content)
    found = load_scenario(tmp_path / "scenarios" / "Block8-CPP-v0.toml")
    with pytest.raises(ScenarioError, match=r"splits\.test\.sha256: .* not the frozen file"):
        frozen_columns(found, "test")
    frozen.unlink()
    with pytest.raises(ScenarioError, match=r"splits\.test\.file: .*there is no such file"):
        frozen_columns(found, "test")


def test_frozen_episodes_of_another_map_or_budget_are_refused(tmp_path):
    from uavbench.simulation.simulator import Simulator

    for name in ("Block8-CPP-v0", "Block8-DH-v0"):
        for old, new in (("budget = [10, 30]", "budget = [10, 20]"), ("Block8.txt", "Other.txt")):
            shutil.rmtree(tmp_path / "scenarios", ignore_errors=True)
            shutil.copytree(scenario_paths()[name].parent, tmp_path / "scenarios")
            blocked = (tmp_path / "scenarios/maps/Block8.txt").read_text().replace("..N.....", "..N.###.")
            (tmp_path / "scenarios/maps/Other.txt").write_text(blocked)
            path = tmp_path / "scenarios" / f"{name}.toml"
            path.write_text(path.read_text().replace(old, new, 1).replace(f'id = "{name}"', 'id = "Mine-v0"'))
            with pytest.raises(ScenarioError, match=r"splits\.test\.file: its episodes do not fit"):
                Simulator(load_scenario(path), 1).reset([0], "test", [0])


def test_frozen_episodes_of_another_mission_are_refused(tmp_path):
    from uavbench.simulation.simulator import Simulator

    names = ("Block8-CPP-v0", "Block8-DH-v0")
    shutil.copytree(scenario_paths()[names[0]].parent, tmp_path / "scenarios")
    texts = {name: (tmp_path / "scenarios" / f"{name}.toml").read_text() for name in names}
    for name, other in (names, names[::-1]):
        mission = texts[other][texts[other].index("[mission]") : texts[other].index("[splits")]
        begin, end = texts[name].index("[mission]"), texts[name].index("[splits")
        path = tmp_path / "scenarios" / "mine.toml"
        path.write_text((texts[name][:begin] + mission + texts[name][end:]).replace(f'id = "{name}"', 'id = "Mine-v0"'))
        with pytest.raises(ScenarioError, match=r"splits\.test\.file: its episodes do not fit"):
            Simulator(load_scenario(path), 1).reset([0], "test", [0])


@pytest.mark.parametrize(("old", "new"), [("[1, 3]", "[1, 4]"), ("uavs = [1, 3]\n", "")])
def test_frozen_episodes_of_other_teams_are_refused(tmp_path, old, new):
    from uavbench.simulation.simulator import Simulator

    name = "Manhattan32-DH-Team-v0"
    shutil.copytree(scenario_paths()[name].parent, tmp_path / "scenarios")
    path = tmp_path / "scenarios" / f"{name}.toml"
    path.write_text(path.read_text().replace(old, new, 1).replace(f'id = "{name}"', 'id = "Mine-v0"'))
    with pytest.raises(ScenarioError, match=r"splits\.test\.file: its episodes do not fit"):
        Simulator(load_scenario(path), 1).reset([0], "test", [0])


@pytest.mark.parametrize(
    ("uavs", "reason"),
    [
        ("[1, 5]", "uavs: up to 5 start in landing cells of their own, and the map has 2"),
        ("[2, 1]", "uavs: the lower bound 2 exceeds the upper bound 1"),
        ("[0, 1]", "uavs.0"),
        ("[1, 17]", "uavs.1"),
        ("[1]", "uavs"),
        ("2", "uavs: expected a pair"),
        ('["1", "2"]', "uavs.0"),
    ],
)
def test_a_team_must_be_possible(own, uavs, reason):
    edit(own, "budget = [10, 30]", f"budget = [10, 30]\nuavs = {uavs}")
    with pytest.raises(ScenarioError) as caught:
        load_scenario(own)
    assert reason in str(caught.value)


def test_a_team_of_ones_own_is_frozen_and_flown(own):
    from uavbench import parallel_env
    from uavbench.simulation.freeze import freeze

    edit(own, "budget = [10, 30]", "budget = [10, 30]\nuavs = [2, 2]")
    drawn = parallel_env(own)
    flights = [drawn.reset(options={"split": "test", "episode": k})[0] for k in range(5)]
    assert list(flights[0]) == ["uav_0", "uav_1"]
    own.write_text(own.read_text() + "\n" + freeze(load_scenario(own)))
    frozen = parallel_env(own)
    for k, expected in enumerate(flights):
        found, _ = frozen.reset(options={"split": "test", "episode": k})
        for agent, observation in expected.items():
            assert all(np.array_equal(values, found[agent][name]) for name, values in observation.items())


def test_the_digest_follows_the_observation():
    found = load_scenario("Block8-CPP-v0")
    assert found.digest != found.with_observation(5, 2).digest
    assert found.with_observation(9, 3).digest == found.digest


def test_targets_that_cannot_be_drawn_are_an_error_not_a_hang(own):
    from uavbench.simulation.simulator import Simulator

    edit(own, "target_fraction = [0.2, 0.5]", "target_fraction = [1.0, 1.0]")
    with pytest.raises(ScenarioError, match=r"mission\.target_fraction: .* 10000 attempts"):
        Simulator(load_scenario(own), 1).reset([0], "train", [0])


def test_the_digest_is_of_what_defines_a_scenario(own):
    before = load_scenario(own).digest
    edit(own, "title =", "title = 'Another'\n#")
    assert load_scenario(own).digest == before
    for old, new in (("movement = -0.2", "movement = -0.3"), ("camera_size = 5", "camera_size = 3"), ("[10, 30]", "[10, 31]")):
        edit(own, old, new)
        after = load_scenario(own).digest
        assert after != before
        before = after
    (own.parent / "my.txt").write_text(MAP.replace("N", "."))
    assert load_scenario(own).digest != before


def test_the_digest_does_not_depend_on_where_the_file_is(own, tmp_path):
    elsewhere = tmp_path / "deeper"
    elsewhere.mkdir()
    for name in ("mine.toml", "my.txt"):
        shutil.copy(own.parent / name, elsewhere / name)
    assert load_scenario(elsewhere / "mine.toml").digest == load_scenario(own).digest


def test_maps_need_not_be_square():
    assert scenario(("....L.", "......", "..##..", "......")).shape == (4, 6)


def test_what_a_scenario_says_of_itself_cannot_steer_the_terminal(own):
    edit(own, 'title = "', 'title = "\\u001b[31mred\\u0007 ')
    from commands import uavbench_command

    told = uavbench_command("show", own)
    assert told.exit_code == 0
    assert "?[31mred?" in told.output
    assert "\x1b" not in told.output


def test_frozen_episodes_of_a_narrower_budget_are_refused_until_they_are_drawn_anew(own):
    from commands import uavbench_command

    from uavbench.simulation.freeze import freeze
    from uavbench.simulation.simulator import Simulator

    text = own.read_text()
    own.write_text(text + "\n" + freeze(load_scenario(own)))
    Simulator(load_scenario(own), 1).reset([0], "test", [0])
    edit(own, "budget = [10, 30]", "budget = [5, 60]")  # all frozen ones fit
    with pytest.raises(ScenarioError, match=r"splits\.test\.file: .*choose a new id.*freeze --replace"):
        Simulator(load_scenario(own), 1).reset([0], "test", [0])
    assert "--replace" in uavbench_command("freeze", own).output
    told = uavbench_command("freeze", own, "--replace")
    assert told.exit_code == 0, told.output
    own.write_text(text.replace("budget = [10, 30]", "budget = [5, 60]") + "\n" + told.stdout)
    Simulator(load_scenario(own), 1).reset([0], "test", [0])
    assert "frozen already" in uavbench_command("freeze", scenario_paths()["Block8-CPP-v0"], "--replace").output


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("[rewards]", "rewards = 3\n[other]", "rewards: 3 is not a table"),
        ('kind = "coverage"', "", "mission.kind: is missing"),
        ("title", "\ufefftitle", "is not TOML"),
    ],
)
def test_messages_are_not_those_of_libraries(own, old, new, reason):
    edit(own, old, new)
    with pytest.raises(ScenarioError) as caught:
        load_scenario(own)
    assert reason in str(caught.value) or "unknown key" in str(caught.value)


def test_a_byte_order_mark_and_a_picture_in_place_of_a_map(own):
    own.write_bytes(b"\xef\xbb\xbf" + own.read_bytes())
    load_scenario(own)
    (own.parent / "my.txt").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR")
    with pytest.raises(ScenarioError, match=r"map: .*my\.txt: is not text in UTF-8"):
        load_scenario(own)
    (own.parent / "my.txt").write_bytes(b"BM\0\0\0\n" * 8)
    with pytest.raises(ScenarioError, match="this is no map"):
        load_scenario(own)
