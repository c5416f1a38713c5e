"""Say whether two pages of the leaderboard hold the same: what is packed in them is unpacked first, since zlibs differ.

Usage: python tests/leaderboard/same_page.py leaderboard/index.html other.html
"""

import base64
import re
import sys
import zlib
from pathlib import Path


def contents(path):
    """Return a page with what is packed in it unpacked."""
    text = Path(path).read_text(encoding="utf-8")
    return re.sub(r'"data":"([^"]*)"', lambda found: zlib.decompress(base64.b64decode(found[1])).hex(), text)


if __name__ == "__main__":
    one, other = map(contents, sys.argv[1:])
    sys.exit(0 if one == other else f"{sys.argv[1]} and {sys.argv[2]} differ")
