"""`uavbench import`, from a file to a scenario that flies: what is drawn, what is written, and what is refused in one line."""

import re
import shlex
import sys
import warnings

import numpy as np
import pytest
from commands import uavbench_command
from places import CENTRE, extract, feature, geojson, osm, ring, way

import uavbench
from uavbench.geodata import CityOptions, GeodataError, import_city
from uavbench.geodata.projection import Projection

for library in ("osmium", "shapely", "pyproj"):
    pytest.importorskip(library, reason="importing cities needs pip install 'uavbench[cities]'")

AT = ("--centre", "{},{}".format(*CENTRE))
#: A building of 40 m × 20 m, south-west of the centre, of four levels; and a taller one in the north-east.
TOWN = (
    feature([ring(-40, -20, 40, 20)], building="yes", **{"building:levels": "4"}),
    feature([ring(10, 30, 20, 20)], height="30"),
)


@pytest.fixture
def town(tmp_path):
    for each in TOWN:
        each["properties"]["building"] = "yes"
    return geojson(tmp_path / "town.geojson", *TOWN)


@pytest.fixture
def bring(tmp_path):
    """Import a file by the command; return the exit code and all that was printed."""

    def run(source, *options, out="my_town.toml"):
        done = uavbench_command("import", source, "--out", tmp_path / out, *options)
        return done.exit_code, done.output

    return run


def rows(path):
    return uavbench.load_scenario(path).rows


def test_buildings_become_the_cells_that_they_cover(town, bring, tmp_path):
    code, text = bring(town, *AT, "--shape", "10x12")
    assert code == 0, text
    drawn = rows(tmp_path / "my_town.toml")
    grid = np.array([list(row) for row in drawn])
    # The map's edges are 50 m north and 60 m west of the centre: rows 0 to 1 are 30 to 50 m north of it.
    assert np.argwhere(grid == "#").tolist() == [[0, 7], [0, 8], [1, 7], [1, 8]]
    assert np.argwhere(grid == "b").tolist() == [[r, c] for r in (5, 6) for c in range(2, 6)]
    assert (grid == "L").sum() == 18


def test_the_file_says_where_it_comes_from(town, bring, tmp_path):
    code, text = bring(town, *AT, "--shape", "10x12", "--licence", "CC0 1.0")
    assert code == 0, text
    scenario = uavbench.load_scenario(tmp_path / "my_town.toml")
    origin = scenario.provenance
    assert (scenario.id, scenario.map, scenario.title) == ("MyTown-CPP-v0", "my_town.txt", "Coverage of MyTown")
    assert (origin.source, origin.licence, origin.centre) == ("town.geojson", "CC0 1.0", CENTRE)
    assert (origin.cell_size, origin.altitude, origin.default_height) == (10, 25, 12)
    south, west, north, east = origin.bounds
    assert (north - south, east - west) == pytest.approx((100 / 111_412, 120 / 55_800), rel=1e-3)
    assert ((north + south) / 2, (east + west) / 2) == pytest.approx(CENTRE, abs=1e-6)
    assert origin.projection.startswith("+proj=tmerc +lat_0=60.0 +lon_0=25.0 ")


def test_texts_in_the_file_are_one_line(tmp_path):
    source = geojson(tmp_path / "a\nb.geojson", *TOWN)
    made = import_city(source, tmp_path / "a.toml", CityOptions(centre=CENTRE, licence=" CC BY 4.0\n"))
    origin = made.scenario.provenance
    assert (origin.source, origin.licence) == ("a b.geojson", "CC BY 4.0")


def test_the_summary_says_what_was_used_and_what_to_run_next(town, bring, tmp_path):
    text = bring(town, *AT, "--shape", "10x12")[1]
    out = tmp_path / "my_town.toml"
    assert text == (
        "MyTown-CPP-v0: Coverage of MyTown\n"
        "map            10 rows × 12 columns of cells of 10 m, centred at latitude 60.00000 and longitude 25.00000\n"
        "buildings      2 of the 2 buildings in the file are on the map, at least in part\n"
        "               the file gives the height of 1 of them, and the number of levels of 1; "
        "0 have the default height of 12 m\n"
        "               1 building is higher than the flying altitude of 25 m and blocks flight\n"
        "cells          10.0 % of the cells are buildings, and 0 cells are in no-fly zones\n"
        "landing zones  3×3 cells from row 6, column 8 on; 3×3 cells from row 1, column 1 on\n"
        "licence        of the data: not stated: ask whoever made the file\n"
        f"wrote {out} and its map my_town.txt\n"
        f"next:  uavbench show {out}\n"
        f"       uavbench evaluate --agent greedy --scenario {out}\n"
    )
    assert uavbench_command("show", out).exit_code == 0


