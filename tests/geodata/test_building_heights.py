"""The heights that tags give, in all the ways in which people write them."""

import math

import pytest

from uavbench.geodata.heights import building_height, parse_height


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("12", 12),
        ("12 m", 12),
        ("12.5m", 12.5),
        ("12,5 m", 12.5),
        (" 12.13 m ", 12.13),
        ("12 metres", 12),
        ("12 Meter", 12),
        ("40'", 40 * 0.3048),
        ("40 ft", 40 * 0.3048),
        ("40′", 40 * 0.3048),
        ("40 feet", 40 * 0.3048),
        ("40'6\"", 40.5 * 0.3048),
        ("5 ft 6 in", 5.5 * 0.3048),
        ("3;4", 4),
        ("4 m; 3 m;", 4),
        (18, 18),
        (7.5, 7.5),
    ],
)
def test_a_height_is_read(text, metres):
    assert parse_height(text) == pytest.approx(metres)


@pytest.mark.parametrize(
    "rubbish",
    [
        *(None, "", ";", "high", "~12", "12-15", "12 km", "-3", "0", "1e3", "٣", "nan", "inf", "1001", "3;x", "9" * 5000),
        *(math.nan, math.inf, -1, 0, True, [12], {"m": 12}),
    ],
)
def test_rubbish_counts_as_missing(rubbish):
    assert parse_height(rubbish) is None


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        ({"height": "20", "building:levels": "3"}, (20, "height")),
        ({"height": "high", "building:levels": "3"}, (9, "levels")),
        ({"building:levels": "3.5"}, (10.5, "levels")),
        ({"building:levels": "2;5"}, (15, "levels")),
        ({"num_floors": 4}, (12, "levels")),
        ({"levels": "2"}, (6, "levels")),
        ({"building:levels": "0", "levels": "2"}, (6, "levels")),
        ({"building:levels": "five"}, (None, "default")),
        ({"building:levels": "301"}, (None, "default")),
        ({}, (None, "default")),
    ],
)
def test_height_counts_before_levels(tags, expected):
    assert building_height(tags) == expected
