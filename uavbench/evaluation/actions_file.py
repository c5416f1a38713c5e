"""``actions.npz``: the actions of whole episodes, as results, submissions and the best known flights keep them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uavbench.errors import one_line
from uavbench.world.files import FileError, pack_arrays, read_bounded, unpack_arrays

#: The file's name in the folder of a result.
ACTIONS = "actions.npz"
#: The size of the largest file that is read; for the paper's scenarios one takes 0.2 MB.
ACTIONS_BYTES = 2**26


def pack_actions(numbers: Sequence[int], flights: Sequence[NDArray[np.uint8]]) -> bytes:
    """Return the bytes of a file.

    Parameters
    ----------
    numbers : sequence of int
        The episodes' numbers.
    flights : sequence of ndarray of uint8
        The actions of each, shape (T, U), as in `EpisodeRecord`.
    """
    offsets = np.cumsum([0, *(len(flight) for flight in flights)])
    arrays = {"actions": np.concatenate(flights), "offsets": offsets, "episodes": np.array(numbers)}
    return pack_arrays(arrays, compress=True)


def read_actions(path: Path, episodes: int) -> dict[int, NDArray[np.uint8]]:
    """Return the actions of each episode in a file, by its number.

    Raises
    ------
    FileError
        When the file is damaged, or does not hold so many episodes.
    """
    try:
        table = unpack_arrays(read_bounded(path, ACTIONS_BYTES), ACTIONS_BYTES)
        if table.keys() != {"actions", "offsets", "episodes"}:
            raise ValueError("its arrays are not actions, offsets and episodes")
        if table["episodes"].shape != (episodes,) or table["offsets"].shape != (episodes + 1,):
            raise ValueError(f"does not hold {episodes} episodes")
        if {table[name].dtype.kind for name in ("offsets", "episodes")} != {"i"}:
            raise ValueError("its offsets and episodes are no signed integers")
        actions = table["actions"].astype(np.uint8, casting="equiv")
        offsets = table["offsets"].astype(np.int64, casting="same_kind")
        if offsets[0] != 0 or offsets[-1] != len(actions) or (offsets[1:] < offsets[:-1]).any():
            raise ValueError("its offsets do not cut the actions into episodes")
        parts = np.split(actions, offsets[1:-1])
        return dict(zip(table["episodes"].tolist(), parts, strict=True))
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise FileError(f"{path}: damaged: {one_line(error)}") from None
