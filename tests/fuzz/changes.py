"""Changes of valid files that a fuzzer makes, as strategies of Hypothesis."""

import re
from collections.abc import Callable

from hypothesis import strategies as st

#: What is put in the place of a number: the ends of types, what is no number, and what means something in some format.
_TOKENS = (
    *("0", "-1", "1e400", "nan", "-0.0", "2147483648", "18446744073709551616", "1" * 400, "3.5", "true", "null"),
    *('""', "[]", "{}", "../../etc/passwd", "\\u0000", "\u202e", "é", "'" * 3, "[" * 2000, "# ", "\n", "="),
)
_NUMBER = re.compile(rb"-?\d+(\.\d+)?")
Change = tuple[str, float, int, bytes]


def _changed(content: bytes, change: Change) -> bytes:
    """Make one change, at a place between 0 (the beginning) and 1 (the end)."""
    kind, place, size, new = change
    at = int(place * len(content))
    if kind == "insert":
        return content[:at] + new + content[at:]
    if kind == "replace":
        return content[:at] + new + content[at + len(new) :]
    if kind == "delete":
        return content[:at] + content[at + size :]
    if kind == "repeat":
        return content[:at] + content[at : at + size] * 3 + content[at + size :]
    if kind == "cut":
        return content[:at]
    found = _NUMBER.search(content, at)
    return content if found is None else content[: found.start()] + new + content[found.end() :]


_new = st.one_of(
    st.binary(max_size=12),
    st.sampled_from(_TOKENS).map(lambda text: text.encode()),
    st.integers(-2, 130).map(lambda n: str(n).encode()),
)
_change = st.tuples(
    st.sampled_from(("number", "number", "number", "number", "insert", "replace", "delete", "repeat", "cut")),
    st.integers(0, 9999).map(lambda n: n / 10_000),
    st.integers(1, 80),
    _new,
)


def _all_changed(content: bytes, changes: list[Change]) -> bytes:
    for change in changes:
        content = _changed(content, change)
    return content


def changed(examples: list[bytes]) -> st.SearchStrategy[bytes]:
    """Return valid files with up to four changes, and now and then any bytes."""
    several: Callable[..., bytes] = _all_changed
    files = st.builds(several, st.sampled_from(examples), st.lists(_change, min_size=1, max_size=4))
    return st.one_of(files, files, files, files, st.binary(max_size=400))
