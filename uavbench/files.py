"""Files of arrays: the same arrays give the same bytes, and a file is written whole or not at all."""

import io
import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def pack_arrays(arrays: Mapping[str, NDArray[Any]], *, compress: bool = False) -> bytes:
    """Return the bytes of an ``.npz`` file of ``arrays``, in alphabetical order and without pickles."""
    buffer = io.BytesIO()
    save = np.savez_compressed if compress else np.savez
    save(buffer, allow_pickle=False, **{name: arrays[name] for name in sorted(arrays)})
    return buffer.getvalue()


def unpack_arrays(content: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz`` file.

    Raises
    ------
    ValueError
        When the bytes are not such a file.
    """
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as table:
            return {name: table[name] for name in table.files}
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, KeyError, AttributeError, NotImplementedError) as error:
        raise ValueError(f"not an .npz file: {error}") from None


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that it is there as a whole, or as it was before, whatever happens meanwhile."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
