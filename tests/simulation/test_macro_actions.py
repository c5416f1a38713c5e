"""Macro-actions fly shortest paths on the local map, and end where something changes."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uavbench.simulation.macro_actions import MacroKind
from uavbench.world.city import HOVER, LAND, OFFSETS

ALL = np.ones(6, dtype=np.int8)


def local(rows):
    """Local maps (2, l, l): landing where L is, no_fly where # is."""
    cells = np.array([list(row) for row in rows])
    return np.stack([cells == "L", cells == "#"]).astype(np.float32)


@st.composite
def walls(draw):
    size = draw(st.sampled_from([3, 5, 7, 9]))
    closed = np.array(draw(st.lists(st.booleans(), min_size=size**2, max_size=size**2))).reshape(size, size)
    closed[size // 2, size // 2] = False
    return np.stack([np.zeros_like(closed), closed]).astype(np.float32)


def distances(closed):
    """Moves from the middle to each cell, by breadth-first search over a dictionary."""
    size = len(closed)
    found = {(size // 2, size // 2): 0}
    queue = deque(found)
    while queue:
        r, c = queue.popleft()
        for y, x in ((r - 1, c), (r, c + 1), (r + 1, c), (r, c - 1)):
            if 0 <= y < size and 0 <= x < size and not closed[y, x] and (y, x) not in found:
                found[y, x] = found[r, c] + 1
                queue.append((y, x))
    return found


def flown(kind, chosen, seen):
    """The actions of a macro-action if every action is allowed and what is seen does not change."""
    flight = kind.begin(chosen, seen)
    return list(iter(lambda: flight.next(seen, ALL), None))


@given(walls())
def test_paths_are_as_short_as_can_be_and_lead_to_their_cells(seen):
    size = seen.shape[1]
    kind, away = MacroKind("cells", size), distances(seen[1] > 0)
    mask = kind.mask(seen, ALL)
    assert set(np.flatnonzero(mask[:-1]).tolist()) == {r * size + c for r, c in away}
    for (r, c), moves in away.items():
        actions = flown(kind, r * size + c, seen)
        place = np.array([size // 2, size // 2])
        for action in actions:
            place = place + OFFSETS[action]
            assert not seen[1][tuple(place)]
        assert (tuple(place.tolist()), len(actions)) == ((r, c), max(moves, 1))


def test_the_middle_means_to_hover_and_the_last_one_to_land():
    kind, seen = MacroKind("cells", 3), local(["...", "...", "..."])
    assert flown(kind, 4, seen) == [HOVER]
    assert flown(kind, 9, seen) == [LAND]
    assert kind.mask(seen, np.array([0, 1, 1, 1, 1, 0])).tolist() == [0, 0, 0, 1, 1, 1, 1, 1, 1, 0]  # by north


def test_a_cell_without_a_path_is_refused():
    kind, seen = MacroKind("cells", 3), local([".#.", "#..", "..."])
    assert not kind.mask(seen, ALL)[0]
    with pytest.raises(ValueError, match=r"no path on the local map to its cell \(0, 0\)"):
        kind.begin(0, seen)


def test_a_flight_ends_early_where_the_next_action_is_not_allowed():
    seen = local(["....."] * 5)
    flight = MacroKind("cells", 5).begin(2, seen)  # two cells to the north
    assert flight.next(seen, ALL) == 0
    assert flight.next(seen, np.array([0, 1, 1, 1, 1, 1])) is None


@pytest.mark.parametrize(
    ("after", "goes_on"),
    [
        (["#.#", "#.#", "#.#"], True),
        (["#.#", "..#", "#.#"], False),  # an opening to the left
        (["#.#", "#..", "#.#"], False),
        (["#.#", "#L#", "#.#"], False),  # a landing zone begins
        (["...", "#.#", "..."], True),  # what is beside the next cell does not count
    ],
)
def test_a_direction_is_flown_until_something_changes(after, goes_on):
    seen = local(["#.#", "#.#", "#.#"])
    flight = MacroKind("directions", 3).begin(0, seen)
    assert flight.next(seen, ALL) == 0
    assert (flight.next(local(after), ALL) == 0) == goes_on


@pytest.mark.parametrize(("kind", "size", "message"), [("cell", 17, "cells, directions"), ("cells", 0, "at least 3×3")])
def test_what_does_not_fit_is_refused(kind, size, message):
    with pytest.raises(ValueError, match=message):
        MacroKind(kind, size)
