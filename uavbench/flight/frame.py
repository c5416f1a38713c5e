"""From cells to metres and back: x goes east and y goes north from the middle of the map, rows go south and columns go east."""

import numpy as np
from numpy.typing import NDArray


def metres_of(cells: NDArray[np.float64], shape: tuple[int, int], cell: float) -> NDArray[np.float64]:
    """Return where places given as row and column are, in metres, shape (K, 2); whole numbers are the middles of cells.

    Parameters
    ----------
    cells : ndarray, shape (K, 2)
    shape : (int, int)
        Rows and columns of the map.
    cell : float
        Side of a cell in metres.
    """
    rows, cols = shape
    return np.column_stack([(cells[:, 1] + 0.5 - cols / 2) * cell, (rows / 2 - cells[:, 0] - 0.5) * cell])


def cells_of(metres: NDArray[np.float64], shape: tuple[int, int], cell: float) -> NDArray[np.float64]:
    """Return row and column, not rounded, of places in metres, shape (K, 2): the inverse of `metres_of`."""
    rows, cols = shape
    return np.column_stack([rows / 2 - metres[:, 1] / cell - 0.5, metres[:, 0] / cell + cols / 2 - 0.5])
