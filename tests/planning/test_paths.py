"""Ways on a map, against all ways there are."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import COVERAGE, maps, scenario

from uavbench.planning.paths import worthiest_way
from uavbench.world.city import city_of


def every_way(cell, onward):
    """Return all shortest ways from a cell to where ``onward`` is 0, without the cell itself."""
    if onward[cell] == 0:
        return [[]]
    r, c = cell
    beside = [(r - 1, c), (r, c + 1), (r + 1, c), (r, c - 1)]
    nearer = [near for near in beside if onward.get(near, -1) == onward[cell] - 1]
    return [[near, *rest] for near in nearer for rest in every_way(near, onward)]


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_no_shortest_way_home_is_worth_more(data):
    world = scenario(data.draw(maps()), COVERAGE)
    city = city_of(world)
    cols, home = city.shape[1], city.distance_to_landing
    onward = {cell: int(home[cell]) for cell in np.ndindex(*city.shape) if home[cell] >= 0}
    start = data.draw(st.sampled_from(sorted(onward)))
    worth = np.array(data.draw(st.lists(st.integers(0, 9), min_size=home.size, max_size=home.size)), dtype=float)
    found = worthiest_way(start[0] * cols + start[1], home.reshape(-1).astype(np.int64), cols, worth)
    ways = [[r * cols + c for r, c in way] for way in every_way(start, onward)]
    assert found.tolist() in ways
    assert worth[found].sum() == max(worth[way].sum() for way in ways)
