"""Maps as text, codes and pictures are the same maps, and wrong ones are refused with the cell."""

import io

import numpy as np
import pytest
from hypothesis import given
from PIL import Image
from worlds import maps

import uavbench
from uavbench.world.cells import BUILDING, CHARACTERS, COLOURS, LANDING, LOW_BUILDING, NO_FLY, cells_of, rows_of
from uavbench.world.city import City
from uavbench.world.maps import check_map, map_picture, read_map, rows_of_array

ROWS = ("LL..", "..#b", "NN.b", "....")


@given(maps())
def test_text_codes_and_arrays_are_the_same_map(rows):
    cells = cells_of(rows)
    assert rows_of(cells) == rows == rows_of_array(cells) == rows_of_array(np.array([list(row) for row in rows]))
    assert [CHARACTERS[code] for code in cells.ravel()] == list("".join(rows))


def test_a_low_building_is_a_building_that_can_be_flown_over():
    city = City(cells_of(ROWS))
    assert np.array_equal(city.building, np.isin(cells_of(ROWS), (BUILDING, LOW_BUILDING)))
    assert np.array_equal(city.no_fly, np.isin(cells_of(ROWS), (BUILDING, NO_FLY)))
    assert not city.visible((0, 3))[2, 3]  # behind a low building
    assert city.distance_to_landing[2, 3] == 4  # over a low building


def test_a_picture_of_a_map_is_read_as_the_map(tmp_path):
    path = tmp_path / "map.png"
    path.write_bytes(map_picture(cells_of(ROWS)))
    assert read_map(path) == ROWS
    (tmp_path / "mine.toml").write_text(
        (uavbench.load_scenario("Block8-CPP-v0").path).read_text().replace("maps/Block8.txt", "map.png")
        .replace("Block8-CPP-v0", "Mine-CPP-v0").split("[splits")[0].replace("local_size = 9", "local_size = 5")
    )  # fmt: skip
    assert uavbench.load_scenario(tmp_path / "mine.toml").rows == ROWS


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            lambda pixels: pixels.__setitem__((2, 1), (1, 2, 3)),
            "the pixel in row 2, column 1 is #010203, the colour of no cell",
        ),
        (lambda pixels: pixels.resize((3, 4, 3), refcheck=False), "3 rows × 4 columns: both must be 4 to 1024"),
    ],
)
def test_a_wrong_picture_is_refused_with_the_pixel(tmp_path, change, expected):
    pixels = np.array(COLOURS, dtype=np.uint8)[cells_of(ROWS)]
    change(pixels)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    (tmp_path / "map.png").write_bytes(buffer.getvalue())
    with pytest.raises(ValueError, match=expected):
        read_map(tmp_path / "map.png")


@pytest.mark.parametrize("content", [b"", b"LL..", b"\x89PNG\r\n\x1a\n" + bytes(100)])
def test_what_is_no_picture_is_refused(tmp_path, content):
    (tmp_path / "map.png").write_bytes(content)
    with pytest.raises(ValueError, match=r"(no|a damaged) PNG picture") as caught:
        read_map(tmp_path / "map.png")
    assert " at 0x" not in str(caught.value)


def test_a_transparent_pixel_is_refused(tmp_path):
    pixels = np.dstack([np.array(COLOURS, dtype=np.uint8)[cells_of(ROWS)], np.full((4, 4), 255, dtype=np.uint8)])
    pixels[1, 2, 3] = 200
    Image.fromarray(pixels).save(tmp_path / "map.png")
    with pytest.raises(ValueError, match="the pixel in row 1, column 2 is transparent"):
        read_map(tmp_path / "map.png")
    pixels[1, 2, 3] = 255
    Image.fromarray(pixels).save(tmp_path / "map.png")
    assert read_map(tmp_path / "map.png") == tuple(ROWS)


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (None, "there are no cells"),
        (np.zeros((0, 0)), "there are no cells"),
        ([], "there are no cells"),
        ([[0, 1], [0]], "its rows have different lengths"),
    ],
)
def test_what_is_no_map_is_refused(cells, expected):
    with pytest.raises(uavbench.UavbenchError, match=expected):
        uavbench.Scenario.from_array(cells)


def test_codes_may_be_pythons_integers_in_an_array_of_objects():
    assert uavbench.Scenario.from_array(cells_of(ROWS).astype(object)).rows == tuple(ROWS)


def test_numbers_that_are_no_codes_are_refused_with_the_cell():
    cells = cells_of(ROWS).astype(int)
    cells[3, 0] = 5
    with pytest.raises(uavbench.UavbenchError, match="row 3, column 0: 5 is no code of a cell"):
        uavbench.Scenario.from_array(cells)
    cells[3, 0] = LANDING
    assert uavbench.Scenario.from_array(cells).rows[3] == "L..."


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (("L#..", "#...", "....", "...."), r"the landing zone at \(0, 0\) is unreachable"),
        (("L.#L", "..##", "....", "...."), r"the landing cell \(0, 3\) is unreachable from the landing cell \(0, 0\)"),
        (("....",) * 4, "no landing cell"),
        (("L..x", *("....",) * 3), "row 0, column 3: unknown cell 'x'"),
        (("L...", "...", "....", "...."), "row 1 has 3 cells"),
    ],
)
def test_a_map_that_cannot_be_flown_is_refused(rows, expected):
    with pytest.raises(ValueError, match=expected):
        check_map(rows)


def test_landing_cells_reached_over_low_buildings_are_reachable():
    check_map(("Lb.L", "##..", "....", "...."))
