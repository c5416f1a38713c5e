"""Memory: how many episodes fit at once, and pages that a training frees and asks for again at every update."""

import ctypes

from uavbench.scenario import Scenario

_AT_ONCE = 2**28  # bytes that the episodes of a batch may take together
_BYTES_PER_CELL = 16  # of an episode's state: the target map, and what each of 100 devices sees, a bit a cell

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4  # of glibc's mallopt
_MOST = 2**31 - 1


def keep_freed() -> bool:
    """Have the process keep what it frees, instead of asking the system for it again: a tenth of a training's time.

    Returns
    -------
    bool
        Whether it does. Elsewhere than on glibc nothing happens.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return False
    return bool(mallopt(_MMAP_MAX, 0)) and bool(mallopt(_TRIM_THRESHOLD, _MOST))


def episodes_at_once(scenario: Scenario) -> int:
    """Return how many episodes may be in memory together, states and observations: on large maps few, but at least one."""
    rows, cols = scenario.shape
    return max(1, _AT_ONCE // (_BYTES_PER_CELL * rows * cols + scenario.most_uavs * scenario.observation_bytes))