def test_the_summary_counts_in_words(bring, tmp_path):
    courts = [ring(-20, -20, 40, 40), ring(-10, -10, 10, 10)]
    for count, told in ((1, "1 more cell is closed, because no UAV"), (2, "2 more cells are closed, because no UAV")):
        holes = [*courts, ring(0, 0, 10, 10)][: count + 1]
        hall = feature(holes, building="yes", height=40)
        flat = feature([[[25, 60], [25, 61], [25, 60], [25, 60]]], building="yes")
        text = bring(geojson(tmp_path / "a.geojson", hall, *[flat] * count), *AT, "--force")[1]
        assert told in text
        outlines = (
            "1 outline that cannot be used, because it lacks" if count == 1 else "2 outlines that cannot be used, because they"
        )
        assert f"               the file has {outlines}" in text


def test_the_commands_to_run_next_can_be_pasted(town, bring, tmp_path):
    out = tmp_path / "my towns [1]" / "it's mine.toml"
    lines = bring(town, *AT, out=out)[1].split("next:")[1].strip().split("\n")
    assert [shlex.split(line) for line in lines] == [
        ["uavbench", "show", str(out)],
        ["uavbench", "evaluate", "--agent", "greedy", "--scenario", str(out)],
    ]


def test_it_flies(town, bring, tmp_path):
    assert bring(town, *AT, "--shape", "20x20", "--mission", "dh", "--cell", "5", "--altitude", "11")[0] == 0
    scenario = uavbench.load_scenario(tmp_path / "my_town.toml")
    assert scenario.id == "MyTown-DH-v0"
    assert (scenario.mission.cell_size, scenario.mission.altitude, scenario.mission.edge_snr) == (5, 11, -30)
    assert (scenario.budget, scenario.observation.local_size, scenario.observation.global_scale) == ((40, 80), 17, 2)
    assert "b" not in "".join(scenario.rows)  # four levels are higher than 11 m
    env = uavbench.make(tmp_path / "my_town.toml")
    env.reset(seed=0)
    env.step(0)


@pytest.mark.parametrize("shape", ["4x4", "50x50", "5x30"])
@pytest.mark.parametrize("mission", ["cpp", "dh"])
def test_parameters_fit_maps_of_all_sizes(town, bring, tmp_path, shape, mission):
    code, text = bring(town, *AT, "--shape", shape, "--mission", mission)
    assert code == 0, text
    scenario = uavbench.load_scenario(tmp_path / "my_town.toml")
    if mission == "dh":
        assert scenario.mission.devices == ((3, 8) if shape == "4x4" else (3, 10))
        uavbench.make(tmp_path / "my_town.toml").reset(seed=0)
    if shape == "50x50":
        assert scenario.budget == uavbench.load_scenario(f"Urban50-{mission.upper()}-v0").budget
        assert scenario.observation == uavbench.load_scenario("Urban50-CPP-v0").observation


@pytest.mark.parametrize(
    ("out", "name"),
    [("Big-City-DH-v3.toml", "Big-City-DH-v3"), ("old town 2.toml", "OldTown2-CPP-v0"), ("é.toml", "E-CPP-v0")],
)
def test_the_id_follows_from_the_name_of_the_file(town, bring, tmp_path, out, name):
    assert bring(town, *AT, out=out)[0] == 0
    assert uavbench.load_scenario(tmp_path / out).id == name


@pytest.mark.parametrize(("out", "options"), [("Town-DH-v3.toml", ()), ("a.toml", ("--id", "Town-DH-v3"))])
def test_the_mission_follows_from_the_id(town, bring, tmp_path, out, options):
    assert bring(town, *AT, *options, out=out)[0] == 0
    scenario = uavbench.load_scenario(tmp_path / out)
    assert (scenario.id, scenario.title, scenario.mission.kind) == ("Town-DH-v3", "Data harvesting in Town", "harvesting")


