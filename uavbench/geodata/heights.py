"""The height of a building, from its tags."""

import re
from collections.abc import Mapping
from typing import Any, Literal

#: What the height of a building comes from.
Basis = Literal["height", "levels", "default"]

LEVEL_HEIGHT = 3.0  # metres
_FOOT, _INCH = 0.3048, 0.0254  # metres
_HIGHEST, _MOST_LEVELS = 1000.0, 300.0  # no building is higher, or has more: a larger number is a mistake
_NUMBER = r"([0-9]+(?:[.,][0-9]+)?)"
_METRES = re.compile(rf"{_NUMBER}\s*(?:m|metres?|meters?)?", re.IGNORECASE)
_FEET = re.compile(rf"{_NUMBER}\s*(?:'|′|ft|feet|foot)(?:\s*{_NUMBER}\s*(?:\"|″|in|''))?", re.IGNORECASE)
_LEVELS = re.compile(_NUMBER)
_LEVEL_KEYS = ("building:levels", "levels", "num_floors")  # of OpenStreetMap, of files made from it, of Overture Maps


def building_height(tags: Mapping[str, Any]) -> tuple[float | None, Basis]:
    """Return the height of a building in metres, and what it comes from; None if its tags do not tell.

    Parameters
    ----------
    tags : mapping
        ``height`` counts first, and then the number of levels, of three metres each. A value that is no positive number of a
        plausible size counts as missing.
    """
    height = parse_height(tags.get("height"))
    if height is not None:
        return height, "height"
    for key in _LEVEL_KEYS:
        levels = _largest(tags.get(key), _one_level, _MOST_LEVELS)
        if levels is not None:
            return levels * LEVEL_HEIGHT, "levels"
    return None, "default"


def parse_height(value: Any) -> float | None:
    """Return the metres in a value such as ``12``, ``12.5 m``, ``40'``, ``40 ft`` or ``3;4``, whose largest counts.

    Returns
    -------
    float or None
        None if the value is missing, or is not a positive height of a plausible size.
    """
    return _largest(value, _one_height, _HIGHEST)


def _largest(value: Any, parse: Any, most: float) -> float | None:
    """Return the largest number of a list that semicolons separate; None if an entry is none, or it is not plausible."""
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        return None
    numbers = [parse(part.strip()) for part in str(value)[:100].split(";") if part.strip()]
    if not numbers or None in numbers:
        return None
    largest: float = max(numbers)
    return largest if 0 < largest <= most else None


def _one_height(text: str) -> float | None:
    found = _METRES.fullmatch(text)
    if found:
        return _number(found[1])
    found = _FEET.fullmatch(text)
    return _number(found[1]) * _FOOT + _number(found[2] or "0") * _INCH if found else None


def _one_level(text: str) -> float | None:
    found = _LEVELS.fullmatch(text)
    return _number(found[1]) if found else None


def _number(text: str) -> float:
    return float(text.replace(",", "."))
