"""Areas of a map as polygons: their outlines run along the edges of cells."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.geodata.libraries import library

#: A corner of cells: (0, 0) is the north-west corner of the map, (M, N) the south-east one.
Corner = tuple[float, float]
#: An outline and the outlines of its holes; each ends with the corner with which it begins.
Area = tuple[list[Corner], list[list[Corner]]]


def areas_of(cells: NDArray[np.bool_]) -> list[Area]:
    """Return the connected areas of the cells that are True, shape (M, N), with their holes."""
    return [_area(polygon) for polygon in _polygons(cells)]


def areas_without_holes(cells: NDArray[np.bool_]) -> list[list[Corner]]:
    """Return the outlines of areas that have no holes and together are the cells that are True.

    Formats of geofences have no holes: an area with a hole is cut in two along a line of cells through the hole.
    """
    shapely = library("shapely")
    found: list[list[Corner]] = []
    left = _polygons(cells)
    while left:
        polygon = left.pop()
        if not len(polygon.interiors):
            found.append(_area(polygon)[0])
            continue
        west, _, east, south = polygon.bounds
        x = round(
            polygon.interiors[0].centroid.x
        )  # holes are cells wide, so that a line at a whole number meets or touches them
        x = min(max(x, west + 1), east - 1)
        parts = [polygon.intersection(shapely.box(low, -1, high, south + 1)) for low, high in ((west, x), (x, east))]
        left += [each for part in parts for each in shapely.get_parts(part) if each.geom_type == "Polygon"]
    return sorted(found)


def centres_of(cells: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the cell of each connected area that is nearest to the area's middle."""
    centres: list[tuple[int, int]] = []
    for polygon in _polygons(cells):
        inside = [
            (r, c) for r, c in np.argwhere(cells).tolist() if polygon.contains(library("shapely").Point(c + 0.5, r + 0.5))
        ]
        middle = np.mean(inside, axis=0)
        centres.append(min(inside, key=lambda cell: (float(np.hypot(*(np.array(cell) - middle))), cell)))
    return sorted(centres)


def _polygons(cells: NDArray[np.bool_]) -> list[Any]:
    """Return shapely's polygons of the connected areas, x along the columns and y along the rows."""
    shapely = library("shapely")
    boxes = [shapely.box(c, r, c + 1, r + 1) for r, c in np.argwhere(cells).tolist()]
    together = shapely.unary_union(boxes) if boxes else shapely.MultiPolygon()
    return [shapely.simplify(part, 0) for part in shapely.get_parts(together)]


def _area(polygon: Any) -> Area:
    """Return the outlines of a polygon as corners (row, column)."""
    rings = [[(y, x) for x, y in ring.coords] for ring in (polygon.exterior, *polygon.interiors)]
    return rings[0], rings[1:]
