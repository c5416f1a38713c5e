"""Landing zones on a map, and what is closed because no UAV can get there."""

import numpy as np
import pytest

from uavbench.geodata.landing import choose_zones, close_unreachable, place_zones
from uavbench.geodata.libraries import GeodataError
from uavbench.world.cells import cells_of, rows_of
from uavbench.world.maps import check_map


def random_map(seed, shape=(30, 40), share=0.5):
    rng = np.random.default_rng(seed)
    cells = np.zeros(shape, dtype=np.uint8)
    while (cells > 0).mean() < share:
        r, c = rng.integers(shape[0]), rng.integers(shape[1])
        cells[r : r + rng.integers(1, 7), c : c + rng.integers(1, 7)] = rng.choice([2, 3, 3, 4])
    return cells


@pytest.mark.parametrize("share", [0.1, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("seed", range(8))
def test_chosen_zones_are_free_connected_and_apart(seed, share):
    cells = random_map(seed, share=share)
    zones = choose_zones(cells)
    placed = place_zones(cells, zones)  # which refuses cells that are not free
    check_map(rows_of(placed))
    assert int((placed == 1).sum()) == sum(height * width for _, _, height, width in zones)
    if share <= 0.5:
        assert [zone[2:] for zone in zones] == [(3, 3), (3, 3)]
        (r, c, _, _), (y, x, _, _) = zones
        assert abs(r - y) + abs(c - x) >= 10
    assert choose_zones(cells.copy()) == zones


def test_an_empty_map_has_zones_in_two_corners_with_space_around():
    assert choose_zones(np.zeros((50, 50), dtype=np.uint8)) == [(44, 44, 3, 3), (3, 3, 3, 3)]


def test_zones_are_in_the_open_if_that_is_not_too_near():
    rows = ["#" * 40, *["#" + "." * 38 + "#"] * 9, *["#" + "." * 3 + "#" * 32 + "." * 3 + "#"] * 20, "#" * 40]
    zones = choose_zones(cells_of(rows))
    assert all(row + 3 <= 10 and row >= 4 for row, *_ in zones)


def test_where_there_is_little_room_zones_are_small():
    assert [zone[2:] for zone in choose_zones(cells_of(["####", "#..#", "#.b#", "#..#"]))] == [(1, 1)]
    assert [zone[2:] for zone in choose_zones(cells_of(["####", "#..#", "#..#", "#.##"]))] == [(2, 2)]
    assert choose_zones(cells_of(["####", "#.b#", "####", "####"])) == [(1, 1, 1, 1)]


@pytest.mark.parametrize(
    "rows",
    [["...", "...", "..."], ["####", "#..#", "#..#", "####"], ["#.##", "#.##", "####", "####"], ["....", "####", "####"]],
)
def test_zones_leave_something_to_fly_in(rows):
    placed = place_zones(cells_of(rows), choose_zones(cells_of(rows)))
    assert (placed == 1).any()
    assert (placed == 0).any()


@pytest.mark.parametrize("rows", [["bbbb"] * 4, ["NN#N"] * 4, [".#.#", "#.#.", ".#N#", "#.#."]])
def test_where_no_uav_could_take_off_there_is_no_zone(rows):
    assert choose_zones(cells_of(rows)) == []


def test_zones_are_in_the_region_with_the_most_free_cells():
    rows = ["....#bbbbbbb", "....#bbbbbbb", "....#bbbb...", "....#bbbb...", "....#bbbb..."]
    assert all(col < 4 for _, col, _, _ in choose_zones(cells_of(rows)))


@pytest.mark.parametrize(
    ("zone", "reason"),
    [
        ((3, 0, 2, 1), "landing: the zone 3,0,2,1 is not on the map of 4 rows × 4 columns"),
        ((0, 4, 1, 1), "is not on the map"),
        ((0, 0, 0, 1), "is not on the map"),
        ((-1, 0, 1, 1), "is not on the map"),
        ((0, 0, 2, 2), "landing: the zone 0,0,2,2 is not free: row 1, column 1 is a building"),
        ((2, 0, 1, 1), "row 2, column 0 is a low building"),
    ],
)
def test_a_given_zone_must_be_free(zone, reason):
    with pytest.raises(GeodataError, match=reason):
        place_zones(cells_of(["....", ".#..", "b...", "...."]), [zone])


@pytest.mark.parametrize(
    ("zones", "reason"),
    [
        (
            [(0, 0, 1, 1), (0, 3, 2, 1)],
            "no UAV can fly between the zones 0,0,1,1 and 0,3,2,1, because buildings or no-fly zones",
        ),
        ([(0, 0, 4, 2)], "landing: the zones leave no other cell that a UAV can fly to"),
        ([(0, 0, 4, 1), (0, 1, 4, 1)], "landing: the zones leave no other cell that a UAV can fly to"),
    ],
)
def test_given_zones_must_be_of_use(zones, reason):
    with pytest.raises(GeodataError, match=reason):
        place_zones(cells_of(["..#."] * 4), zones)


def test_what_no_uav_can_reach_is_closed():
    rows = ["L....####", ".b...#.b#", ".....#..#", ".....####"]
    closed, count = close_unreachable(cells_of(rows))
    assert rows_of(closed) == ("L....####", ".b...#N##", ".....#NN#", ".....####")
    assert count == 4
    assert close_unreachable(closed)[1] == 0
