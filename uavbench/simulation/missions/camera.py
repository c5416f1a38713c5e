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
    """The trees for a camera that sees ``reach`` cells beyond its UAV, as arrays for kernels.

    Attributes
    ----------
    first : ndarray of int32, shape (F + 1, F + 1, 2)
        Where the nodes of a tree begin and end, by the distance to the border in rows and in columns, each at most F.
    nodes : ndarray of int32, shape (K, 3)
        The nodes of all trees, each before its branches: rows and columns from the UAV to the node's cell, and the index of
        the first later node that is not behind this one.
    """

    first: NDArray[np.int32]
    nodes: NDArray[np.int32]


@lru_cache
def trees_of(reach: int) -> Trees:
    """Return the trees for a camera that sees ``reach`` cells beyond its UAV."""
    far = _FAR[reach]
    first: NDArray[np.int32] = np.zeros((far + 1, far + 1, 2), dtype=np.int32)
    nodes: list[tuple[int, int, int]] = []
    for down, right in np.ndindex(far + 1, far + 1):
        paths = sorted(_beginnings(down, right, reach))
        start = len(nodes)
        for k, path in enumerate(paths):  # sorted: all paths that begin with this one follow it
            skip = next((m for m in range(k + 1, len(paths)) if paths[m][: len(path)] != path), len(paths))
            nodes.append((*path[-1], start + skip))
        first[down, right] = start, len(nodes)
    found = Trees(first, np.array(nodes, dtype=np.int32).reshape(-1, 3))
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
    building: NDArray[np.bool_], margin: int, r: int, c: int, reach: int, first: NDArray[np.int32], nodes: NDArray[np.int32]
) -> np.uint64:
    """Return what the camera sees from the cell (r, c), as the bits that `camera_views` describes.

    ``building`` is the layer with a margin of so many cells on each side. The margin is never looked at, because rays end at
    the border.
    """
    rows, cols = building.shape[0] - 2 * margin, building.shape[1] - 2 * margin
    side, far = 2 * reach + 1, first.shape[0] - 1
    view = np.uint64(0)
    if not building[r + margin, c + margin]:
        view |= np.uint64(1) << np.uint64(reach * side + reach)
    for quarter in range(4):
        down, right = (1 if quarter & 1 else -1), (1 if quarter & 2 else -1)
        to_row, to_col = (rows - 1 - r if down > 0 else r), (cols - 1 - c if right > 0 else c)
        node, last = first[min(to_row, far), min(to_col, far)]
        while node < last:
            y, x = down * nodes[node, 0], right * nodes[node, 1]
            if building[r + y + margin, c + x + margin]:
                node = nodes[node, 2]
            else:
                view |= np.uint64(1) << np.uint64((y + reach) * side + x + reach)
                node += 1
    return view


@kernel
def views_from_all(
    building: NDArray[np.bool_], margin: int, reach: int, first: NDArray[np.int32], nodes: NDArray[np.int32]
) -> NDArray[np.uint64]:
    """Return what the camera sees from every cell, shape (M, N): see `view_from`."""
    rows, cols = building.shape[0] - 2 * margin, building.shape[1] - 2 * margin
    views = np.empty((rows, cols), dtype=np.uint64)
    for r in range(rows):
        for c in range(cols):
            views[r, c] = view_from(building, margin, r, c, reach, first, nodes)
    return views
