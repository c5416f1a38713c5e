"""Areas of cells as polygons: they are the cells, no more and no less."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uavbench import load_scenario
from uavbench.flight.zones import areas_of, areas_without_holes, centres_of
from uavbench.world.city import city_of

shapely = pytest.importorskip("shapely", reason="polygons need shapely: pip install 'uavbench[cities]'")

maps = st.integers(1, 9).flatmap(
    lambda side: st.lists(st.lists(st.booleans(), min_size=side, max_size=side), min_size=2, max_size=9)
)


def cells_in(polygons, shape):
    """The cells whose middle is in one of some polygons, and how many polygons each is in."""
    count = np.zeros(shape, dtype=int)
    for polygon in polygons:
        for r, c in np.ndindex(shape):
            count[r, c] += polygon.contains(shapely.Point(c + 0.5, r + 0.5))
    return count


def polygon(outline, holes=()):
    return shapely.Polygon([(x, y) for y, x in outline], [[(x, y) for y, x in hole] for hole in holes])


@settings(max_examples=60, deadline=None)
@given(rows=maps)
def test_areas_are_the_cells(rows):
    cells = np.array(rows)
    found = [polygon(*area) for area in areas_of(cells)]
    assert all(each.is_valid for each in found)
    np.testing.assert_array_equal(cells_in(found, cells.shape), cells)
    assert sum(each.area for each in found) == pytest.approx(cells.sum())


@settings(max_examples=100, deadline=None)
@given(rows=maps)
def test_areas_without_holes_are_the_cells_too(rows):
    cells = np.array(rows)
    found = [polygon(outline) for outline in areas_without_holes(cells)]
    assert all(each.is_valid for each in found)
    np.testing.assert_array_equal(cells_in(found, cells.shape), cells)
    assert sum(each.area for each in found) == pytest.approx(cells.sum())
    for outline in areas_without_holes(cells):
        assert outline[0] == outline[-1]
        assert all(float(each).is_integer() for corner in outline for each in corner)


@pytest.mark.parametrize("name", ["Manhattan32-CPP-v0", "Urban50-CPP-v0", "Helsinki50-CPP-v0"])
def test_areas_of_whole_cities(name):
    city = city_of(load_scenario(name))
    cells = np.asarray(city.no_fly)
    for found in ([polygon(*area) for area in areas_of(cells)], [polygon(ring) for ring in areas_without_holes(cells)]):
        np.testing.assert_array_equal(cells_in(found, cells.shape), cells)


def test_a_ring_of_cells_is_cut_in_two():
    cells = np.ones((5, 5), dtype=bool)
    cells[2, 2] = False
    assert len(areas_of(cells)) == 1
    assert len(areas_without_holes(cells)) == 2


def test_the_middle_of_an_area_is_one_of_its_cells():
    cells = np.zeros((9, 9), dtype=bool)
    cells[1:4, 1:4] = True
    cells[6, 0:9] = cells[6:9, 8] = True  # an L
    first, second = centres_of(cells)
    assert first == (2, 2)
    assert cells[second]
    assert centres_of(np.zeros((3, 3), dtype=bool)) == []
