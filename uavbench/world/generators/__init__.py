"""Generators of cities: a city is drawn from a key, as an episode is.

This module does not import Numba: scenarios, which name generators, must be quick to read.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.world.generators.parameters import CityParameters

#: The name and version of each generator, as scenarios write it, and what it draws. The cities of a name never change.
GENERATORS = {
    "blocks-v0": "a grid of straight streets, with squares and alleys",
    "courtyards-v0": "buildings with the shapes of O, U, L and T around yards",
    "organic-v0": "polygons between crooked streets",
    "campus-v0": "single rectangles in the open, turned by a few angles",
    "mixed-v0": "one of the other kinds, on large maps several in districts",
}
#: Shorter sides, longer sides and shorter reaches are refused.
SMALLEST_SIDE, LARGEST_SIDE, SMALLEST_REACH = 8, 1024, 4


def draw_cities(
    generator: str,
    keys: NDArray[np.uint64],
    parameters: CityParameters,
    reach: int,
    min_landing: int,
    min_places: int,
    out: NDArray[np.uint8],
) -> None:
    """Draw a city for each key. A city depends on the other arguments and its own key alone, not on the rest of the batch.

    For every key the following holds; where the parameters contradict it, they give way.

    - A scenario's map may be of this kind (`uavbench.world.maps.check_map`): landing cells can be reached from each other.
    - At least ``min_landing`` cells are landing cells.
    - All cells that can be flown over (free, landing, low building) can be reached from the landing cells, and at least 95 %
      of them in at most ``reach`` moves.
    - At least ``min_places`` cells are free or in no-fly zones, so that devices may stand there.

    Parameters
    ----------
    generator : str
        A name of `GENERATORS`.
    keys : ndarray of uint64, shape (K,)
        A key for each city.
    parameters : CityParameters
        What the cities look like.
    reach : int
        Moves from a landing cell, for example half of the largest budget; at least 4.
    min_landing, min_places : int
        See above; at least 1 and 0, together at most half of the cells.
    out : ndarray of uint8, shape (K, M, N)
        The codes of the cells (`uavbench.world.cells`) are written to it. Sides are 8 to 1024 cells long.

    Raises
    ------
    ValueError
        When an argument is outside of its bounds; the message names it.
    """
    if generator not in GENERATORS:
        raise ValueError(f"generator: {generator!r} is not one of {', '.join(GENERATORS)}")
    check_demands((out.shape[1], out.shape[2]) if out.ndim == 3 else (0, 0), reach, min_landing, min_places)
    _check_array("keys", keys, np.uint64, out.shape[:1])
    _check_array("out", out, np.uint8, out.shape)
    if not (out.flags.c_contiguous and out.flags.writeable):
        raise ValueError("out: the array must be contiguous and writeable")
    CityDrawer(generator, parameters, reach, min_landing, min_places).draw(np.ascontiguousarray(keys), out)


class CityDrawer:
    """Draws cities again and again with the same arguments; they are those of `draw_cities` and are not checked."""

    def __init__(self, generator: str, parameters: CityParameters, reach: int, min_landing: int, min_places: int) -> None:
        from uavbench.world.generators.drawing import draw_many

        self._draw_many: Any = draw_many
        self._kind, self._parameters = list(GENERATORS).index(generator), parameters.encoded()
        self._demands = int(reach), int(min_landing), int(min_places)

    def draw(self, keys: NDArray[np.uint64], out: NDArray[np.uint8]) -> None:
        """Draw a city for each of the contiguous ``keys``, shape (K,), and write its codes to ``out``, shape (K, M, N)."""
        self._draw_many(self._kind, keys, self._parameters, *self._demands, out)


def check_demands(shape: tuple[int, int], reach: int, min_landing: int, min_places: int) -> None:
    """Raise a ValueError that names the wrong argument if no city of this shape need have what is demanded.

    The arguments are those of `draw_cities`; ``shape`` is (M, N).
    """
    if not all(SMALLEST_SIDE <= side <= LARGEST_SIDE for side in shape):
        raise ValueError(f"shape: {shape[0]} × {shape[1]} cells: both sides must be {SMALLEST_SIDE} to {LARGEST_SIDE}")
    if reach < SMALLEST_REACH:
        raise ValueError(f"reach: {reach} moves are too few; at least {SMALLEST_REACH} are needed")
    if min_landing < 1:
        raise ValueError(f"min_landing: {min_landing} is too small; a city has at least 1 landing cell")
    if min_places < 0:
        raise ValueError(f"min_places: {min_places} is negative")
    if 2 * (min_landing + min_places) > shape[0] * shape[1]:
        raise ValueError(
            f"min_landing + min_places: {min_landing} + {min_places} cells are more than half of {shape[0]} × {shape[1]}"
        )


def _check_array(name: str, array: NDArray[Any], dtype: type, shape: tuple[int, ...]) -> None:
    """Raise a ValueError if an array does not have the wanted type and shape."""
    if array.dtype != dtype or array.shape != shape:
        raise ValueError(f"{name}: {array.dtype} of shape {array.shape}, expected {np.dtype(dtype)} of shape {shape}")
