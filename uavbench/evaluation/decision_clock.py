"""Measuring how long an agent's calls take, where another process can see it. The time to compile kernels is not counted."""

import math
import time
from collections.abc import MutableSequence, Sequence
from typing import Any, NamedTuple

from uavbench.evaluation.processes import SHOWN
from uavbench.world.kernel import compilations_told

#: Methods of an agent, as messages name them.
CALLS = ("__init__()", "reset()", "act()", "act_batch()", "act_team()")


class Call(NamedTuple):
    """A call of an agent: the method, the first and the last episode that it decides for, the step, and the first UAV."""

    method: str
    first_episode: int
    last_episode: int
    step: int
    uav: int


class DecisionClock:
    """Measures the time of an agent's calls. Use it as a context manager: only in the block does it notice compilations.

    Parameters
    ----------
    limit : float, optional
        Seconds that a call may take; None for no limit.
    shown : mutable sequence of float
        Where the running call is shown: the time from which it is late (`time.monotonic`; 0 while none runs or a kernel is
        compiled), and the fields of `Call`.
    """

    def __init__(self, limit: float | None, shown: MutableSequence[float] | None = None) -> None:
        self._limit = math.inf if limit is None else limit
        self._shown = [0.0] * SHOWN if shown is None else shown
        self._running = False
        self._started = self._since = self._compiled = 0.0
        self._depth = 0
        self._compilations = compilations_told(self._pause, self._go_on)

    def __enter__(self) -> "DecisionClock":
        self._compilations.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._compilations.__exit__(*error)

    def start(self, method: str, infos: Sequence[dict[str, Any]], step: int, *, limited: bool = True) -> None:
        """Begin a call of the agent for the UAVs of ``infos``; without ``limited`` it is never late."""
        shown = self._shown
        shown[1] = CALLS.index(method)
        if infos:
            shown[2], shown[3], shown[4], shown[5] = infos[0]["episode"], infos[-1]["episode"], step, infos[0]["uav"]
        self._running, self._compiled = limited, 0.0
        self._started = now = time.monotonic()
        shown[0] = now + self._limit if limited else 0.0

    def stop(self) -> float:
        """End the call, and return the seconds that it took."""
        self._running = False
        self._shown[0] = 0.0
        return time.monotonic() - self._started - self._compiled

    def _pause(self) -> None:
        """Stop the clock, because a kernel is being compiled."""
        if self._depth == 0:
            self._since = time.monotonic()
            self._shown[0] = 0.0
        self._depth += 1

    def _go_on(self) -> None:
        """Start the clock again after a compilation."""
        self._depth -= 1
        if self._depth == 0:
            self._compiled += time.monotonic() - self._since
            if self._running:
                self._shown[0] = self._started + self._limit + self._compiled


def shown_call(shown: Sequence[float]) -> Call:
    """Return the call that a clock showed."""
    first, last, step, uav = (int(value) for value in shown[2:6])
    return Call(CALLS[int(shown[1])], first, last, step, uav)
