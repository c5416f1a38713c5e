"""The style of all figures, which does not depend on the user's Matplotlib settings.

Figures are made without pyplot, so they need no backend and no window. Other modules import Matplotlib's parts from here.
"""

import os
import sys
import warnings
from collections.abc import Generator
from contextlib import contextmanager, suppress
from typing import Any

if "matplotlib" in sys.modules:
    import matplotlib
else:  # notebooks set MPLBACKEND for all their processes, and the import fails if that backend is not installed
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

_FONT = "DejaVu Sans"  # comes with Matplotlib
_style: Any = matplotlib.style  # untyped
_fonts: Any = font_manager


@contextmanager
def fixed_style(text: str = "") -> Generator[None]:
    """Draw and save figures in Matplotlib's own style instead of the user's, within a block.

    Parameters
    ----------
    text : str
        The characters that will be written, for example names. Those that Matplotlib's own font lacks are taken from fonts of
        the machine. A character that no font has is drawn as a box, without a warning.
    """
    with _style.context(["default", {"font.family": _families(text)}]), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield


def _families(text: str) -> list[str]:
    """Return the names of fonts that together have the characters of a text, as far as this machine has such fonts."""
    fonts: list[Any] = sorted(
        (font for font in _fonts.fontManager.ttflist if not font.name.startswith("Last Resort")),  # these have only boxes
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
