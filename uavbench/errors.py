"""The base class of the errors that uavbench raises on purpose, and a function that makes any text printable on one line."""

from collections.abc import Callable


class UavbenchError(Exception):
    """uavbench refuses something: the message names the file or field, the reason, and what to do.

    Every error class of the suite derives from it, so ``except uavbench.UavbenchError`` catches them all. Most are also a
    ``ValueError``, which libraries that call the suite expect for bad arguments.
    """


_LONGEST = 300


def one_line(thing: object, say: Callable[[object], str] = str) -> str:
    """Return the text of any object as one printable line of at most 300 characters, with … at its end if it was longer.

    It is for objects that others made: exceptions, whose ``__str__`` may raise, and names, which may contain line breaks.
    ``say`` is `str` or `repr`.
    """
    try:
        text = say(thing)
    except Exception:
        text = f"{type(thing).__name__}, which cannot say what it is"
    text = " ".join(text.split())
    seen = "".join(letter if letter.isprintable() else "?" for letter in text)
    return seen if len(seen) <= _LONGEST else f"{seen[:_LONGEST]}…"
