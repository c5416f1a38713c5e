"""Copying and converting blocks of short rows: every length, and nothing beside them."""

import numpy as np
import pytest

from uavbench.simulation.rows import copy_block, divide_block, fill_range, split_block

ROWS = 3


def block_of(values, before, step, size):
    """Return an array of −1 in which the rows of ``values`` stand where the tests below write them."""
    target = np.full(2 * before + ROWS * step + 1, -1, dtype=np.float32)
    for row in range(ROWS):
        target[2 * before + row * step :][:size] = values[row]
    return target


@pytest.mark.parametrize("size", range(0, 70, 3))
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.uint32])
def test_writes_the_block_and_nothing_else(size, kind):
    generator = np.random.default_rng(size)
    for before in range(9):  # also where the rows are not aligned to a vector
        step, wide, ninth = size + before + 1, size + 2, np.float32(9.0)
        numbers = generator.integers(0, min(2 ** (8 * kind().itemsize), 2**22), before + ROWS * wide).astype(kind)
        rows = np.array([numbers[before + row * wide :][:size] for row in range(ROWS)]).astype(np.float32)
        places = before, wide
        found = block_of(np.full((ROWS, size), -1), before, step, size)
        copy_block(numbers.astype(np.float32), *places, found, 2 * before, step, (ROWS, size))
        assert np.array_equal(found, block_of(rows, before, step, size))
        divide_block(numbers, *places, found, 2 * before, step, (ROWS, size), ninth)
        assert np.array_equal(found, block_of(rows / ninth, before, step, size))


@pytest.mark.parametrize("size", range(0, 70, 3))
def test_splits_bytes_into_their_lowest_bits_and_writes_nothing_else(size):
    generator = np.random.default_rng(size)
    for before in range(9):
        numbers, wide = generator.integers(0, 256, before + ROWS * (size + 2)).astype(np.uint8), size + 2
        rows = np.array([numbers[before + row * wide :][:size] for row in range(ROWS)])
        found = np.full(2 * before + 3 * ROWS * size + 1, -1, dtype=np.float32)
        split_block(numbers, before, wide, found, 2 * before, ROWS, size)
        split = np.concatenate([(rows.reshape(-1) >> bit) & 1 for bit in range(3)])
        assert np.array_equal(found, [-1.0] * 2 * before + split.tolist() + [-1.0])


@pytest.mark.parametrize("size", range(20))
def test_fills_the_range_and_nothing_else(size):
    target = np.zeros(40, dtype=np.float32)
    fill_range(target, 7, 7 + size, np.float32(2.5))
    assert target.tolist() == [0.0] * 7 + [2.5] * size + [0.0] * (33 - size)


def test_divides_every_count_of_a_block_as_a_division_does():
    for scale in range(1, 130):
        area = scale * scale
        numbers = np.arange(area + 8, dtype=np.uint32)
        found = np.empty(len(numbers), dtype=np.float32)
        divide_block(numbers, 0, 0, found, 0, 0, (1, len(numbers)), np.float32(area))
        assert np.array_equal(found, numbers.astype(np.float32) / np.float32(area)), scale
