"""The shapes are scikit-image's: the same cells for the same shape, and the same distribution."""

import math
import warnings

import numpy as np
import pytest
from scipy import stats
from skimage import draw

from uavbench.simulation.missions import shapes

SAMPLES = 4000


@pytest.mark.parametrize("size", [(8, 8), (12, 20), (32, 32)])
def test_paints_the_rectangles_of_scikit_image(size):
    rows, cols = size
    generator = np.random.default_rng(1)
    for _ in range(200):
        r, c = int(generator.integers(rows - 2)), int(generator.integers(cols - 2))
        height, width = int(generator.integers(1, rows - r)), int(generator.integers(1, cols - c))
        grid = np.zeros(size, np.uint8)
        shapes.paint_rectangle(grid, r, c, height, width)
        theirs = np.zeros(size, np.uint8)
        theirs[draw.polygon([r, r + height, r + height, r], [c, c, c + width, c + width])] = 1
        assert np.array_equal(grid, theirs)


@pytest.mark.parametrize("side", range(1, 31))
def test_paints_the_triangles_of_scikit_image(side):
    height = math.ceil(math.sqrt(0.75) * side)
    for r in (0, 1, height - 1, height, 31):
        for c in (0, 31 - side):
            grid, theirs = np.zeros((32, 32), np.uint8), np.zeros((32, 32), np.uint8)
            shapes.paint_triangle(grid, r, c, side)
            theirs[draw.polygon([r, r - height, r], [c, c + side // 2, c + side])] = 1
            assert np.array_equal(grid, theirs), (side, r, c)


@pytest.mark.parametrize("radius", range(1, 17))
def test_paints_the_circles_of_scikit_image(radius):
    grid, theirs = np.zeros((40, 40), np.uint8), np.zeros((40, 40), np.uint8)
    shapes.paint_ellipse(grid, 20, 19, float(radius), float(radius), 0.0)
    theirs[draw.disk((20, 19), radius)] = 1
    assert np.array_equal(grid, theirs)


def test_paints_the_ellipses_of_scikit_image():
    generator = np.random.default_rng(2)
    for _ in range(2000):
        r, c = generator.integers(1, 20), generator.integers(1, 30)
        a, b = generator.uniform(1, 18, 2)
        rotation = generator.uniform(-math.pi, math.pi)
        grid, theirs = np.zeros((20, 30), np.uint8), np.zeros((20, 30), np.uint8)
        shapes.paint_ellipse(grid, r, c, a, b, rotation)
        theirs[draw.ellipse(r, c, a, b, shape=(20, 30), rotation=rotation)] = 1
        assert np.array_equal(grid, theirs)


def ours(size, fewest, most, samples=SAMPLES, key=1):
    cursor = np.array([key], dtype=np.uint64)
    images, counts = np.zeros((samples, *size), np.uint8), np.zeros(samples, int)
    for k in range(samples):
        painted, counts[k] = shapes.draw_shapes(cursor, fewest, most, images[k])
        assert painted == images[k].sum()
    return images, counts


def theirs(size, fewest, most, samples=SAMPLES, seed=1, **arguments):
    images, counts = np.zeros((samples, *size), np.uint8), np.zeros(samples, int)
    generator = np.random.default_rng(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a shape that fits nowhere
        for k in range(samples):
            image, labels = draw.random_shapes(
                size, most, fewest, channel_axis=None, allow_overlap=True, rng=generator, **arguments
            )
            images[k], counts[k] = image != 255, len(labels)
    return images, counts


def p_values(first, second):
    """Two-sample tests of area, shape count and per-cell frequency (the last Bonferroni-corrected)."""
    (a, a_counts), (b, b_counts) = first, second
    area = stats.ks_2samp(a.sum(axis=(1, 2)), b.sum(axis=(1, 2))).pvalue
    kinds = np.union1d(a_counts, b_counts)
    table = [[(counts == kind).sum() for kind in kinds] for counts in (a_counts, b_counts)]
    count = stats.chi2_contingency(table).pvalue if len(kinds) > 1 else 1.0
    share_a, share_b = a.mean(axis=0), b.mean(axis=0)
    pooled = (share_a + share_b) / 2
    spread = np.sqrt(pooled * (1 - pooled) * (1 / len(a) + 1 / len(b)))
    z = np.divide(share_a - share_b, spread, out=np.zeros_like(spread), where=spread > 0)
    cells = min(1.0, 2 * stats.norm.sf(np.abs(z).max()) * z.size)
    return {"area": area, "count": count, "cells": cells}


@pytest.mark.parametrize("size", [(32, 32), (50, 50), (12, 20), (8, 8)])
def test_has_the_distribution_of_scikit_image(size):
    for name, p in p_values(ours(size, 3, 8), theirs(size, 3, 8)).items():
        assert p > 0.001, f"{name}: p = {p}"


@pytest.mark.parametrize(
    ("name", "second"),
    [
        ("area", {"fewest": 3, "most": 8, "max_size": 22}),
        ("count", {"fewest": 3, "most": 7}),
        ("cells", {"fewest": 3, "most": 8, "min_size": 3}),
    ],
)
def test_can_tell_other_distributions_apart(name, second):
    assert p_values(ours((32, 32), 3, 8), theirs((32, 32), **second))[name] < 0.001
