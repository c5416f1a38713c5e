"""The base of every error that uavbench raises on purpose."""


class UavbenchError(Exception):
    """What uavbench refuses, and why: the message names the file or field, the reason, and the way out.

    Every error class of the suite derives from it, so ``except uavbench.UavbenchError`` catches them all. Most are a
    ``ValueError`` besides, as libraries that call the suite expect of bad arguments.
    """