def test_the_same_file_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        import_city(extract("Helsinki.osm.pbf"), tmp_path / name / "c.toml")
    for file in ("c.toml", "c.txt"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_without_a_centre_the_map_is_where_the_buildings_are(tmp_path):
    far = [feature([ring(x, y, 15, 15)]) for x, y in ((0, 0), (30, 0), (0, 30), (30, 30), (5000, 9000), (-4000, -2000))]
    made = import_city(geojson(tmp_path / "a.geojson", *far), tmp_path / "a.toml", CityOptions(shape=(20, 20)))
    assert sum(made.buildings.values()) == 4
    assert made.in_file == 6


def test_no_fly_zones_from_tags_and_from_a_file(tmp_path, town):
    zone = geojson(tmp_path / "zone.geojson", feature([ring(-40, -50, 20, 40)], building="yes"))
    army = osm(tmp_path / "a.osm", way(1, [1, 2, 3, 4, 1], landuse="military") + way(2, [1, 2, 3, 1], building="yes"))
    plain = CityOptions(centre=CENTRE, shape=(10, 12))
    assert import_city(town, tmp_path / "a.toml", plain).no_fly == 0
    made = import_city(town, tmp_path / "b.toml", CityOptions(centre=CENTRE, shape=(10, 12), no_fly=zone))
    grid = np.array([list(row) for row in made.scenario.rows])
    assert np.argwhere(grid == "N").tolist() == [[r, c] for r in (7, 8, 9) for c in (2, 3)]
    assert np.argwhere(grid == "#")[-2:].tolist() == [[6, 2], [6, 3]]  # a low building under a no-fly zone
    made = import_city(army, tmp_path / "c.toml", plain)
    grid = np.array([list(row) for row in made.scenario.rows])
    assert (np.isin(grid, ["N", "#"])[3:7, 4:8]).all()
    assert made.no_fly + (grid == "#").sum() == 16


def test_landing_zones_can_be_given(town, bring, tmp_path):
    assert bring(town, *AT, "--shape", "10x12", "--landing", "9,0,1,2", "--landing", "3,3,2,2")[0] == 0
    grid = np.array([list(row) for row in rows(tmp_path / "my_town.toml")])
    assert np.argwhere(grid == "L").tolist() == [[3, 3], [3, 4], [4, 3], [4, 4], [9, 0], [9, 1]]


def test_courts_are_closed(tmp_path):
    court = feature([ring(-50, -50, 100, 100), ring(-20, -20, 40, 40)], building="yes", height=40)
    made = import_city(geojson(tmp_path / "a.geojson", court), tmp_path / "a.toml", CityOptions(centre=CENTRE, shape=(20, 20)))
    grid = np.array([list(row) for row in made.scenario.rows])
    assert (grid[8:12, 8:12] == "N").all()
    assert made.closed == 16


def test_nothing_is_replaced_without_force(town, bring, tmp_path):
    (tmp_path / "my_town.txt").write_text("mine")
    code, text = bring(town, *AT)
    assert (code, "my_town.txt: exists already" in text) == (2, True)
    assert not (tmp_path / "my_town.toml").exists()
    assert bring(town, *AT, "--force")[0] == 0
    assert len(rows(tmp_path / "my_town.toml")) == 50
    code, text = bring(town, *AT)
    assert (code, "my_town.toml: exists already" in text) == (2, True)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--shape", "3x50"), "shape: 3 rows × 50 columns: both must be 4 to 1024"),
        (("--shape", "50x2000"), "both must be 4 to 1024"),
        (("--shape", "50"), "--shape 50: write ROWSxCOLUMNS, as in 50x50"),
        (("--shape", "axb"), "write ROWSxCOLUMNS"),
        (("--centre", "60"), "--centre 60: write LAT,LON in degrees"),
        (("--centre", "60,abc"), "write LAT,LON"),
        (("--centre", "95,25"), "centre: 95, 25 is no place"),
        (("--centre", "60,190"), "is no place"),
        (("--centre", "-88,25"), "is too near to a pole"),
        (("--centre", "60,180"), "crosses the antimeridian"),
        (
            ("--centre", "61,26"),
            "no building is on the map around 61.00000, 26.00000: choose a --centre near the file's 2 buildings at latitudes",
        ),
        (("--cell", "0"), "cell: 0 m: expected 0.1 to 1000 m"),
        (("--cell", "nan"), "cell: nan m"),
        (("--altitude", "-5"), "altitude: -5 m: expected"),
        (("--default-height", "inf"), "default-height: inf m"),
        (("--landing", "1,2,3"), "--landing 1,2,3: write ROW,COL,HEIGHT,WIDTH"),
        (("--landing", "48,0,3,3"), "landing: the zone 48,0,3,3 is not on the map"),
        (("--landing", "26,22,1,1"), "row 26, column 22 is a low building"),
        (("--id", "my town"), "id: 'my town' is not of the form expected, as in MyCity-CPP-v0"),
        (
            ("--id", "A-DH-v0", "--mission", "cpp"),
            "mission: cpp contradicts the id A-DH-v0, which names DH: leave out --mission",
        ),
        (
            ("--id", "Urban50-CPP-v0"),
            "my_town.toml: nothing is written: id: Urban50-CPP-v0 is a shipped scenario and means something else",
        ),
        (("--licence", "CC\nBY"), r"licence: 'CC\nBY' has a line break or a control character: write one line of text"),
        (("--licence", "CC\x1b[31m"), "has a line break or a control character"),
        (("--licence", "  "), "licence: '' names no licence: write its name, or leave out --licence"),
        (("--licence", ""), "names no licence"),
        (("--licence", "C" * 301), "licence: has 301 characters: at most 300 are allowed"),
        (("--no-fly", "none.geojson"), "none.geojson: there is no such file"),
        (("--mission", "tag"), "cpp"),
    ],
)
def test_wrong_options_are_one_line_and_leave_nothing(town, bring, tmp_path, options, reason):
    code, text = bring(town, *(() if "--centre" in options else AT), *options)
    assert code == 2
    assert reason in text
    assert "Traceback" not in text
    assert options == ("--mission", "tag") or text.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["town.geojson"]


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("town.shp", "", "is neither .osm, .osm.pbf nor .geojson"),
        ("no.geojson", None, "there is no such file"),
        (
            "a.geojson",
            '{"type": "FeatureCollection", "features": []}',
            "has no buildings: they are polygons, and the file holds none",
        ),
        ("a.osm", "<osm version='0.6'></osm>", "holds no objects of OpenStreetMap: it is empty, or was cut off"),
        ("a.geojson", "hello", "is not JSON"),
        ("a.osm", "hello", "cannot be read as a file of OpenStreetMap"),
        ("a.osm.pbf", "hello", "cannot be read as a file of OpenStreetMap"),
        ("folder.osm", "folder", "is not a plain file, but a folder"),
    ],
)
def test_wrong_files_are_one_line_and_leave_nothing(bring, tmp_path, name, content, reason):
    if content == "folder":
        (tmp_path / name).mkdir()
    elif content is not None:
        (tmp_path / name).write_text(content)
    before = sorted(tmp_path.iterdir())
    code, text = bring(tmp_path / name)
    assert (code, text.count("\n")) == (2, 1)
    assert reason in text
    assert sorted(tmp_path.iterdir()) == before


