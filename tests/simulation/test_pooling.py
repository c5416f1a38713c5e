"""What the state keeps of target maps, against sums that are taken block by block."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uavbench import load_scenario
from uavbench.simulation.observation import Observer
from uavbench.simulation.pooling import block_sum, count_targets, find_targets, new_counts, remove_target
from uavbench.simulation.simulator import Simulator
from uavbench.simulation.state import index_targets

sides = st.integers(1, 12)


def maps(data, shape, largest=1):
    cells = data.draw(st.lists(st.integers(0, largest), min_size=shape[0] * shape[1], max_size=shape[0] * shape[1]))
    return np.array(cells, dtype=np.float32).reshape(shape)


def brute_force(target, scale):
    """Count by definition."""
    rows, cols = target.shape
    high, wide = (rows + 2 * scale - 2) // scale, (cols + 2 * scale - 2) // scale
    counts = np.zeros((scale, high, scale, wide), dtype=int)
    for p, y, q, x in np.ndindex(counts.shape):
        block = [
            target[r, c]
            for r in range(y * scale - p, y * scale - p + scale)
            for c in range(x * scale - q, x * scale - q + scale)
            if 0 <= r < rows and 0 <= c < cols
        ]
        counts[p, y, q, x] = sum(block)
    return counts


@given(st.data(), sides, sides, st.integers(1, 7))
def test_counts_are_those_of_brute_force_however_targets_go(data, rows, cols, scale):
    target = maps(data, (rows, cols))
    counts = np.full_like(new_counts(1, (rows, cols), scale)[0], 99)  # what an earlier episode left
    count_targets(target, counts)
    assert np.array_equal(counts, brute_force(target, scale))
    for r, c in data.draw(st.permutations(np.argwhere(target).tolist())):
        target[r, c] = 0.0
        remove_target(counts, r, c)
        assert np.array_equal(counts, brute_force(target, scale))


@pytest.mark.parametrize(("scale", "dtype"), [(15, np.uint8), (16, np.uint16), (255, np.uint16), (256, np.uint32)])
def test_counts_hold_a_block_that_is_all_targets(scale, dtype):
    target = np.ones((scale, scale), dtype=np.float32)
    counts = new_counts(1, target.shape, scale)[0]
    count_targets(target, counts)
    assert counts.dtype == dtype
    assert counts.max() == counts[0, 0, 0, 0] == scale**2


@given(st.data(), sides, sides, st.integers(1, 7))
def test_spots_and_sums_are_those_of_the_map(data, rows, cols, scale):
    target = maps(data, (rows, cols), largest=9)
    spots = np.zeros((rows * cols, 2), dtype=np.int32)
    number = find_targets(target, spots)
    assert spots[:number].tolist() == np.argwhere(target).tolist()
    top, left = data.draw(st.integers(-scale, rows + scale)), data.draw(st.integers(-scale, cols + scale))
    there = target[max(0, top) : max(0, top + scale), max(0, left) : max(0, left + scale)]
    assert block_sum(target, top, left, scale) == there.sum()


@pytest.mark.parametrize("name", ["Manhattan32-CPP-v0", "Urban50-DH-v0"])
@pytest.mark.parametrize("scale", [3, 4])
def test_however_targets_are_kept_the_observation_is_the_same(name, scale):
    """The observer of another scale finds nothing that fits it, and adds up the whole map."""
    scenario = load_scenario(name).with_observation(9, scale)
    simulator, other = Simulator(scenario, 6), Simulator(scenario.with_observation(9, 7 - scale), 6)
    observer, rng = Observer(scenario), np.random.default_rng(0)
    for each in (simulator, other):
        each.reset(np.arange(6), "test", np.arange(6))
    for _ in range(60):
        shown = []
        actions = rng.integers(0, 5, 6)
        for each in (simulator, other):
            each.step(actions)
            shown.append(observer.empty(6))
            observer.write(each.state, np.arange(6), shown[-1])
        counts = simulator.state.counts.copy()
        index_targets(simulator.state)  # as for a map that is set from outside
        assert np.array_equal(simulator.state.counts, counts)
        shown.append(observer.empty(6))
        observer.write(simulator.state, np.arange(6), shown[-1])
        for part in shown[0]:
            assert shown[0][part].tobytes() == shown[1][part].tobytes() == shown[2][part].tobytes()
