"""The cells that polygons cover: against points in cells, and by hand."""

import numpy as np
import pytest

from uavbench.geodata.rasterise import Grid, cells, coverage
from uavbench.world.cells import rows_of

shapely = pytest.importorskip("shapely", reason="importing cities needs pip install 'uavbench[cities]'")

DENSE = 24  # points along each side of a cell


def sampled(shapes, grid):
    """Return the part of each cell's points that lie in any of the shapes."""
    r, c = np.mgrid[: grid.rows * DENSE, : grid.cols * DENSE]
    x, y = grid.west + (c + 0.5) * grid.cell / DENSE, grid.north - (r + 0.5) * grid.cell / DENSE
    inside = np.zeros(r.shape, dtype=bool)
    for shape in shapes:
        inside |= shapely.contains_xy(shape, x, y)
    return inside.reshape(grid.rows, DENSE, grid.cols, DENSE).mean(axis=(1, 3))


def random_shapes(rng, count, extent):
    """Return polygons with many corners, some with a hole, which overlap each other and the border of the map."""
    shapes = []
    for _ in range(count):
        x, y, size = *rng.uniform(-extent, extent, 2), rng.uniform(2, extent / 2)
        angles = np.sort(rng.uniform(0, 2 * np.pi, 9))
        corners = np.column_stack([x + size * np.cos(angles), y + size * np.sin(angles)])
        shape = shapely.Polygon(corners)
        if rng.random() < 0.4:
            shape = shape.difference(shape.centroid.buffer(size / 3))
        shapes.append(shape)
    return shapes


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("grid", [Grid(12, 17, 5.0), Grid(4, 4, 20.0), Grid(31, 9, 3.0)])
def test_the_coverage_is_that_of_many_points(seed, grid):
    shapes = random_shapes(np.random.default_rng(seed), 8, 45)
    exact = coverage(shapes, grid)
    assert exact.min() >= 0
    assert exact.max() <= 1 + 1e-9
    assert 0.05 < exact.mean() < 0.95
    assert np.abs(exact - sampled(shapes, grid)).max() < 2.5 / DENSE
    window = shapely.box(grid.west, -grid.north, -grid.west, grid.north)
    assert exact.sum() * grid.cell**2 == pytest.approx(shapely.union_all(shapes).intersection(window).area)


def rectangle(grid, top, left, bottom, right):
    """Return a rectangle whose sides are given in cells, which may be parts of cells."""
    return shapely.box(
        grid.west + left * grid.cell,
        grid.north - bottom * grid.cell,
        grid.west + right * grid.cell,
        grid.north - top * grid.cell,
    )


GRID = Grid(4, 6, 10.0)


def test_rows_go_south_and_columns_go_east():
    assert coverage([rectangle(GRID, 0, 4, 1, 6)], GRID).tolist() == [[0, 0, 0, 0, 1, 1], [0] * 6, [0] * 6, [0] * 6]
    assert not coverage([], GRID).any()


def test_half_a_cell_is_enough_and_less_is_not():
    drawn = cells([], [rectangle(GRID, 0, 0, 0.5, 1), rectangle(GRID, 0, 2, 0.499, 3)], [], GRID)
    assert rows_of(drawn)[0] == "b....."


def test_neighbours_that_overlap_count_once_and_those_that_meet_add_up():
    left, right = rectangle(GRID, 0, 0, 1, 0.3), rectangle(GRID, 0, 0.7, 1, 1)
    assert rows_of(cells([], [left, left], [], GRID))[0][0] == "."
    assert rows_of(cells([], [left, right], [], GRID))[0][0] == "b"


def test_what_is_high_wins_if_it_covers_half_by_itself():
    low = rectangle(GRID, 0, 0, 1, 3)
    high = [rectangle(GRID, 0, 0, 1, 0.5), rectangle(GRID, 0, 1, 1, 1.4), rectangle(GRID, 0, 4, 1, 4.6)]
    assert rows_of(cells(high, [low], [], GRID))[0] == "#bb.#."
    assert rows_of(cells([rectangle(GRID, 0, 0, 1, 0.3)], [rectangle(GRID, 0, 0.5, 1, 0.8)], [], GRID))[0] == "b....."


def test_a_low_building_in_a_no_fly_zone_cannot_be_flown_over():
    zone = rectangle(GRID, 0, 0, 1, 3)
    assert rows_of(cells([rectangle(GRID, 0, 0, 1, 1)], [rectangle(GRID, 0, 1, 1, 2)], [zone], GRID))[0] == "##N..."


def test_a_large_map_takes_seconds():
    grid = Grid(1024, 1024, 2.0)
    shapes = random_shapes(np.random.default_rng(0), 300, 900)
    covered = coverage(shapes, grid)
    window = shapely.box(-1024, -1024, 1024, 1024)
    assert covered.sum() * 4 == pytest.approx(shapely.union_all(shapes).intersection(window).area)
