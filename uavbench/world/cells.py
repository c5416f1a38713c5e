"""The cells of a map: their codes, the characters that stand for them in text, and their colours in pictures of maps."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int]

#: The codes of the cells. A low building blocks sight like a building, but UAVs can fly over it.
FREE, LANDING, NO_FLY, BUILDING, LOW_BUILDING = range(5)
#: The character of each code.
CHARACTERS = ".LN#b"
#: The name of each code, as legends write it.
CELL_NAMES = ("free", "landing zone", "no-fly zone", "building", "low building")
#: The colour of each code: the colours of the paper's Table II, and a lighter grey for low buildings.
COLOURS: tuple[Colour, ...] = ((255, 255, 255), (150, 178, 228), (244, 176, 168), (96, 96, 104), (176, 176, 184))

_UNKNOWN = 255
_CODES = np.full(256, _UNKNOWN, dtype=np.uint8)
_CODES[np.frombuffer(CHARACTERS.encode(), dtype=np.uint8)] = range(len(CHARACTERS))
_CODES.flags.writeable = False


def cells_of(rows: Sequence[str]) -> NDArray[np.uint8]:
    """Return the codes of a map that is given as text, shape (M, N); the text must be a valid map."""
    text = np.frombuffer("".join(rows).encode(), dtype=np.uint8)
    return _CODES[text].reshape(len(rows), -1)


def rows_of(cells: NDArray[np.uint8]) -> tuple[str, ...]:
    """Return the text of a map that is given as codes, one text for each row."""
    text = np.frombuffer(CHARACTERS.encode(), dtype=np.uint8)[cells]
    return tuple(row.tobytes().decode() for row in text)
