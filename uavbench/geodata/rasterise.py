"""From polygons to cells: how much of each cell is covered, computed exactly."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.geodata.libraries import Geometry, library
from uavbench.world.cells import BUILDING, FREE, LOW_BUILDING, NO_FLY

_BLOCK = 64  # cells that are intersected at once
_NEARLY = 1e-9  # of a cell: a cell of which exactly one half is covered counts, whatever the rounding
#: The part of a cell that is covered if the cell counts as covered.
HALF = 0.5 - _NEARLY


class Grid(NamedTuple):
    """The cells of a map around (0, 0): rows go south, columns go east.

    Attributes
    ----------
    rows, cols : int
    cell : float
        Side of a cell in metres.
    """

    rows: int
    cols: int
    cell: float

    @property
    def west(self) -> float:
        """The x of the western edge."""
        return -self.cols * self.cell / 2

    @property
    def north(self) -> float:
        """The y of the northern edge."""
        return self.rows * self.cell / 2

    def box(self, top: int, left: int, bottom: int, right: int) -> Geometry:
        """Return the rectangle of the rows ``top`` to ``bottom`` and columns ``left`` to ``right``, without the last ones."""
        west, north = self.west, self.north
        return library("shapely").box(
            west + left * self.cell, north - bottom * self.cell, west + right * self.cell, north - top * self.cell
        )


def cells(high: Sequence[Geometry], low: Sequence[Geometry], no_fly: Sequence[Geometry], grid: Grid) -> NDArray[np.uint8]:
    """Return the codes of a map's cells, shape (M, N), without landing zones.

    A cell is a building if buildings cover at least half of it: a building that blocks flight if those higher than the altitude
    cover half of it already, and else a low one. A cell is no-fly if no-fly zones cover at least half of it. A low building in
    a no-fly zone cannot be flown over, so it becomes one that blocks flight.

    Parameters
    ----------
    high, low : sequence of shapely.Polygon or shapely.MultiPolygon
        The buildings that are higher than the altitude, and the others, in metres.
    no_fly : sequence of shapely.Polygon or shapely.MultiPolygon
        The no-fly zones, in metres.
    grid : Grid
    """
    closed = coverage(no_fly, grid) >= HALF
    tall = coverage(high, grid) >= HALF
    built = coverage([*high, *low], grid) >= HALF
    codes = np.full((grid.rows, grid.cols), FREE, dtype=np.uint8)
    codes[closed] = NO_FLY
    codes[built] = LOW_BUILDING
    codes[tall | (built & closed)] = BUILDING
    return codes


def coverage(shapes: Sequence[Geometry], grid: Grid) -> NDArray[np.float64]:
    """Return which part of each cell the shapes cover together, in [0, 1], shape (M, N)."""
    shapely = library("shapely")
    covered = np.zeros((grid.rows, grid.cols))
    if len(shapes):
        window = grid.box(0, 0, grid.rows, grid.cols)
        together = shapely.union_all(shapely.intersection(np.array(shapes, dtype=object), window))
        _cover(together, grid, (0, 0, grid.rows, grid.cols), covered)
    return covered


def _cover(shape: Geometry, grid: Grid, block: tuple[int, int, int, int], covered: NDArray[np.float64]) -> None:
    """Write the coverage of a block of cells, which is halved until it is small, empty or full. ``shape`` lies in the block."""
    shapely = library("shapely")
    top, left, bottom, right = block
    rows, cols = bottom - top, right - left
    area = shape.area / grid.cell**2
    if area <= _NEARLY:
        return
    if area >= rows * cols - _NEARLY:
        covered[top:bottom, left:right] = 1
    elif rows * cols <= _BLOCK:
        r, c = np.mgrid[top:bottom, left:right]
        west, north = grid.west + c * grid.cell, grid.north - r * grid.cell
        boxes = shapely.box(west, north - grid.cell, west + grid.cell, north)
        covered[top:bottom, left:right] = shapely.area(shapely.intersection(shape, boxes)) / grid.cell**2
    else:
        if rows >= cols:
            halves = [(top, left, top + rows // 2, right), (top + rows // 2, left, bottom, right)]
        else:
            halves = [(top, left, bottom, left + cols // 2), (top, left + cols // 2, bottom, right)]
        for half in halves:
            _cover(shapely.intersection(shape, grid.box(*half)), grid, half, covered)
