"""Reading footprints: real extracts, files of OpenStreetMap and GeoJSON, and what is wrong with them."""

import json

import pytest
from places import extract, feature, geojson, osm, ring, way

from uavbench.geodata.footprints import Extract, kind_of, polygon
from uavbench.geodata.geojson_file import read_geojson
from uavbench.geodata.libraries import GeodataError
from uavbench.geodata.osm_file import read_osm
from uavbench.world.files import FileError

for library in ("osmium", "shapely", "pyproj"):
    pytest.importorskip(library, reason="importing cities needs pip install 'uavbench[cities]'")


def read(path, **options):
    found = Extract(**options)
    if path.suffix == ".geojson":
        read_geojson(path, found)
    else:
        read_osm(path, path.suffix[1:], found)
    return found


def test_helsinki_has_the_buildings_that_it_has():
    found = read(extract("Helsinki.osm.pbf"))
    assert len(found.buildings) == found.count == 446
    assert sum(building.height is not None for building in found.buildings) == 154
    assert sum(building.basis == "height" for building in found.buildings) == 16
    assert all(building.shape.is_valid for building in found.buildings)
    assert sum(len(part.interiors) for building in found.buildings for part in getattr(building.shape, "geoms", ())) > 50
    assert found.skipped == 55  # cut by the border of the extract
    assert found.extent == pytest.approx((24.9352, 60.1642, 24.9534, 60.1790), abs=1e-4)


def test_the_second_extract_too():
    found = read(extract("test.osm.pbf"))
    assert (found.count, found.skipped) == (2171, 48)
    assert {building.height for building in found.buildings} == {None, 3.0}


def test_what_is_not_near_is_counted_but_not_kept():
    found = read(extract("Helsinki.osm.pbf"), near=(24.940, 60.168, 24.944, 60.170))
    assert found.count == 446
    assert 10 < len(found.buildings) < 100


@pytest.mark.parametrize(
    ("tags", "kind"),
    [
        ({"building": "yes"}, "building"),
        ({"building": "church", "landuse": "military"}, "building"),
        ({"building": "no"}, None),
        ({"building": "No", "military": "barracks"}, "no-fly"),
        ({"building": False}, None),
        ({"building": "yes", "location": "underground"}, None),
        ({"aeroway": "aerodrome"}, "no-fly"),
        ({"aeroway": "terminal"}, None),
        ({"landuse": "military"}, "no-fly"),
        ({"landuse": "grass"}, None),
        ({"military": "danger_area"}, "no-fly"),
        ({"building:part": "yes"}, None),
        ({}, None),
    ],
)
def test_tags_tell_what_an_area_is(tags, kind):
    assert kind_of(tags) == kind


def test_a_file_of_openstreetmap(tmp_path):
    body = (
        way(1, [1, 2, 3, 4, 1], building="yes", building_levels="4")
        + way(2, [1, 2, 3, 4, 1], landuse="military")
        + way(3, [1, 2, 3, 4], building="yes")  # not closed
        + way(4, [1, 2, 3, 4, 1], building="yes", area="no")
        + way(5, [1, 2, 9, 4, 1], building="yes", height="9")  # the file has no node 9
        + way(6, [1, 3, 2, 4, 1], building="yes", height="8")  # crosses itself
        + way(7, [1, 2, 1], building="yes")  # has no area
    )
    found = read(osm(tmp_path / "a.osm", body))
    assert [building.height for building in found.buildings] == [12, 8]
    assert (found.count, found.skipped, len(found.no_fly)) == (2, 2, 1)
    assert found.buildings[1].shape.geom_type == "MultiPolygon"


