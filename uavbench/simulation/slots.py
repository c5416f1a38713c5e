"""Copying slots of a batch out of the simulator's arrays and back: its methods ``get_state`` and ``set_state``."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavbench.world.episode import Columns


class SimulatorState(NamedTuple):
    """The state of some slots: copies that no simulator changes. It can be pickled.

    Attributes
    ----------
    digest : str
        The scenario's digest.
    arrays : dict of str to ndarray
        All arrays that change, each with one row for each of the slots.
    """

    digest: str
    arrays: Columns


def take(digest: str, arrays: Columns, index: ArrayLike | None) -> SimulatorState:
    """Return copies of the rows ``index`` of arrays that have a row for each slot; all rows if ``index`` is None."""
    if index is None:
        return SimulatorState(digest, {name: array.copy() for name, array in arrays.items()})
    slots = _slots(index)
    return SimulatorState(digest, {name: array[slots] for name, array in arrays.items()})


def put(state: SimulatorState, digest: str, arrays: Columns, index: ArrayLike | None) -> None:
    """Copy a state to the rows ``index`` of arrays; to all rows if ``index`` is None. When it raises, nothing is changed."""
    slots = slice(None) if index is None else _slots(index)
    wanted = len(arrays["key"][slots])  # raises an IndexError if there is no such slot
    if state.digest != digest:
        raise ValueError(f"state: it belongs to the scenario with the digest {state.digest[:12]}…, not {digest[:12]}…")
    for name in sorted(state.arrays.keys() | arrays.keys()):
        given, array = state.arrays.get(name), arrays.get(name)
        if given is None or array is None or given.dtype != array.dtype or given.shape[1:] != array.shape[1:]:
            raise ValueError(f"state: its {name} does not fit: another version of the suite or of the mission wrote it")
        if len(given) not in (1, wanted):
            raise ValueError(f"state: it holds {len(given)} slots, but is to be set in {wanted}")
    for name, array in arrays.items():
        array[slots] = state.arrays[name]


def _slots(index: ArrayLike) -> NDArray[np.integer]:
    """Return slots as an array."""
    slots = np.asarray(index)
    if slots.ndim != 1 or slots.dtype.kind not in "iu":
        raise ValueError(f"index: {slots.dtype} of shape {slots.shape}, expected integers, (number of slots,)")
    return slots
