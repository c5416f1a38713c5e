"""Text in CSV files, made harmless: a spreadsheet may take a cell for a formula, and run it."""

import re

# A formula begins with one of these characters, also in full width. Where the comma is the decimal mark, spreadsheets take
# the semicolon for the separator of cells, so that a formula may stand behind one.
_FORMULA = re.compile(r"""(^|[;,\t|])([\s"']*)(?=[=+\-@＝＋－＠﹢﹣﹦﹫−])""")


def plain_cell(text: str) -> str:
    """Return text that every spreadsheet takes for text: what would begin a formula has an apostrophe before it."""
    return _FORMULA.sub(r"\1\2'", text)
