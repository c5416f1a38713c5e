"""Windows of distances, against the distances in the whole city."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import COVERAGE, maps, scenario

from uavbench import load_scenario
from uavbench.planning import distances
from uavbench.planning.distances import FAR, REACH, Windows, distance_table, distances_of, moves
from uavbench.planning.paths import walk
from uavbench.world.cities import city_at, city_key
from uavbench.world.city import City, city_of
from uavbench.world.kernel import kernel


@kernel
def moves_between(distance, cols, here, there):
    """Return what `moves`, which only kernels call, returns."""
    return moves(distance, cols, here, there)


def windows_of(city, most=10**6):
    """Return windows of a city of which none has been computed, with room for so many."""
    cells = city.no_fly.size
    moves = np.empty((min(most, cells), (2 * REACH + 1) ** 2), dtype=np.uint8)
    return Windows(city.no_fly, np.full(cells, -1, dtype=np.int32), moves, np.zeros(1, dtype=np.int64))


def walked(distance, city, here, there, seed=0):
    """Return the cells of a walk from ``here`` to ``there``, or None if no path is known."""
    cols = city.shape[1]
    count = moves_between(distance, cols, here, there)
    if count < 0:
        return None
    out = np.empty(city.no_fly.size, dtype=np.int32)
    for straight in (True, False):
        assert walk(distance, cols, here, there, straight, np.array([seed], dtype=np.uint64), out, 0) == count
    return out[:count].tolist()


@settings(max_examples=40)
@given(st.data())
def test_on_a_small_map_windows_know_every_path(data):
    """The window of each cell holds the whole map; both forms walk the same way, for the same random numbers."""
    city = city_of(scenario(data.draw(maps()), COVERAGE))
    free = np.flatnonzero(~city.no_fly.reshape(-1)).tolist()
    table, windows = distance_table(city), windows_of(city)
    for _ in range(10):
        here, there = data.draw(st.sampled_from(free)), data.draw(st.sampled_from(range(city.no_fly.size)))
        way = walked(windows, city, here, there)
        assert way == walked(table, city, here, there)
        assert (way is None) == (table[there, here] == FAR)


def test_on_a_large_map_windows_know_the_paths_inside_them():
    drawn = load_scenario("Cities50-CPP-v0")
    city = City(np.tile(city_at(drawn, city_key(drawn, "test", 3)).cells, (2, 2)))
    windows, rng = windows_of(city, most=7), np.random.default_rng(0)
    free, (rows, cols) = np.flatnonzero(~city.no_fly.reshape(-1)), city.shape
    goals = rng.choice(free, 20).tolist()
    known = beyond = 0
    for there in [*goals[:3], *goals, *goals]:  # more than there is room for, and each again
        r, c = divmod(there, cols)
        top, left = max(0, r - REACH), max(0, c - REACH)
        inside = City(city.cells[top : r + REACH + 1, left : c + REACH + 1]).distances((r - top, c - left))
        whole = city.distances((r, c)).reshape(-1)
        near = [y * cols + x for y in range(top, min(rows, r + REACH + 1)) for x in range(left, min(cols, c + REACH + 1))]
        for here in [*rng.choice(free, 50).tolist(), *rng.choice(np.intersect1d(near, free), 50).tolist()]:
            way = walked(windows, city, here, there)
            away = inside[here // cols - top, here % cols - left] if here in near else -1
            if way is None:
                assert away < 0
                beyond += 1
                continue
            assert len(way) == away >= whole[here]
            assert away == whole[here] or whole[here] > REACH
            assert way[-1:] == ([there] if here != there else [])
            steps = np.abs(np.diff(np.stack(np.divmod([here, *way], cols)))).sum(axis=0)
            assert (steps == 1).all()
            assert not city.no_fly.reshape(-1)[way].any()
            known += 1
    assert min(known, beyond) > 100


def test_only_large_maps_have_windows():
    assert isinstance(distances_of(city_of(load_scenario("Urban50-CPP-v0"))), np.ndarray)
    assert not distances.is_large((64, 64))
    assert distances.is_large((64, 65))
    with pytest.raises(NotImplementedError):
        distances.distances_to(np.zeros((1, 1), dtype=np.int16), 1, 0, 0)
