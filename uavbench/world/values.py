"""Reading the values that users pass, from any library, as plain integers, lists and arrays, and showing them in messages.

Nothing here raises: a value that cannot be read becomes None, and the caller says what was expected.
"""

import operator
import reprlib
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

_LONGEST = 120  # characters of a value in a message
_INTEGERS = (int, np.integer)  # built once: building a union of types at every call would take longer than the check
_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = _LONGEST // 2
_REPR.maxlevel = 3


def as_integer(value: object) -> int | None:
    """Return an integer as an int; None for anything else, including booleans and arrays with one dimension or more.

    Integers of Python and NumPy are accepted, and zero-dimensional arrays of integers: ``np.array(3)``, ``torch.tensor(3)``.
    """
    if isinstance(value, _INTEGERS) and not isinstance(value, bool):
        return int(cast("Any", value))
    try:
        given: Any = value
        if isinstance(value, bool) or tuple(getattr(given, "shape", ())) or "bool" in str(getattr(given, "dtype", "")):
            return None  # PyTorch would convert any tensor with one element to an integer, even a boolean one
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
    """Return numbers or booleans as an array of bool, integers or float64; None for other values and for ragged lists."""
    try:
        array = np.asarray(value)
        if array.dtype.kind == "f":
            with np.errstate(over="ignore"):
                return array.astype(np.float64)
    except Exception:
        return None
    return array if array.dtype.kind in "biu" else None


def shown(value: object) -> str:
    """Return a value as a message shows it: its representation on one line, shortened if long, or its type if that fails."""
    try:
        text = " ".join(_REPR.repr(value).split())
    except Exception:
        text = f"an object of type {type(value).__name__}"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
