"""Maps as text, arrays and pictures: reading them, and refusing those that cannot be flown.

A map in a scenario is text, one row of characters for each row of cells: see `uavbench.world.cells`. In a picture of a map, one
pixel is one cell, in the colours of the same page; `uavbench show --save` writes such pictures.
"""

import io
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavbench.errors import one_line
from uavbench.world.cells import CELL_NAMES, CHARACTERS, COLOURS, FREE, LANDING, LOW_BUILDING, rows_of
from uavbench.world.files import read_bounded, read_text

SMALLEST_SIDE, LARGEST_SIDE = 4, 1024
_MAP_BYTES = 2**22  # more than the largest map takes as text, and more than one takes as a picture
_CELLS = "'.', 'L', 'N', '#' or 'b'"
_MEANING = ", ".join(f"{code} {name}" for code, name in enumerate(CELL_NAMES))


def check_map(rows: tuple[str, ...]) -> None:
    """Raise a ValueError if a map has unequal rows, a wrong size, unknown cells, or no or an unreachable landing cell."""
    check_shape((len(rows), len(rows[0]) if rows else 0))
    for r, row in enumerate(rows):
        if len(row) != len(rows[0]):
            raise ValueError(f"row {r} has {len(row)} cells, row 0 has {len(rows[0])}: all rows must be of one length")
        if not row.isprintable():
            raise ValueError(f"this is no map: write rows of {_CELLS}, as text")
        unknown = row.strip(CHARACTERS)
        if unknown:
            raise ValueError(f"row {r}, column {row.index(unknown)}: unknown cell {unknown[0]!r}; use {_CELLS}")
    _check_landing(rows)


def check_shape(shape: tuple[int, int]) -> None:
    """Raise a ValueError if a map of this shape would be too small or too large."""
    if not all(SMALLEST_SIDE <= side <= LARGEST_SIDE for side in shape):
        raise ValueError(f"{shape[0]} rows × {shape[1]} columns: both must be {SMALLEST_SIDE} to {LARGEST_SIDE}")


def _check_landing(rows: tuple[str, ...]) -> None:
    """Raise a ValueError if there is no landing cell, or one that cannot be reached from the others or not be left."""
    wide, cells = len(rows[0]) + 1, "".join(f"{row}#" for row in rows)  # the added column keeps the rows apart
    landing = [cell for cell, kind in enumerate(cells) if kind == CHARACTERS[LANDING]]
    if not landing:
        raise ValueError("there is no landing cell: mark at least one cell with 'L'")
    open_cells = bytearray(kind in (CHARACTERS[FREE], CHARACTERS[LANDING], CHARACTERS[LOW_BUILDING]) for kind in cells)
    open_cells.extend(bytes(wide))  # below the last row; a negative index is there, too
    queue, reached = deque([landing[0]]), 1
    open_cells[landing[0]] = 0
    while queue:
        cell = queue.popleft()
        for near in (cell - wide, cell + 1, cell + wide, cell - 1):
            if open_cells[near]:
                open_cells[near] = 0
                queue.append(near)
                reached += 1
    first = divmod(landing[0], wide)
    apart = [cell for cell in landing if open_cells[cell]]
    if reached == len(landing) - len(apart):
        raise ValueError(f"the landing zone at {first} is unreachable: no free cell leads to it")
    if apart:
        raise ValueError(f"the landing cell {divmod(apart[0], wide)} is unreachable from the landing cell {first}")


def rows_of_array(cells: ArrayLike) -> tuple[str, ...]:
    """Return the text of a map that is given as an array of characters or of codes, or as texts; it may still be invalid.

    Raises
    ------
    ValueError
        When the array holds numbers that are no codes of cells, or is not two-dimensional.
    """
    try:
        array: NDArray[Any] = np.asarray(cells)
    except ValueError:
        raise ValueError("its rows have different lengths") from None
    if not array.size or not array.ndim:
        raise ValueError("there are no cells: give the rows of a map, as texts or as an array")
    if array.dtype.kind == "O" and all(isinstance(cell, (int, np.integer)) for cell in array.flat):
        array = array.astype(np.int64)
    if array.dtype.kind in "biuf":
        if array.ndim != 2:
            raise ValueError(f"an array of shape {array.shape}: expected the codes of cells, shape (rows, columns)")
        wrong = np.argwhere(~np.isin(array, range(len(CHARACTERS))))
        if len(wrong):
            r, c = wrong[0].tolist()
            raise ValueError(f"row {r}, column {c}: {array[r, c]} is no code of a cell; the codes are {_MEANING}")
        return rows_of(array.astype(np.uint8))
    return tuple("".join(str(cell) for cell in row) for row in array.tolist())


def read_map(path: Path) -> tuple[str, ...]:
    """Return the text of the map in a text file, or in a PNG picture, which may still be invalid.

    Raises
    ------
    FileError
        When the file cannot be read.
    ValueError
        When a picture is damaged, is too large, or has a pixel in another colour than those of cells.
    """
    if path.suffix.lower() != ".png":
        return tuple(read_text(path, _MAP_BYTES).rstrip().split("\n"))
    pixels = _read_picture(path)
    known = np.array(COLOURS, dtype=np.int32)
    packed = pixels.astype(np.int32) @ (65536, 256, 1)
    codes = np.full(packed.shape, len(known), dtype=np.uint8)
    for code, colour in enumerate((known @ (65536, 256, 1)).tolist()):
        codes[packed == colour] = code
    wrong = np.argwhere(codes == len(known))
    if len(wrong):
        r, c = wrong[0].tolist()
        colours = ", ".join(f"{name} {_hex(colour)}" for name, colour in zip(CELL_NAMES, COLOURS, strict=True))
        raise ValueError(f"the pixel in row {r}, column {c} is {_hex(pixels[r, c].tolist())}, the colour of no cell: {colours}")
    return rows_of(codes)


def map_picture(cells: NDArray[np.uint8]) -> bytes:
    """Return a PNG picture of a map that is given as codes, with one pixel for each cell: `read_map` reads it."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(np.array(COLOURS, dtype=np.uint8)[cells]).save(buffer, format="PNG")
    return buffer.getvalue()


def _read_picture(path: Path) -> NDArray[np.uint8]:
    """Return the pixels of a PNG picture, shape (M, N, 3)."""
    from PIL import Image, UnidentifiedImageError

    content = read_bounded(path, _MAP_BYTES)
    try:
        with Image.open(io.BytesIO(content), formats=["PNG"]) as picture:
            check_shape((picture.height, picture.width))  # before anything is unpacked
            pixels = np.asarray(picture.convert("RGBA"))
    except UnidentifiedImageError:
        raise ValueError("this is no PNG picture, whatever its name says") from None
    except ValueError:
        raise
    except Exception as error:
        raise ValueError(f"this is a damaged PNG picture: {one_line(error)}") from None
    clear = np.argwhere(pixels[..., 3] < 255)
    if len(clear):
        r, c = clear[0].tolist()
        raise ValueError(f"the pixel in row {r}, column {c} is transparent: save the picture without transparency")
    return pixels[..., :3]


def _hex(colour: Any) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)
