"""The metrics of running and finished episodes; at the end of an episode they are its score."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.simulation.state import State
from uavbench.world.kernel import kernel


def outcomes_of(state: State, index: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """Return the metrics of the slots ``index``, each of shape (K,): see `uavbench.simulation.simulator.Simulator.outcomes`."""
    metrics = successes_of(state, index, np.zeros(len(index)))
    del metrics["is_success"]
    return metrics


def successes_of(state: State, index: NDArray[np.int64], least: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """Return the metrics of the slots ``index``, and ``is_success`` (bool): landed, and CR at least ``least``, shape (K,)."""
    number = len(index)
    landed, success, blocked = np.empty(number, np.bool_), np.empty(number, np.bool_), np.empty(number, np.int64)
    cr, cral = np.empty(number), np.empty(number)
    read = (state.landed, state.blocked, state.total, state.remaining)
    _write(index, least, *read, landed, cr, cral, blocked, success)
    return {"landed": landed, "cr": cr, "cral": cral, "blocked": blocked, "is_success": success}


def outcome_of(state: State, i: int) -> dict[str, bool | float | int]:
    """Return the metrics of slot ``i`` as Python numbers, four times faster than as arrays with one element."""
    landed, cr, cral, blocked = _metrics(i, state.landed, state.blocked, state.total, state.remaining)
    return {"landed": landed, "cr": cr, "cral": cral, "blocked": blocked}


@kernel
def _metrics(
    i: int,
    landed: NDArray[np.bool_],
    blocked: NDArray[np.int32],
    total: NDArray[np.float64],
    remaining: NDArray[np.float64],
) -> tuple[bool, float, float, int]:
    """Return landed, CR, CRAL and blocked of slot ``i``."""
    down, stops = True, 0
    for u in range(landed.shape[1]):
        down = down and landed[i, u]
        stops += blocked[i, u]
    cr = (total[i] - remaining[i]) / total[i]
    return down, cr, cr if down else 0.0, stops


@kernel
def _write(
    index: NDArray[np.int64],
    least: NDArray[np.float64],
    each_landed: NDArray[np.bool_],
    each_blocked: NDArray[np.int32],
    total: NDArray[np.float64],
    remaining: NDArray[np.float64],
    landed: NDArray[np.bool_],
    cr: NDArray[np.float64],
    cral: NDArray[np.float64],
    blocked: NDArray[np.int64],
    success: NDArray[np.bool_],
) -> None:
    """Write the metrics of the slots ``index``."""
    for k in range(len(index)):
        landed[k], cr[k], cral[k], blocked[k] = _metrics(index[k], each_landed, each_blocked, total, remaining)
        success[k] = landed[k] and cr[k] >= least[k]
