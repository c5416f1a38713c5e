"""What the state keeps of a target map, so that the observation need not look at every cell of it.

The observation's global map is the means of g×g blocks (paper eq. 10). Where the blocks begin depends on the UAV's cell: there
are g×g phases. Three ways to know the sum of a block, of which a mission's parameters name one (``pooling``):

- ``"counts"``, for many targets that are 1 or 0, as in CPP: the numbers of targets in all blocks of all phases. To take a
  target away changes one block of each phase.
- ``"spots"``, for few targets of any value, as in DH: a list of their cells.
- ``"map"``: nothing is kept. The observation adds up the whole map, which is slow and always right.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.world.kernel import kernel


def new_counts(slots: int, shape: tuple[int, int], scale: int) -> NDArray[Any]:
    """Return the counts of empty target maps.

    Returns
    -------
    ndarray of uint8, uint16 or uint32, shape (slots, g, H, g, W)
        ``counts[i, p, y, q, x]`` is the number of targets in the block of rows y · g − p to y · g − p + g − 1 and columns
        x · g − q to x · g − q + g − 1, as far as they are on the map.
    """
    high, wide = ((side + 2 * scale - 2) // scale for side in shape)
    size = np.uint8 if scale < 16 else np.uint16 if scale < 256 else np.uint32
    return np.zeros((slots, scale, high, scale, wide), dtype=size)


@kernel
def remove_target(counts: NDArray[Any], r: int, c: int) -> None:
    """Take the target in cell (r, c) out of the counts of one map, shape (g, H, g, W)."""
    scale = counts.shape[0]
    y, x = r // scale, c // scale
    low, right = scale - (r - y * scale), scale - (c - x * scale)  # from these phases on, the cell is in the next block
    for p in range(scale):
        blocks = counts[p, y + (p >= low)]
        for q in range(scale):
            blocks[q, x + (q >= right)] -= 1


@kernel
def count_targets(target: NDArray[np.float32], counts: NDArray[Any]) -> None:
    """Count the targets of one map, shape (M, N), whose cells are 1 or 0: of g rows first, then in the blocks of g columns."""
    rows, cols = target.shape
    scale, high, _, wide = counts.shape
    column = np.zeros((wide + 1) * scale, dtype=counts.dtype)  # of the block's rows, with margins in which there is nothing
    block = np.zeros(wide * scale, dtype=counts.dtype)  # from every column on, the first of them scale - 1 before the map
    inner = column[scale : scale + cols]
    for top in range(1 - scale, high * scale - scale + 1):  # the first row of a block, possibly above the map
        if top + scale <= rows:
            _add(target[top + scale - 1], inner)
        if 0 < top <= rows:
            _subtract(target[top - 1], inner)
        block[:] = 0
        for k in range(1, scale + 1):
            _add(column[k : k + len(block)], block)
        y = (top + scale - 1) // scale
        phase = counts[y * scale - top, y]
        for q in range(scale):
            blocks, place = phase[q], np.uint64(scale - 1 - q)
            for x in range(wide):
                blocks[x] = block[place]
                place += np.uint64(scale)


@kernel
def block_sum(target: NDArray[np.float32], top: int, left: int, scale: int) -> np.float32:
    """Return the sum of the g×g block that begins in cell (top, left), column by column, as far as it is on the map."""
    rows, cols = target.shape
    total = np.float32(0.0)
    for c in range(max(0, left), min(cols, left + scale)):
        column = np.float32(0.0)
        for r in range(max(0, top), min(rows, top + scale)):
            column += target[r, c]
        total += column
    return total


@kernel
def find_targets(target: NDArray[np.float32], spots: NDArray[np.int32]) -> int:
    """List the cells of one map that are not 0 in ``spots``, shape (K, 2), and return how many they are."""
    number = 0
    for r in range(target.shape[0]):
        for c in range(target.shape[1]):
            if target[r, c] != 0.0:
                spots[number, 0], spots[number, 1] = r, c
                number += 1
    return number


@kernel
def _add(source: NDArray[Any], target: NDArray[Any]) -> None:
    """Add a row to another; a plain loop over slices is what LLVM vectorises best."""
    for x in range(len(target)):
        target[x] += source[x]


@kernel
def _subtract(source: NDArray[Any], target: NDArray[Any]) -> None:
    """Subtract a row from another."""
    for x in range(len(target)):
        target[x] -= source[x]