LINE = feature([[25, 60], [25, 61]], "LineString")
FLAT = feature([[[25, 60], [25, 61], [25, 60], [25, 60]]])
USELESS = [
    ([feature([25.0, 60.0], "Point")] * 2, "2 points"),
    ([LINE], "1 line"),
    ([LINE, feature([[25, 60]], "MultiPoint")], "1 line and 1 point"),
    ([feature([ring(0, 0, 9, 9)], "Polygn")], "1 geometry of the unknown type 'Polygn'"),
    ([FLAT], "1 outline that cannot be used, because it lacks points, has no area or crosses 180° of longitude"),
    ([FLAT, feature([], "MultiPolygon")], "2 outlines that cannot be used, because they lack points"),
    ([{"type": "Feature", "properties": {}, "geometry": None}], "1 feature without a geometry"),
]


@pytest.mark.parametrize(
    ("features", "found"),
    [
        *USELESS,
        ([feature([ring(0, 0, 9, 9)], building="no")], "1 feature that is no building by its properties"),
        ([feature([ring(0, 0, 9, 9)], landuse="military")], "1 no-fly zone"),
        (
            [feature([], kind) for kind in ("A", "A", "Point", "C", "D", "E")],
            "2 geometries of the unknown type 'A', 1 point, .* other",
        ),
    ],
)
def test_without_buildings_the_error_says_what_there_is(bring, tmp_path, features, found):
    code, text = bring(geojson(tmp_path / "a.geojson", *features))
    assert (code, text.count("\n")) == (2, 1)
    assert re.search(rf"a\.geojson: has no buildings: they are polygons, and the file holds only {found}", text)


