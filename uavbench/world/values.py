"""Values that users hand over, read as plain integers, lists and arrays whatever library they come from, and named in messages.

Nothing here raises: a value that cannot be read is None, however it fails, and the caller says what was expected.
"""

import operator
import reprlib
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

_LONGEST = 120  # characters of a value in a message
_INTEGERS = (int, np.integer)  # made once: a union of types made at every call takes longer than the call
_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = _LONGEST // 2
_REPR.maxlevel = 3


def as_integer(value: object) -> int | None:
    """Return an integer as an int; None for anything else, booleans and arrays with a dimension included.

    An integer of Python or NumPy counts, and an array of integers without a dimension: ``np.array(3)``, ``torch.tensor(3)``.
    """
    if isinstance(value, _INTEGERS) and not isinstance(value, bool):
        return int(cast("Any", value))
    try:
        given: Any = value
        if isinstance(value, bool) or tuple(getattr(given, "shape", ())) or "bool" in str(getattr(given, "dtype", "")):
            return None  # PyTorch calls an array of one element an integer, and a boolean too
        return operator.index(given)
    except Exception:
        return None


def as_list(value: object) -> list[Any] | None:
    """Return the items of a sequence or the rows of an array; None for anything else, text included."""
    try:
        given: Any = value
        if getattr(given, "ndim", 0) > 0 or (isinstance(value, Sequence) and not isinstance(value, str | bytes)):
            return list(given)
    except Exception:
        return None
    return None


def as_array(value: object) -> NDArray[Any] | None:
    """Return numbers or booleans as an array of bool, integers or float64; None where they are none, or of no common shape."""
    try:
        array = np.asarray(value)
        if array.dtype.kind == "f":
            with np.errstate(over="ignore"):
                return array.astype(np.float64)
    except Exception:
        return None
    return array if array.dtype.kind in "biu" else None


def shown(value: object) -> str:
    """Return how a message names a value: its representation on one line, cut where it is long; its type if it has none."""
    try:
        text = " ".join(_REPR.repr(value).split())
    except Exception:
        text = f"an object of type {type(value).__name__}"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
