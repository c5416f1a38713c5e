"""What the camera sees from a cell, without casting a ray to every border cell of the map.

The camera sees at most three cells beyond its UAV, and there the many rays of `uavbench.world.city.mark_visible` share a few
beginnings. Consider the rays to one quarter of the map, as steps along x and y. A ray whose target is dx columns and dy rows
away, and which has taken i steps in x and j steps in y, takes its next step in x if (4j + 3) · dx > (4i + 3) · dy: this follows
from the error term of the ray. So the beginnings form a tree whose nodes are lists of steps. The tree depends only on how far
away the borders of the map are in this quarter, and from some distance on (`_FAR`) it is always the same. The trees are
computed once. To see means to walk along four of them, and to leave out the branches behind a building.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbench.world.kernel import kernel

#: From how many cells to the border on, more cells do not change the tree; by how far the camera sees.
_FAR = {0: 0, 1: 2, 2: 5, 3: 12}


_Path = tuple[tuple[int, int], ...]  # the cells on a ray after its UAV's, as rows and columns from there


class Trees(NamedTuple):
    """The trees for a camera that sees so many cells beyond its UAV, as arrays for kernels.

    Attributes
    ----------
    first : ndarray of int32, shape (F + 1, F + 1, 2)
        Where the nodes of a tree begin and end, by the distance to the border in rows and in columns, each at most F.
    onward : ndarray of int32, shape (K,)
        For each node of all trees, the index of the first later node that is not behind this one. A node comes before its
        branches.
    offsets : ndarray of int32, shape (4, K)
        For each quarter of the map, how far the node's cell is from the UAV's in a flattened map.
    bits : ndarray of uint64, shape (4, K)
        For each quarter, the bit of the node's cell in a view.
    """

    first: NDArray[np.int32]
    onward: NDArray[np.int32]
    offsets: NDArray[np.int32]
    bits: NDArray[np.uint64]


@lru_cache
def trees_of(reach: int, width: int) -> Trees:
    """Return the trees for a camera that sees ``reach`` cells beyond its UAV, on a map whose rows are ``width`` cells apart."""
    far, side = _FAR[reach], 2 * reach + 1
    first: NDArray[np.int32] = np.zeros((far + 1, far + 1, 2), dtype=np.int32)
    cells: list[tuple[int, int]] = []
    onward: list[int] = []
    for down, right in np.ndindex(far + 1, far + 1):
        paths = sorted(_beginnings(down, right, reach))
        start = len(cells)
        for k, path in enumerate(paths):  # sorted: all paths that begin with this one follow it
            onward.append(start + next((m for m in range(k + 1, len(paths)) if paths[m][: len(path)] != path), len(paths)))
            cells.append(path[-1])
        first[down, right] = start, len(cells)
    steps = np.array(cells, dtype=np.int64).reshape(-1, 2)
    quarters = [steps * (1 if q & 1 else -1, 1 if q & 2 else -1) for q in range(4)]
    offsets = np.array([each @ (width, 1) for each in quarters], dtype=np.int32)
    places = np.array([(each + reach) @ (side, 1) for each in quarters], dtype=np.uint64)
    found = Trees(first, np.array(onward, dtype=np.int32), offsets, np.uint64(1) << places)
    for array in found:
        array.flags.writeable = False
    return found


def _beginnings(down: int, right: int, reach: int) -> set[_Path]:
    """Return all beginnings of the rays to a quarter of the map that has so many more rows and columns."""
    targets = [(down, x) for x in range(right + 1)] + [(y, right) for y in range(down + 1)]
    found: set[_Path] = set()
    for dy, dx in targets:
        path: list[tuple[int, int]] = []
        i = j = 0  # steps along x and y
        while i + j < dx + dy:
            along = (4 * j + 3) * dx > (4 * i + 3) * dy
            i, j = (i + 1, j) if along else (i, j + 1)
            if max(i, j) > reach:
                break
            path.append((j, i))
            found.add(tuple(path))
    return found


@kernel
def view_from(
    ground: NDArray[np.uint8],
    building: int,
    cell: int,
    far_row: int,
    far_col: int,
    r: int,
    c: int,
    reach: int,
    first: NDArray[np.int32],
    onward: NDArray[np.int32],
    offsets: NDArray[np.int32],
    bits: NDArray[np.uint64],
) -> np.uint64:
    """Return what the camera sees from the cell (r, c), as the bits that `camera_views` describes.

    ``ground`` holds maps, flattened, whose cells have the bit ``building`` where a building is; the cell has the index ``cell``
    in it. ``far_row`` and ``far_col`` are the last row and column of the map. Rays end at the border, so nothing beyond it is
    looked at.
    """
    far = first.shape[0] - 1
    middle = np.uint64(2 * reach * (reach + 1))
    view = np.uint64(0) if ground[cell] & building else np.uint64(1) << middle
    for quarter in range(4):
        down, right = (far_row - r if quarter & 1 else r), (far_col - c if quarter & 2 else c)
        node, last = first[min(down, far), min(right, far)]
        there, marks = offsets[quarter], bits[quarter]
        while node < last:
            if ground[cell + there[node]] & building:
                node = onward[node]
            else:
                view |= marks[node]
                node += 1
    return view


@kernel
def views_from_all(
    building: NDArray[np.uint8],
    reach: int,
    first: NDArray[np.int32],
    onward: NDArray[np.int32],
    offsets: NDArray[np.int32],
    bits: NDArray[np.uint64],
) -> NDArray[np.uint64]:
    """Return what the camera sees from every cell of a map of 0 and 1 (building), shape (M, N): see `view_from`."""
    rows, cols = building.shape
    views, flat = np.empty((rows, cols), dtype=np.uint64), building.reshape(-1)
    for r in range(rows):
        for c in range(cols):
            views[r, c] = view_from(flat, 1, r * cols + c, rows - 1, cols - 1, r, c, reach, first, onward, offsets, bits)
    return views
