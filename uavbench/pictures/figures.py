"""The style of all figures: the same everywhere, whatever a user has set Matplotlib to.

Figures are made without pyplot, so no backend and no window is needed; Matplotlib's parts are imported from here.
"""

import os
import sys
import warnings
from collections.abc import Generator
from contextlib import contextmanager, suppress
from typing import Any

if "matplotlib" in sys.modules:
    import matplotlib
else:  # notebooks set MPLBACKEND for all that they start: where that backend is not installed, the import would fail
    _backend = os.environ.pop("MPLBACKEND", None)
    import matplotlib

    if _backend is not None:
        os.environ["MPLBACKEND"] = _backend
        with suppress(ValueError):
            matplotlib.rcParams["backend"] = _backend
import matplotlib.style
from matplotlib import font_manager
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Wedge
from matplotlib.ticker import MaxNLocator

__all__ = ["Figure", "Line2D", "MaxNLocator", "Patch", "Wedge", "fixed_style"]

_FONT = "DejaVu Sans"  # which comes with Matplotlib
_style: Any = matplotlib.style  # which has no types
_fonts: Any = font_manager


@contextmanager
def fixed_style(text: str = "") -> Generator[None]:
    """Draw and save figures in Matplotlib's own style instead of the user's, within a block.

    Parameters
    ----------
    text : str
        Letters that will be written, names for example. What Matplotlib's own font lacks of them is taken from fonts of the
        machine; a letter that no font has is drawn as a box, without a warning.
    """
    with _style.context(["default", {"font.family": _families(text)}]), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield


def _families(text: str) -> list[str]:
    """Return the names of fonts that have the letters of a text, as far as fonts of this machine have them."""
    fonts: list[Any] = sorted(
        (font for font in _fonts.fontManager.ttflist if not font.name.startswith("Last Resort")),  # which has only boxes
        key=lambda font: (font.name != _FONT, font.style != "normal", font.weight != 400, font.name),
    )
    missing, found = set(map(ord, text)), [_FONT]
    for font in fonts:
        if not missing:
            break
        with suppress(OSError, RuntimeError):  # a font that cannot be read
            there = missing & set(_fonts.get_font(font.fname).get_charmap())
            if there:
                found.append(font.name)
                missing -= there
    return list(dict.fromkeys(found))
