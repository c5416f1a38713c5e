"""The base of every error that uavbench raises on purpose, and how to say what others raise."""

from collections.abc import Callable


class UavbenchError(Exception):
    """What uavbench refuses, and why: the message names the file or field, the reason, and the way out.

    Every error class of the suite derives from it, so ``except uavbench.UavbenchError`` catches them all. Most are a
    ``ValueError`` besides, as libraries that call the suite expect of bad arguments.
    """


_LONGEST = 300


def one_line(thing: object, say: Callable[[object], str] = str) -> str:
    """Return what an object says of itself as one line that can be printed, of at most 300 characters, whatever it says.

    It is for what others wrote: exceptions, whose ``__str__`` may raise, and names, which may hold line breaks. ``say`` is
    `str` or `repr`.
    """
    try:
        text = say(thing)
    except Exception:
        text = f"{type(thing).__name__}, which cannot say what it is"
    text = " ".join(text.split())
    seen = "".join(letter if letter.isprintable() else "?" for letter in text)
    return seen if len(seen) <= _LONGEST else f"{seen[:_LONGEST]}…"
