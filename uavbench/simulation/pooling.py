"""What the state keeps besides the target map, so that the observation need not read every cell of the map.

The observation's global map holds the means of g×g blocks (paper eq. 13). Where the blocks begin depends on the UAV's cell;
there are g×g possibilities, called phases. There are three ways to get the sum of a block, and a mission's parameters name one
of them (``pooling``):

- ``"counts"``, for many targets that are 1 or 0, as in CPP: the state keeps the number of targets in each block of each phase.
  When a target is removed, one block of each phase changes.
- ``"spots"``, for few targets of any value, as in DH: the state keeps a list of their cells.
- ``"map"``: the state keeps nothing. The observation adds up the whole map, which is slow but works for every mission.
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
        x · g − q to x · g − q + g − 1, without the cells off the map.
    """
    high, wide = ((side + 2 * scale - 2) // scale for side in shape)
    size = np.uint8 if scale < 16 else np.uint16 if scale < 256 else np.uint32
    return np.zeros((slots, scale, high, scale, wide), dtype=size)


@kernel
def remove_target(counts: NDArray[Any], r: int, c: int) -> None:
    """Remove the target in cell (r, c) from the counts of one map, shape (g, H, g, W)."""
    scale = counts.shape[0]
    y, x = r // scale, c // scale
    low, right = scale - (r - y * scale), scale - (c - x * scale)  # in these and higher phases the cell is in the next block
    for p in range(scale):
        blocks = counts[p, y + (p >= low)]
        for q in range(scale):
            blocks[q, x + (q >= right)] -= 1


@kernel
def count_targets(target: NDArray[Any], counts: NDArray[Any]) -> None:
    """Count the targets of one map, shape (M, N), whose cells are 1 or 0."""
    scale, high, _, wide = counts.shape
    sums = np.zeros((high * scale, wide * scale), dtype=counts.dtype)
    sum_blocks(target, scale, sums)
    for top in range(high * scale):
        y = top // scale
        phase = counts[(y + 1) * scale - 1 - top, y]
        for q in range(scale):
            blocks, block, place = phase[q], sums[top], np.uint64(scale - 1 - q)
            for x in range(wide):
                blocks[x] = block[place]
                place += np.uint64(scale)


@kernel
def sum_blocks(target: NDArray[Any], scale: int, sums: NDArray[Any]) -> None:
    """Count the targets in all blocks of one map: over g rows first, then over g columns.

    Parameters
    ----------
    target : ndarray, shape (M, N)
        The map; its cells are 1 or 0.
    scale : int
        The number g of rows and columns of a block.
    sums : ndarray, shape (g H, g W)
        Zeros, to which the counts are added. The first block begins g − 1 rows above the map, and g − 1 columns before it; each
        other one begins in the next row or column.
    """
    rows, cols = target.shape
    column = np.zeros(sums.shape[1] + scale, dtype=sums.dtype)  # the sums over g rows in each column, with margins of zeros
    inner = column[scale : scale + cols]
    for bottom in range(len(sums)):
        if bottom < rows:
            _add(target[bottom], inner)
        if scale <= bottom < rows + scale:
            _subtract(target[bottom - scale], inner)
        for k in range(1, scale + 1):
            _add(column[k : k + sums.shape[1]], sums[bottom])


@kernel
def block_sum(target: NDArray[np.float32], top: int, left: int, scale: int) -> np.float32:
    """Return the sum of the g×g block that begins at cell (top, left), column by column, without the cells off the map."""
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
    """Write the cells of one map that are not 0 to ``spots``, shape (K, 2), and return their number."""
    number = 0
    for r in range(target.shape[0]):
        for c in range(target.shape[1]):
            if target[r, c] != 0.0:
                spots[number, 0], spots[number, 1] = r, c
                number += 1
    return number


@kernel
def _add(source: NDArray[Any], target: NDArray[Any]) -> None:
    """Add a row to another; LLVM vectorises a plain loop over slices best."""
    for x in range(len(target)):
        target[x] += source[x]


@kernel
def _subtract(source: NDArray[Any], target: NDArray[Any]) -> None:
    """Subtract a row from another."""
    for x in range(len(target)):
        target[x] -= source[x]
