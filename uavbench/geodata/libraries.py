"""The libraries of the extra ``cities``, and the error of this room.

They are imported only here, and only when they are needed: the package works without them. None of them has complete types,
so their objects are ``Any`` in this room.
"""

import importlib
from typing import Any

from uavbench.errors import UavbenchError

#: A geometry of shapely.
Geometry = Any


class GeodataError(UavbenchError, ValueError):
    """A city cannot be imported; the message names the file or option, and the reason."""


def library(name: str) -> Any:
    """Return the library ``name``: osmium, pyproj or shapely.

    Raises
    ------
    GeodataError
        When it is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise GeodataError(f"places on earth need {name}: pip install 'uavbench[cities]'") from None
