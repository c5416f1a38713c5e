"""The kernels that draw one city or many: buildings of a kind, then all that cities of all kinds have."""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import FREE
from uavbench.world.generators.canvas import Canvas, fill, new_canvas
from uavbench.world.generators.finish import finish
from uavbench.world.generators.mixed import MIXED, draw_kind, draw_mixed
from uavbench.world.kernel import kernel
from uavbench.world.keyed import CITY, next_uniform, stream


@kernel
def draw_city(
    kind: int,
    key: np.uint64,
    parameters: NDArray[np.float64],
    reach: int,
    min_landing: int,
    min_places: int,
    canvas: Canvas,
) -> None:
    """Draw the city of a key on a canvas; see `draw_many`."""
    rows, cols = canvas.city.shape[0] - 2, canvas.city.shape[1] - 2
    window = (1, 1, rows + 1, cols + 1)
    fill(canvas.city, window, FREE)
    cursor = np.empty(1, dtype=np.uint64)
    cursor[0] = stream(key, CITY)
    wanted = int(next_uniform(cursor, parameters[0], parameters[1]) * (rows * cols))
    if kind == MIXED:
        draw_mixed(cursor, canvas, window, wanted)
    else:
        draw_kind(kind, cursor, canvas, window, wanted)
    finish(cursor, canvas, parameters, reach, min_landing, min_places)


@kernel
def draw_many(
    kind: int,
    keys: NDArray[np.uint64],
    parameters: NDArray[np.float64],
    reach: int,
    min_landing: int,
    min_places: int,
    out: NDArray[np.uint8],
) -> None:
    """Draw the cities of many keys.

    Parameters
    ----------
    kind : int
        The place of the generator in `uavbench.world.generators.GENERATORS`.
    keys : ndarray of uint64, shape (K,)
        A key for each city.
    parameters : ndarray of float64, shape (12,)
        See `uavbench.world.generators.parameters.CityParameters.encoded`.
    reach, min_landing, min_places : int
        See `uavbench.world.generators.draw_cities`.
    out : ndarray of uint8, shape (K, M, N)
        The cities are written to it.
    """
    rows, cols = out.shape[1:]
    canvas = new_canvas(rows, cols)
    for k in range(len(keys)):
        draw_city(kind, keys[k], parameters, reach, min_landing, min_places, canvas)
        for r in range(rows):
            out[k, r] = canvas.city[r + 1, 1 : cols + 1]
