"""KML: valid by the schema of the Open Geospatial Consortium, and read back it is the mission."""

from pathlib import Path

import numpy as np
import pytest

from uavbench.flight.kml_file import kml_text

etree = pytest.importorskip("lxml.etree")
pykml = pytest.importorskip("pykml")
SPACE = {"k": "http://www.opengis.net/kml/2.2"}


@pytest.fixture(scope="module")
def schema():
    """The schema that pykml ships; the schemas that it refers to lie beside it, and no request is made for them."""
    folder = Path(pykml.__file__).parent / "schemas"

    class Beside(etree.Resolver):
        def resolve(self, url, _public, context):
            return self.resolve_filename(str(folder / url.rsplit("/", 1)[-1]), context)

    parser = etree.XMLParser(no_network=True)
    parser.resolvers.add(Beside())
    return etree.XMLSchema(etree.parse(str(folder / "ogckml22.xsd"), parser))


def places(text):
    return [tuple(map(float, each.split(","))) for each in text.split()]


def test_kml_is_valid_and_is_the_mission(mission, schema):
    root = etree.fromstring(kml_text(mission).encode())
    schema.assertValid(root)
    path = places(root.findtext(".//k:LineString/k:coordinates", namespaces=SPACE))
    stops = [(*mission.ground.degrees(*stop.cell)[::-1], mission.altitude) for stop in mission.route.stops]
    assert np.array(path) == pytest.approx(np.array(stops), abs=1e-7)
    assert root.findtext(".//k:LineString/k:altitudeMode", namespaces=SPACE) == "relativeToGround"
    names = [each.text for each in root.iterfind(".//k:Placemark/k:name", SPACE)]
    assert {"path", "start", "end", "landing zone", "no-fly zone or building"} <= set(names)
    devices = [name for name in names if name.startswith("device")]
    assert len(devices) == ((mission.flight.target > 0).sum() if "DH" in mission.flight.scenario.id else 0)
    assert ("covered" in names) == ("CPP" in mission.flight.scenario.id)
    for ring in root.iterfind(".//k:LinearRing/k:coordinates", SPACE):
        corners = places(ring.text)
        assert corners[0] == corners[-1]
        assert len(corners) >= 5
    styles = {each.get("id") for each in root.iterfind(".//k:Style", SPACE)}
    assert {each.text.removeprefix("#") for each in root.iterfind(".//k:styleUrl", SPACE)} <= styles