def test_a_relation_is_one_building_with_its_court(tmp_path):
    nodes = "".join(
        f'<node id="{n}" version="1" lat="{lat!r}" lon="{lon!r}"/>' for n, (lon, lat) in enumerate(ring(-5, -5, 10, 10)[:4], 11)
    )
    relation = (
        '<relation id="1" version="1"><member type="way" ref="1" role="outer"/><member type="way" ref="{inner}" role="inner"/>'
        '<tag k="type" v="multipolygon"/><tag k="building" v="yes"/><tag k="height" v="30"/></relation>'
    )
    body = nodes + way(1, [1, 2, 3, 4, 1]) + way(2, [11, 12, 13, 14, 11])
    (building,) = read(osm(tmp_path / "a.osm", body + relation.format(inner=2))).buildings
    assert building.height == 30
    whole, court = polygon([ring(-20, -20, 40, 40)]), polygon([ring(-5, -5, 10, 10)])
    assert building.shape.area == pytest.approx(whole.area - court.area, rel=1e-3)  # OpenStreetMap has centimetres
    cut = read(osm(tmp_path / "b.osm", body + relation.format(inner=3)))
    assert (cut.count, cut.skipped) == (0, 1)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("no.osm", None, "there is no such file"),
        ("a.osm", b"", "no element found"),
        ("a.osm", b"<html></html>", "html"),
        ("a.osm", b"<osm version='0.6'><node id='1' lat='60'", "unclosed token"),
        ("a.osm", b"<osm version='0.6'><node id='1' lat='1000' lon='0'/></osm>", "wrong format for coordinate"),
        ("a.pbf", b"garbage", "PBF error"),
        ("a.pbf", b"", "PBF error"),
    ],
)
def test_what_is_no_file_of_openstreetmap_is_one_line(tmp_path, name, content, reason):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises((GeodataError, FileError), match=reason) as told:
        read(path)
    assert str(told.value).startswith(str(path))
    assert "\n" not in str(told.value)


def test_an_extract_that_is_cut_off_is_refused(tmp_path):
    path = tmp_path / "cut.pbf"
    path.write_bytes(extract("Helsinki.osm.pbf").read_bytes()[:300_000])
    with pytest.raises(GeodataError, match=r"cut\.pbf: cannot be read as a file of OpenStreetMap: PBF error: unexpected EOF"):
        read(path)


def test_too_large_files_are_not_read(tmp_path, monkeypatch):
    path = osm(tmp_path / "a.osm", way(1, [1, 2, 3, 4, 1], building="yes"))
    monkeypatch.setitem(read_osm.__globals__["MOST_BYTES"], "osm", 100)
    with pytest.raises(FileError, match="is larger than 100 bytes"):
        read(path)


def test_too_many_footprints_are_refused(tmp_path, monkeypatch):
    monkeypatch.setitem(Extract.add.__globals__, "_MOST", 1)
    path = geojson(tmp_path / "a.geojson", feature([ring(0, 0, 10, 10)]), feature([ring(20, 0, 10, 10)]))
    with pytest.raises(GeodataError, match=r"a\.geojson: more than 1 footprints: give --centre"):
        read(path)


def test_geojson_with_holes_and_several_polygons(tmp_path):
    path = geojson(
        tmp_path / "a.geojson",
        feature([ring(0, 0, 30, 30), ring(10, 10, 10, 10)], building="yes", height=20.5),
        feature([[ring(50, 0, 10, 10)], [ring(70, 0, 10, 10)]], "MultiPolygon", building="yes", **{"building:levels": "2"}),
        feature([ring(0, 50, 9, 9)], aeroway="heliport"),
        feature([ring(0, 80, 9, 9)], leisure="park"),
        feature([25.0, 60.0], "Point", building="yes"),
        {"type": "Feature", "properties": None, "geometry": None},
    )
    found = read(path)
    assert [building.height for building in found.buildings] == [20.5, 6, 6]
    assert len(found.buildings[0].shape.interiors) == 1
    assert len(found.no_fly) == 1


@pytest.mark.parametrize("kind", ["Feature", "Polygon", "GeometryCollection"])
def test_geojson_of_one_thing(tmp_path, kind):
    shape = {"type": "Polygon", "coordinates": [ring(0, 0, 10, 10)]}
    whole = {
        "Feature": {"type": "Feature", "properties": {"height": "7 m"}, "geometry": shape},
        "Polygon": shape,
        "GeometryCollection": {"type": "GeometryCollection", "geometries": [shape]},
    }
    path = tmp_path / "a.geojson"
    path.write_text("\ufeff" + json.dumps(whole[kind]), encoding="utf-8")
    (building,) = read(path).buildings
    assert building.height == (7 if kind == "Feature" else None)


