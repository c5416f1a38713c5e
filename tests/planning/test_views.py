"""What comes into view along a flight, against what is in view in its cells."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import COVERAGE, maps, scenario

from uavbench.planning.views import enter, in_view, leave, views_of
from uavbench.simulation.missions.coverage import camera_views
from uavbench.world.city import city_of


def seen_from(world, city, targets, cell):
    """Return the numbers of the targets in a cell's view."""
    size, (r, c) = world.mission.camera_size, divmod(cell, city.shape[1])
    view = int(camera_views(world, city)[r, c])
    cells = [(r + k // size - size // 2, c + k % size - size // 2) for k in range(size * size) if view >> k & 1]
    return {targets[cell] for cell in cells if cell in targets}


@settings(max_examples=60)
@given(st.data())
def test_counts_of_what_comes_into_view_tell_what_a_flight_covers(data):
    world = scenario(data.draw(maps()), COVERAGE)
    city, rng = city_of(world), np.random.default_rng(data.draw(st.integers(0, 2**32)))
    target = (~city.no_fly & (rng.random(city.shape) < 0.6)).astype(np.float32)
    targets = {tuple(cell): n for n, cell in enumerate(np.argwhere(target > 0).tolist())}
    views = views_of(world, target, city)
    free, cols = np.flatnonzero(~city.no_fly.reshape(-1)), city.shape[1]
    for cell in free.tolist():
        assert set(in_view(views, cell).tolist()) == seen_from(world, city, targets, cell)
    flight = [int(rng.choice(free))]
    for _ in range(12):  # moves, and sometimes hovering
        steps = [(flight[-1] // cols + y, flight[-1] % cols + x) for y, x in ((-1, 0), (0, 1), (1, 0), (0, -1), (0, 0))]
        flight.append(int(rng.choice([r * cols + c for r, c in steps if r * cols + c in free and 0 <= c < cols and r >= 0])))
    cells, counts = np.array(flight, dtype=np.int32), np.zeros(max(1, len(targets)), dtype=np.int32)
    part = int(rng.integers(1, len(flight)))
    covered = set()
    for end in range(1, part + 1):
        covered |= seen_from(world, city, targets, flight[end - 1])
    assert enter(cells, 0, part, -1, views, counts) == len(covered)
    assert set(np.flatnonzero(counts).tolist()) == covered
    before, more = counts.copy(), set().union(*(seen_from(world, city, targets, cell) for cell in flight[part:]))
    assert enter(cells, part, len(flight), flight[part - 1], views, counts) == len(more - covered)
    assert leave(cells, part, len(flight), flight[part - 1], views, counts) == len(more - covered)
    assert (counts == before).all()
    assert leave(cells, 0, part, -1, views, counts) == len(covered)
    assert not counts.any()