@pytest.mark.parametrize(("features", "found"), USELESS)
def test_without_no_fly_zones_the_error_says_what_there_is(town, bring, tmp_path, features, found):
    zones = geojson(tmp_path / "zones.geojson", *features)
    code, text = bring(town, "--no-fly", zones)
    assert (code, text.count("\n")) == (2, 1)
    assert f"--no-fly {zones}: has no no-fly zones: they are polygons, and the file holds only {found}" in text


def test_an_extract_of_which_only_the_head_is_left_is_no_town(bring, tmp_path):
    (tmp_path / "cut.osm.pbf").write_bytes(extract("Helsinki.osm.pbf").read_bytes()[:100])
    code, text = bring(tmp_path / "cut.osm.pbf")
    assert (code, text) == (
        2,
        f"uavbench: {tmp_path / 'cut.osm.pbf'}: holds no objects of OpenStreetMap: it is empty, or was cut off\n",
    )


def test_buildings_of_openstreetmap_must_be_areas(bring, tmp_path):
    body = '<node id="9" version="1" lat="60" lon="25"><tag k="building" v="yes"/></node>'
    body += way(1, [1, 2, 3, 4], building="yes") + way(2, [1, 2, 9, 8, 1], building="yes")
    code, text = bring(osm(tmp_path / "a.osm", body))
    assert (code, text.count("\n")) == (2, 1)
    assert (
        "they are closed lines or multipolygons with the tag building, and the file holds only 1 point, 1 line and 1 " in text
    )


def test_a_map_without_a_cell_of_buildings_says_why(town, bring):
    code, text = bring(town, *AT, "--cell", "100")
    assert code == 0
    assert (
        "uavbench: warning: no cell of the map is a building: the 2 buildings on it cover less than half of each cell" in text
    )
    assert "of 100 m: choose a smaller --cell" in text
    assert "warning" not in bring(town, *AT, "--force")[1]


@pytest.mark.parametrize(
    ("zones", "reason"),
    [
        ([(9000, 0, 50, 50)], "its no-fly zone does not lie on the map: choose another --centre or another file"),
        ([(9000, 0, 50, 50), (-9000, 0, 9, 9)], "none of its 2 no-fly zones lies on the map"),
        ([(0, 0, 4, 4)], "the 1 no-fly zone on the map covers less than half of each cell of 10 m: choose a smaller --cell"),
        ([(0, 0, 4, 4), (100, 0, 4, 4)], "the 2 no-fly zones on the map cover less than half"),
    ],
)
def test_no_fly_zones_without_a_cell_say_why(town, bring, tmp_path, zones, reason):
    path = geojson(tmp_path / "zones.geojson", *(feature([ring(*zone)]) for zone in zones))
    code, text = bring(town, *AT, "--no-fly", path)
    assert code == 0
    assert f"uavbench: warning: no cell is closed by --no-fly {path}: {reason}" in text
    made = import_city(town, tmp_path / "again.toml", CityOptions(centre=CENTRE, no_fly=path))
    assert len(made.warnings) == 1


@pytest.mark.parametrize("out", ["my_town.txt", "my_town", "CON.toml", "a?.toml"])
def test_the_file_to_write_must_have_a_name_for_a_scenario(town, bring, tmp_path, out):
    code, text = bring(town, out=out)
    assert (code, text.count("\n")) == (2, 1)
    assert f"--out {tmp_path / out}: " in text


@pytest.mark.parametrize("out", ["afile/q.toml", "afile/folder/q.toml"])
def test_a_file_in_the_place_of_a_folder_is_named(bring, tmp_path, out):
    (tmp_path / "afile").write_text("mine")
    code, text = bring(tmp_path / "is not read.osm", out=out)
    assert (code, text.count("\n")) == (2, 1)
    assert f"--out {tmp_path / out}: {tmp_path / 'afile'} is a file, not a folder: choose another folder" in text


@pytest.mark.parametrize("name", ["my_town.toml", "my_town.txt"])
def test_a_folder_in_the_place_of_a_file_is_named(town, bring, tmp_path, name):
    (tmp_path / name).mkdir()
    code, text = bring(town, "--force")
    assert (code, text.count("\n")) == (2, 1)
    assert f"--out {tmp_path / 'my_town.toml'}: cannot write {tmp_path / name}: it is a folder, not a file" in text


