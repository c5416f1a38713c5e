"""The kernel that draws cities: buildings of a kind, then all that cities of all kinds have."""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import FREE
from uavbench.world.generators.canvas import fill, new_canvas
from uavbench.world.generators.finish import finish
from uavbench.world.generators.mixed import draw_buildings
from uavbench.world.generators.share import correct_share
from uavbench.world.kernel import kernel
from uavbench.world.keyed import CITY, next_uniform, stream


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
    """Draw a city for each key.

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
    cursor = np.empty(1, dtype=np.uint64)
    for k in range(len(keys)):
        fill(canvas.city, (1, 1, rows + 1, cols + 1), FREE)
        cursor[0] = stream(keys[k], CITY)
        wanted = int(next_uniform(cursor, parameters[0], parameters[1]) * (rows * cols))
        draw_buildings(kind, cursor, canvas, wanted)
        correct_share(cursor, canvas, wanted)
        finish(cursor, canvas, parameters, reach, min_landing, min_places)
        for r in range(rows):
            out[k, r] = canvas.city[r + 1, 1 : cols + 1]
