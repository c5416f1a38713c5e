"""Missions as KML 2.2 (Google Earth and others): the path with its altitudes, the zones, and what is covered or collected.

The format: https://developers.google.com/kml/documentation/kmlreference
"""

from xml.etree import ElementTree

import numpy as np

from uavbench.flight.mission import Mission
from uavbench.flight.zones import areas_of

_NAMESPACE = "http://www.opengis.net/kml/2.2"
#: The colours of KML: opacity, blue, green, red.
_STYLES = {
    "path": ("ff0090ff", 3, None),
    "landing": ("ffc0392b", 1, "80c0392b"),
    "no_fly": ("ff2020c0", 1, "802020c0"),
    "covered": ("ff40a040", 1, "6040a040"),
    "missed": ("ff808080", 1, "60808080"),
}
_NAMES = {"landing": "landing zone", "no_fly": "no-fly zone or building", "covered": "covered", "missed": "not covered"}


def kml_text(mission: Mission) -> str:
    """Return the text of the file. Altitudes are above the ground."""
    ElementTree.register_namespace("", _NAMESPACE)
    root = ElementTree.Element(_tag("kml"))
    document = _child(root, "Document")
    _child(document, "name", mission.title)
    seconds = f"{mission.distance:g} m at {mission.settings.speed:g} m/s in {mission.seconds:.0f} s"
    _child(document, "description", f"{mission.warning}. {seconds}" if mission.warning else seconds)
    for name, (line, width, fill) in _STYLES.items():
        _style(document, name, line, width, fill)
    _path(document, mission)
    city, flight = mission.flight.city, mission.flight
    zones = {"landing": np.asarray(city.landing), "no_fly": np.asarray(city.no_fly)}
    if mission.marks:
        for cell in np.argwhere(flight.target > 0).tolist():
            before, left = float(flight.target[tuple(cell)]), float(flight.left[tuple(cell)])
            place = mission.ground.degrees(*cell)
            _point(document, f"device: {before:.1f} data units, {left:.1f} left", place)
    else:
        zones |= {"covered": mission.done(), "missed": mission.missed()}
    for name, cells in zones.items():
        for outline, holes in areas_of(cells):
            _polygon(document, name, mission, outline, holes)
    for name, stop in (("start", mission.route.stops[0]), ("end", mission.route.stops[-1])):
        _point(document, name, mission.ground.degrees(*stop.cell))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _tag(name: str) -> str:
    return f"{{{_NAMESPACE}}}{name}"


def _child(parent: ElementTree.Element, name: str, text: str | None = None) -> ElementTree.Element:
    child = ElementTree.SubElement(parent, _tag(name))
    child.text = text
    return child


def _style(document: ElementTree.Element, name: str, line: str, width: int, fill: str | None) -> None:
    style = ElementTree.SubElement(document, _tag("Style"), id=name)
    drawn = _child(style, "LineStyle")
    _child(drawn, "color", line)
    _child(drawn, "width", str(width))
    if fill:
        _child(_child(style, "PolyStyle"), "color", fill)


def _placemark(document: ElementTree.Element, name: str, style: str | None = None) -> ElementTree.Element:
    placemark = _child(document, "Placemark")
    _child(placemark, "name", name)
    if style:
        _child(placemark, "styleUrl", f"#{style}")
    return placemark


def _path(document: ElementTree.Element, mission: Mission) -> None:
    line = _child(_placemark(document, "path", "path"), "LineString")
    _child(line, "extrude", "1")
    _child(line, "altitudeMode", "relativeToGround")
    stops = [mission.ground.degrees(*stop.cell) for stop in mission.route.stops]
    _child(line, "coordinates", _places(stops if len(stops) > 1 else stops * 2, mission.altitude))


def _point(document: ElementTree.Element, name: str, place: tuple[float, float]) -> None:
    _child(_child(_placemark(document, name), "Point"), "coordinates", _places([place]))


def _polygon(
    document: ElementTree.Element,
    kind: str,
    mission: Mission,
    outline: list[tuple[float, float]],
    holes: list[list[tuple[float, float]]],
) -> None:
    polygon = _child(_placemark(document, _NAMES[kind], kind), "Polygon")
    for boundary, ring in [("outerBoundaryIs", outline), *(("innerBoundaryIs", hole) for hole in holes)]:
        _child(_child(_child(polygon, boundary), "LinearRing"), "coordinates", _places(mission.ground.ring(ring)))


def _places(places: list[tuple[float, float]], altitude: float = 0.0) -> str:
    """Return places as KML has them: longitude,latitude,altitude."""
    return " ".join(f"{lon:.7f},{lat:.7f},{altitude:g}" for lat, lon in places)
