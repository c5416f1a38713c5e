"""Making text harmless in CSV files: a spreadsheet may interpret a cell as a formula and run it."""

import re

# A formula begins with one of these characters, or with its full-width form. In countries with a decimal comma, spreadsheets
# separate cells at semicolons, so that a formula may also follow one of these.
_FORMULA = re.compile(r"""(^|[;,\t|])([\s"']*)(?=[=+\-@＝＋－＠﹢﹣﹦﹫−])""")


def plain_cell(text: str) -> str:
    """Return text that no spreadsheet interprets as a formula: an apostrophe is put before what would begin one."""
    return _FORMULA.sub(r"\1\2'", text)
