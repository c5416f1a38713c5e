"""Reading footprints from files of OpenStreetMap: ``.osm`` and ``.osm.pbf``."""

import json
from pathlib import Path
from typing import Any

from uavbench.errors import one_line
from uavbench.geodata.footprints import LINE, POINT, Extract, kind_of, polygon
from uavbench.geodata.libraries import GeodataError, Geometry, library
from uavbench.world.files import check_plain

#: What OpenStreetMap asks for.
OSM_LICENCE = "© OpenStreetMap contributors, ODbL 1.0"
#: The maximum size of each format, in bytes: the places of all points are held in memory.
MOST_BYTES = {"pbf": 2**28, "osm": 2**31}
_KEYS = ("building", "aeroway", "landuse", "military")


def read_osm(path: Path, form: str, extract: Extract) -> None:
    """Add to ``extract`` the buildings, aerodromes and military areas of a file: closed ways and multipolygons.

    Parameters
    ----------
    path : Path
    form : {"osm", "pbf"}
    extract : Extract

    Raises
    ------
    FileError
        When the file does not exist, is too large or cannot be opened.
    GeodataError
        When it is no file of OpenStreetMap, is cut off, or holds nothing.
    """
    osmium = library("osmium")
    check_plain(path, MOST_BYTES[form])
    relations: set[int] = set()
    assembled: set[int] = set()  # osmium assembles a relation before or after it passes on the relation itself
    try:
        file = osmium.io.File(str(path.absolute()), form)
        objects = osmium.FileProcessor(file).with_areas(osmium.filter.KeyFilter(*_KEYS))
        for each in objects.with_filter(osmium.filter.KeyFilter(*_KEYS)):
            _add(each, extract, relations, assembled)
        if extract.empty and next(iter(osmium.FileProcessor(file)), None) is None:
            raise GeodataError("holds no objects of OpenStreetMap: it is empty, or was cut off")
    except GeodataError as error:
        raise GeodataError(f"{one_line(path)}: {error}") from None
    except (RuntimeError, ValueError, osmium.InvalidLocationError) as error:
        raise GeodataError(f"{one_line(path)}: cannot be read as a file of OpenStreetMap: {one_line(error)}") from None
    extract.skipped += len(relations - assembled)


def _add(each: Any, extract: Extract, relations: set[int], assembled: set[int]) -> None:
    """Add an object of a file if it is a building or a no-fly zone."""
    area = each.is_area()
    tags = {tag.k: tag.v for tag in each.tags}
    kind = kind_of(tags)
    if kind is None:
        return
    if area:
        if not each.from_way():  # closed ways have been added as such
            assembled.add(each.orig_id())
            extract.add(_assembled(each), kind, tags)
    elif each.is_node():
        extract.rest[POINT] += 1
    elif each.is_way():
        if each.is_closed() and tags.get("area") != "no":
            extract.add(_closed(each), kind, tags)
        else:
            extract.rest[LINE] += 1
    elif tags.get("type") in ("multipolygon", "boundary"):
        relations.add(each.id)


def _closed(way: Any) -> Geometry | None:
    """Return the polygon of a closed way; None if the file lacks one of its points."""
    if not all(node.location.valid() for node in way.nodes):
        return None
    return polygon([[(node.lon, node.lat) for node in way.nodes]])


def _assembled(area: Any) -> Geometry | None:
    """Return the multipolygon of a relation."""
    osmium, shapely = library("osmium"), library("shapely")
    try:
        return shapely.geometry.shape(json.loads(osmium.geom.GeoJSONFactory().create_multipolygon(area)))
    except RuntimeError:
        return None