def test_a_name_that_no_folder_can_have_is_one_line(town, bring):
    code, text = bring(town, out=f"{'a' * 300}/q.toml")
    assert (code, text.count("\n"), "--out" in text) == (2, 1, True)


def test_landing_zones_apart_from_each_other_are_refused(tmp_path, bring):
    wall = feature([ring(-300, -15, 600, 30)], building="yes", height=40)
    code, text = bring(geojson(tmp_path / "a.geojson", wall), *AT, "--landing", "0,0,2,2", "--landing", "40,0,2,2")
    assert (code, text.count("\n")) == (2, 1)
    assert "landing: no UAV can fly between the zones 0,0,2,2 and 40,0,2,2" in text
    assert str(tmp_path) not in text


HALL = feature([ring(-100, -100, 200, 200)], building="yes")
STRIPES = [feature([ring(-150 + 10 * n, -150, 6, 300)], building="yes") for n in range(30)]
COURTS = [
    feature([ring(-150, -150, 300, 300), *(ring(x, y, 8, 8) for x in (1, 21) for y in (1, 21))], building="yes", height=50)
]


@pytest.mark.parametrize(
    ("buildings", "options", "reason"),
    [
        (
            [HALL],
            ("--cell", "0.1"),
            "the map, which is 5 m × 5 m: choose another --centre, a larger --shape or a larger --cell",
        ),
        (
            [HALL],
            ("--shape", "4x4"),
            "the map, which is 40 m × 40 m: choose another --centre, a larger --shape or a larger --cell",
        ),
        (STRIPES, ("--shape", "20x20"), "choose another --centre, a larger --shape or a smaller --cell"),
        (COURTS, ("--shape", "20x20"), "no UAV could leave any of the map's 4 free cells, because buildings or no-fly zones"),
    ],
)
def test_a_map_without_room_to_land_says_what_helps(bring, tmp_path, buildings, options, reason):
    code, text = bring(geojson(tmp_path / "a.geojson", *buildings), *AT, *options)
    assert (code, text.count("\n")) == (2, 1)
    assert "no cell is free for a landing zone: " in text
    assert reason in text


def test_data_harvesting_needs_a_cell_for_a_device(bring, tmp_path):
    walls = [ring(-10, 0, 30, 20), ring(-20, -20, 40, 20)]  # all of a map of 4×4 cells but one of its corners
    source = geojson(tmp_path / "a.geojson", *(feature([wall], building="yes") for wall in walls))
    code, text = bring(source, *AT, "--shape", "4x4", "--mission", "dh", "--landing", "0,0,2,1")
    assert (code, text.count("\n")) == (2, 1)
    assert "mission: dh: besides the landing zones, no cell without buildings is left for a device: choose a larger" in text


def test_a_missing_library_is_named(town, bring, monkeypatch):
    monkeypatch.setitem(sys.modules, "shapely", None)
    code, text = bring(town)
    assert (code, text) == (2, "uavbench: places on earth need shapely: pip install 'uavbench[cities]'\n")


def test_the_projection_is_true_near_its_centre():
    shapely = pytest.importorskip("shapely")
    flat = Projection(CENTRE).to_metres(shapely.Polygon(ring(-200, -100, 400, 300)))
    assert flat.bounds == pytest.approx((-200, -100, 200, 200), abs=0.05)
    assert flat.area == pytest.approx(400 * 300, rel=1e-4)


def test_far_and_huge_polygons_do_no_harm(tmp_path, town):
    west, south = 25.0 - 80, 60.0 - 80
    huge = [[west, south], [west + 160, south], [west + 160, 89], [west, 89], [west, south]]
    zone = geojson(tmp_path / "zone.geojson", feature([huge]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(GeodataError, match=r"2,4\d\d of the map's 2,500 cells are in no-fly zones, .* zones for --no-fly"):
            import_city(town, tmp_path / "a.toml", CityOptions(centre=CENTRE, no_fly=zone))


def test_the_help_names_every_option():
    text = re.sub(r"\s+", " ", uavbench_command("import", "--help").output)
    for option in (
        "--cell",
        "--altitude",
        "--shape",
        "--centre",
        "--out",
        "--no-fly",
        "--landing",
        "--mission",
        "--force",
        "--id",
    ):
        assert option in text
