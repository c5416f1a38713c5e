"""Why buildings and options make no map that can be flown, or a strange one, and what to change: the messages of the import."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uavbench.geodata.footprints import Extract, Noun
from uavbench.geodata.libraries import Geometry
from uavbench.geodata.rasterise import HALF, Grid, coverage
from uavbench.world.cells import BUILDING, FREE, LOW_BUILDING, NO_FLY
from uavbench.world.maps import LARGEST_SIDE

_OPEN_GROUND = 0.1  # of a map: with less ground that nothing covers, smaller cells are hardly freer than large ones
_SMALL_CELL = 1.0  # metres: a UAV finds no more room in still smaller cells

_SHOWN = 4  # kinds of things that a message lists
#: Outlines of buildings and no-fly zones that are left out.
UNUSABLE: Noun = (
    "outline that cannot be used, because it lacks points, has no area or crosses 180° of longitude",
    "outlines that cannot be used, because they lack points, have no area or cross 180° of longitude",
)
_ZONE: Noun = ("no-fly zone", "no-fly zones")


def counted(number: int, noun: Noun) -> str:
    """Return a number and what it counts, in singular or plural."""
    return f"{number:,} {noun[number != 1]}"


def no_buildings(extract: Extract, areas: str) -> str:
    """Return the message that a file has no buildings, whose form is ``areas``."""
    return f"has no buildings: they are {areas}, and the file {_content(extract)}"


def no_zones(extract: Extract) -> str:
    """Return the message that a file of no-fly zones has none."""
    return f"has no no-fly zones: they are polygons, and the file {_content(extract)}"


def _content(extract: Extract) -> str:
    """Return what a file holds instead of what is sought."""
    found: list[tuple[int, Noun]] = [(number, noun) for noun, number in extract.rest.most_common()]
    found += [(number, noun) for number, noun in ((extract.skipped, UNUSABLE), (extract.zones, _ZONE)) if number]
    texts = [counted(*each) for each in found[:_SHOWN]] + ["other things"] * (len(found) > _SHOWN)
    return f"holds only {_listed(texts, 'and')}" if texts else "holds none"


def _listed(texts: Sequence[str], word: str) -> str:
    """Return texts as a list in words."""
    return f" {word} ".join(filter(None, [", ".join(texts[:-1]), texts[-1]]))


def none_on_map(extract: Extract, centre: tuple[float, float]) -> str:
    """Return the message that none of a file's buildings is on the map around ``centre``."""
    west, south, east, north = extract.extent or (0.0, 0.0, 0.0, 0.0)
    found = counted(extract.count, ("building", "buildings"))
    places = f"latitudes {south:.4f} to {north:.4f} and longitudes {west:.4f} to {east:.4f}"
    around = f"{centre[0]:.5f}, {centre[1]:.5f}"
    return f"no building is on the map around {around}: choose a --centre near the file's {found} at {places}"


def no_room(cells: NDArray[np.uint8], shapes: Sequence[Geometry], grid: Grid, with_zones: bool) -> str:
    """Return the message that a map has no place for a landing zone.

    Parameters
    ----------
    cells : ndarray of uint8, shape (M, N)
        The codes of the map's cells.
    shapes : sequence of geometries
        Everything that covers ground: buildings and no-fly zones, in metres.
    grid : Grid
    with_zones : bool
        Whether the user gave no-fly zones.
    """
    free, closed = int((cells == FREE).sum()), int((cells == NO_FLY).sum())
    if free:
        reason = (
            f"no UAV could leave any of the map's {free:,} free cells, because buildings or no-fly zones enclose each of them"
        )
    elif closed:
        reason = f"{closed:,} of the map's {cells.size:,} cells are in no-fly zones, and buildings cover the others"
    else:
        size = f"{grid.rows * grid.cell:g} m × {grid.cols * grid.cell:g} m"
        reason = f"buildings cover at least half of each cell of the map, which is {size}"
    fixes = ["another --centre"]
    if closed and with_zones:
        fixes.append("smaller zones for --no-fly")
    else:
        if min(cells.shape) < LARGEST_SIDE:
            fixes.append("a larger --shape")
        open_ground = 1 - float(coverage(shapes, grid).mean())
        fixes.append("a smaller --cell" if open_ground >= _OPEN_GROUND and grid.cell > _SMALL_CELL else "a larger --cell")
    return f"no cell is free for a landing zone: {reason}: choose {_listed(fixes, 'or')}"


def no_building_cell(cells: NDArray[np.uint8], buildings: int, grid: Grid) -> str | None:
    """Return the warning that a map has buildings but no cell is one, if that is so."""
    if np.isin(cells, (BUILDING, LOW_BUILDING)).any():
        return None
    fix = "a smaller --cell" if grid.cell > _SMALL_CELL else "another --centre"
    what = counted(buildings, ("building on it covers", "buildings on it cover"))
    return f"no cell of the map is a building: the {what} less than half of each cell of {grid.cell:g} m: choose {fix}"


def useless_zones(name: str, number: int, zones: Sequence[Geometry], grid: Grid) -> str | None:
    """Return the warning that a file of no-fly zones closes no cell, if that is so.

    Parameters
    ----------
    name : str
        The file.
    number : int
        How many zones it has.
    zones : sequence of geometries
        The part of them that lies on the map, in metres.
    grid : Grid
    """
    which = f"no cell is closed by --no-fly {name}: "
    if not zones:
        seen = "its no-fly zone does not lie" if number == 1 else f"none of its {number:,} no-fly zones lies"
        return f"{which}{seen} on the map: choose another --centre or another file"
    if (coverage(zones, grid) >= HALF).any():
        return None
    what = counted(len(zones), ("no-fly zone on the map covers", "no-fly zones on the map cover"))
    return f"{which}the {what} less than half of each cell of {grid.cell:g} m: choose a smaller --cell"
