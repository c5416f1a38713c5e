"""Work in processes of its own: results come as they are made, and whatever ends a worker is said."""

import os
import time

import pytest

from uavbench.errors import UavbenchError
from uavbench.evaluation.processes import WorkerDiedError, WorkerLateError, work_apart


def double(piece, shown):
    for number in piece:
        yield 2 * number, os.getpid()


def stumble(piece, shown):
    yield piece
    if piece == "raise":
        raise UavbenchError("no")
    if piece == "mistake":
        raise ZeroDivisionError("division by zero")
    if piece == "end":
        os._exit(0)
    if piece == "late":
        shown[0], shown[1] = time.monotonic() + 0.2, 7.0
        time.sleep(60)


def late_once(piece, shown):
    """Show a time that is passed while a piece is done, and none afterwards."""
    shown[0] = time.monotonic() + 3600
    yield piece
    shown[0] = 0.0


@pytest.mark.parametrize("workers", [1, 2])
def test_every_piece_is_done_once_elsewhere(workers):
    pieces = [[1, 2], [3], [], [4, 5, 6]]
    found = list(work_apart(double, pieces, workers))
    assert sorted(number for number, _ in found) == [2, 4, 6, 8, 10, 12]
    assert os.getpid() not in {process for _, process in found}


def test_nothing_to_do_starts_nothing():
    assert list(work_apart(double, [], 2)) == []


@pytest.mark.parametrize(
    ("piece", "error", "message"),
    [
        ("raise", UavbenchError, "^no$"),
        ("mistake", ZeroDivisionError, "division by zero"),
        ("end", WorkerDiedError, "its process ended itself with the exit status 0"),
        ("late", WorkerLateError, "took too long"),
    ],
)
def test_what_ends_a_worker_is_raised_after_what_it_has_made(piece, error, message):
    work = work_apart(stumble, [piece], 1)
    assert next(work) == piece
    with pytest.raises(error, match=message) as told:
        next(work)
    if piece == "mistake":  # of which the place is told
        assert "in stumble" in told.value.__notes__[0]
    if piece == "late":
        assert told.value.shown[1] == 7.0
        assert "in stumble" in told.value.trace


def test_a_time_that_is_not_over_ends_nothing():
    assert list(work_apart(late_once, ["a", "b"], 1)) == ["a", "b"]


def test_workers_end_when_nobody_asks_them_any_more():
    work = work_apart(double, [[1], [2], [3]], 1)
    _, process = next(work)
    work.close()
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
