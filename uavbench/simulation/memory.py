"""How many episodes of a scenario fit into memory at once."""

from uavbench.world.scenario import Scenario

_AT_ONCE = 2**28  # bytes that the episodes of a batch may take together
_BYTES_PER_CELL = 16  # of an episode's state: the target map, and for each of 100 devices one bit per cell for line of sight


def episodes_at_once(scenario: Scenario) -> int:
    """Return how many episodes, with their states and observations, may be in memory at once: at least one."""
    rows, cols = scenario.shape
    return max(1, _AT_ONCE // (_BYTES_PER_CELL * rows * cols + scenario.max_uavs * scenario.observation_bytes))
