"""Copying short rows: every length, and nothing beside them."""

import numpy as np
import pytest

from uavbench.simulation.rows import copy_row


@pytest.mark.parametrize("size", range(70))
def test_copies_the_row_and_nothing_else(size):
    generator = np.random.default_rng(size)
    for before in range(9):  # also where the rows are not aligned to a vector
        source, target = generator.random(100, dtype=np.float32), np.full(100, -1, dtype=np.float32)
        copy_row(source[before : before + size], target[2 * before : 2 * before + size])
        assert np.array_equal(target[2 * before : 2 * before + size], source[before : before + size])
        assert (target[: 2 * before] == -1).all()
        assert (target[2 * before + size :] == -1).all()