def test_without_any_building_tag_every_polygon_is_a_building(tmp_path):
    path = geojson(tmp_path / "a.geojson", feature([ring(0, 0, 9, 9)]), feature([ring(20, 0, 9, 9)], landuse="military"))
    found = read(path)
    assert (len(found.buildings), len(found.no_fly)) == (1, 1)


@pytest.mark.parametrize(
    ("top", "licence"),
    [
        ({}, None),
        ({"license": "CC0 1.0"}, "CC0 1.0"),
        (
            {"copyright": "The data included in this document is from www.openstreetmap.org."},
            "© OpenStreetMap contributors, ODbL 1.0",
        ),
        ({"attribution": "two\nlines"}, "two lines"),
        ({"licence": 5}, None),
    ],
)
def test_the_licence_that_a_file_states(tmp_path, top, licence):
    assert read_geojson(geojson(tmp_path / "a.geojson", feature([ring(0, 0, 9, 9)]), **top), Extract()) == licence


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is not JSON"),
        ("{", "is not JSON"),
        ("[1]", "has no object at the top"),
        ("{}", "its type is None"),
        ('{"type": "Topology"}', "its type is 'Topology'"),
        ('{"type": "FeatureCollection"}', "has a list of features"),
        ('{"type": "FeatureCollection", "features": [7]}', "feature 0 is no object"),
        ('{"type": "Polygon", "coordinates": 5}', "no list of coordinates"),
        ('{"type": "Polygon", "coordinates": [[5]]}', "no list of coordinates"),
        ('{"type": "Polygon", "coordinates": [[["a", 1]]]}', "is no point"),
        ('{"type": "Polygon", "coordinates": [[[true, 1]]]}', "is no point"),
        ('{"type": "Polygon", "coordinates": [[[NaN, 1]]]}', "out of range"),
        ('{"type": "Polygon", "coordinates": [[[385000.5, 6671000.5]]]}', "out of range: GeoJSON has degrees, longitude first"),
        ('{"type": "Polygon", "coordinates": [[[60, 120]]]}', "out of range"),
        ('{"type": "Feature", "geometry": 3}', "3 is no geometry"),
        ('{"type": "Polygon", "crs": {"properties": {"name": "EPSG:3067"}}, "coordinates": []}', "convert them to degrees"),
        ("[" * 100_000, "nested too deeply"),
        (json.dumps({"type": "Polygon", "coordinates": []})[:-1] + ', "x": ' + "9" * 5000 + "}", "is not JSON"),
    ],
)
def test_what_is_no_geojson_is_one_line(tmp_path, text, reason):
    path = tmp_path / "a.geojson"
    path.write_text(text, encoding="utf-8")
    with pytest.raises((GeodataError, FileError), match=reason) as told:
        read(path)
    assert str(told.value).startswith(f"{path}: ")
    assert "\n" not in str(told.value)


def test_collections_in_collections_end(tmp_path):
    shape = {"type": "Polygon", "coordinates": [ring(0, 0, 9, 9)]}
    for _ in range(30):
        shape = {"type": "GeometryCollection", "geometries": [shape]}
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps(shape), encoding="utf-8")
    with pytest.raises(GeodataError, match="more than 20 collections are nested"):
        read(path)


def test_invalid_polygons_are_repaired_or_skipped(tmp_path):
    a, b, c, d, _ = ring(0, 0, 20, 20)
    path = geojson(
        tmp_path / "a.geojson",
        feature([[a, c, b, d, a]]),  # a bow tie: two triangles
        feature([[a, b, a, b, a]]),  # a line
        feature([[a, b]]),
        feature([]),
        feature([ring(0, 0, 20, 20), [a, b]]),  # a hole without an area
    )
    found = read(path)
    assert [building.shape.is_valid for building in found.buildings] == [True, True]
    assert found.buildings[0].shape.area == pytest.approx(found.buildings[1].shape.area / 2)
    assert found.skipped == 3


def test_a_polygon_around_half_the_world_is_skipped(tmp_path):
    around = [[-179, 60], [179, 60], [179, 61], [-179, 61], [-179, 60]]
    found = read(geojson(tmp_path / "a.geojson", feature([around]), feature([ring(0, 0, 10, 10)])))
    assert (found.count, found.skipped) == (1, 1)
