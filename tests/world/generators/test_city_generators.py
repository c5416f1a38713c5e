"""Drawn cities: what holds for every key, shape and parameters; that the bits of a name never change; what cities look like."""

import hashlib
import importlib
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from uavbench.world.cells import BUILDING, FREE, LANDING, LOW_BUILDING, NO_FLY, rows_of
from uavbench.world.city import City
from uavbench.world.generators import GENERATORS, check_demands, draw_cities
from uavbench.world.generators.parameters import CityParameters
from uavbench.world.maps import check_map

NAMES = list(GENERATORS)


def draw(name, keys, shape=(32, 32), reach=60, min_landing=1, min_places=1, **parameters):
    out = np.full((len(keys), *shape), 77, dtype=np.uint8)
    draw_cities(name, np.array(keys, dtype=np.uint64), CityParameters(**parameters), reach, min_landing, min_places, out)
    return out


def check_guarantees(cells, reach, min_landing, min_places):
    check_map(rows_of(cells))
    assert cells.max() <= LOW_BUILDING
    assert (cells == LANDING).sum() >= min_landing
    assert np.isin(cells, (FREE, NO_FLY)).sum() >= min_places
    distance = City(cells).distance_to_landing
    flyable = np.isin(cells, (FREE, LANDING, LOW_BUILDING))
    assert (distance[flyable] >= 0).all()
    assert 20 * (distance[flyable] <= reach).sum() >= 19 * flyable.sum()


def ranges(values):
    return st.tuples(values, values).map(sorted).map(tuple)


@st.composite
def demands(draw, largest):
    """Any arguments that are allowed, with the shape."""
    shape = draw(st.tuples(st.integers(8, largest), st.integers(8, largest)))
    min_landing = draw(st.integers(1, min(20, shape[0] * shape[1] // 2)))
    return {
        "shape": shape,
        "reach": draw(st.integers(4, 80)),
        "min_landing": min_landing,
        "min_places": draw(st.integers(0, min(150, shape[0] * shape[1] // 2 - min_landing))),
        "building_share": draw(ranges(st.floats(0, 0.8))),
        "low_share": draw(ranges(st.floats(0, 1))),
        "no_fly_zones": draw(ranges(st.integers(0, 32))),
        "no_fly_size": draw(ranges(st.integers(1, 32))),
        "landing_zones": draw(ranges(st.integers(1, 32))),
        "landing_size": draw(ranges(st.integers(1, 32))),
    }


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=60)
@given(start=st.integers(0, 2**64 - 4), wanted=demands(40))
def test_the_guarantees_hold_for_all_keys_shapes_and_parameters(name, start, wanted):
    for cells in draw(name, range(start, start + 4), **wanted):
        check_guarantees(cells, wanted["reach"], wanted["min_landing"], wanted["min_places"])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("shape", [(8, 8), (8, 200), (200, 8), (60, 90)])
def test_the_guarantees_hold_for_hard_demands(name, shape):
    half = shape[0] * shape[1] // 2
    for share in (0.0, 0.4, 0.8):
        for reach, min_landing in ((4, 1), (4, half - min(half // 2, 500)), (1000, 16)):
            places = min(half - min_landing, 500)
            keys = range(6)
            for cells in draw(
                name, keys, shape, reach, min_landing, places, building_share=(share, share), no_fly_zones=(8, 8)
            ):
                check_guarantees(cells, reach, min_landing, places)


@pytest.mark.parametrize("name", NAMES)
def test_the_guarantees_hold_for_large_maps(name):
    for cells in draw(name, [7, 2**63], (512, 512), reach=50, min_landing=16, min_places=100):
        check_guarantees(cells, 50, 16, 100)


@pytest.mark.parametrize("name", NAMES)
def test_a_city_depends_on_its_key_alone(name):
    keys = [5, 2**64 - 1, 0, 12345678901234567890, 5]
    drawn = draw(name, keys, (20, 30))
    for k, key in enumerate(keys):
        assert np.array_equal(drawn[k], draw(name, [key], (20, 30))[0])
    assert np.array_equal(drawn[::-1], draw(name, keys[::-1], (20, 30)))
    assert np.array_equal(drawn[0], drawn[4])


@pytest.mark.parametrize("name", NAMES)
def test_different_keys_draw_different_cities(name):
    assert len({cells.tobytes() for cells in draw(name, range(500))}) == 500


def test_generators_draw_different_cities():
    first = {name: draw(name, range(20)) for name in NAMES[:4]}
    for name, cities in first.items():
        for other, others in first.items():
            assert name == other or not (cities == others).all(axis=(1, 2)).any()
    mixed = draw("mixed-v0", range(20))
    assert len({cells.tobytes() for cells in mixed}) == 20


def test_another_process_draws_the_same_cities():
    code = (
        "import hashlib, numpy as np\n"
        "from uavbench.world.generators import draw_cities\n"
        "from uavbench.world.generators.parameters import CityParameters\n"
        "out = np.empty((20, 24, 40), dtype=np.uint8)\n"
        "draw_cities('organic-v0', np.arange(20, dtype=np.uint64), CityParameters(), 30, 2, 3, out)\n"
        "print(hashlib.sha256(out.tobytes()).hexdigest())\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    here = draw("organic-v0", range(20), (24, 40), 30, 2, 3)
    assert done.stdout.strip() == hashlib.sha256(here.tobytes()).hexdigest()


def test_names_and_parameters_are_read_without_numba():
    code = "import sys, uavbench.world.generators, uavbench.world.generators.parameters\nassert 'numba' not in sys.modules\n"
    subprocess.run([sys.executable, "-c", code], check=True)


#: SHA-256 of 200 cities of 32 × 32 cells, and of one of 128 × 96. They must never change: other bits need another name.
DIGESTS = {
    "blocks-v0": (
        "5845f3163a19ed46dfe9c97b55dd13682f7e155da1464a92e40f2112bc58879a",
        "543561d5f6f6e2b2c30e2a7107de4a9c3fa618dc52154c5b046a66c969cf9b7f",
    ),
    "courtyards-v0": (
        "a9d4d100cb3f1b49b96f9dde177eeb94c51796daf8a73f1f3d95b8c8740face4",
        "e3815b4c5ba6d55f4595372a70a547b5cc689e14b745b12d0460e776ae0f7479",
    ),
    "organic-v0": (
        "d0a6be313191dbd0c7cb8b7a4fcf1e0a29fe1f34ac8f38165eca616a0928ca2e",
        "1933c8c4471b61f46287342f711a671a3d62c144c7de3df581942a288cad8113",
    ),
    "campus-v0": (
        "94d69eef1be122e73f4a6beae1d356a26d90ec6be8a2efd9af8123b860f70655",
        "03412ad12c60ed0801d8c937501c49e718e466d0e4ea68d5de209a7c5a030b01",
    ),
    "mixed-v0": (
        "2a472b82add684d95660ea07f908e443e65cf72921561f5131fb1c8557133b8c",
        "015176285d727aed2bf2727fe04b3e253a10be9002f3d78c5fa9b426ef145a15",
    ),
}


@pytest.mark.parametrize("name", NAMES)
def test_the_cities_of_a_name_never_change(name):
    digests = (draw(name, range(200), reach=25, min_landing=2, min_places=10), draw(name, [99], (128, 96), 40, 3, 10))
    assert tuple(hashlib.sha256(cities.tobytes()).hexdigest() for cities in digests) == DIGESTS[name]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("key", [0, 1, 2])
def test_the_docstring_shows_what_is_drawn(name, key):
    module = importlib.import_module(f"uavbench.world.generators.{name.removesuffix('-v0')}")
    rows = rows_of(draw(name, [key], (12, 30))[0])
    assert f"Key {key}::\n\n" + "\n".join(f"    {row}" for row in rows) + "\n" in module.__doc__


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("shape", [(24, 24), (32, 32), (64, 80)])
def test_buildings_cover_the_wanted_share(name, shape):
    for share in (0.15, 0.3, 0.45):
        cities = draw(name, range(150), shape, building_share=(share, share))
        drawn = (cities >= BUILDING).mean(axis=(1, 2))
        assert abs(drawn.mean() - share) < 0.01
        assert abs(drawn - share).max() < 0.05


@pytest.mark.parametrize("name", NAMES)
def test_the_share_is_drawn_from_its_range(name):
    drawn = (draw(name, range(300), building_share=(0.2, 0.45)) >= BUILDING).mean(axis=(1, 2))
    assert drawn.min() < 0.25
    assert drawn.max() > 0.4
    assert drawn.mean() == pytest.approx(0.325, abs=0.02)


@pytest.mark.parametrize("name", NAMES)
def test_whole_buildings_are_low_and_their_share_is_about_the_wanted_one(name):
    for share in (0.0, 0.3, 1.0):
        cities = draw(name, range(200), low_share=(share, share), building_share=(0.25, 0.25), no_fly_zones=(0, 0))
        assert (cities == LOW_BUILDING).sum() / (cities >= BUILDING).sum() == pytest.approx(share, abs=0.03)
        if share == 0.3:
            low, high = cities == LOW_BUILDING, cities == BUILDING
            sides = [(low[:, 1:], high[:, :-1]), (low[:, :-1], high[:, 1:]), (low[:, :, 1:], high[:, :, :-1])]
            touching = sum((one & other).sum() for one, other in sides)
            assert touching < 0.01 * low.sum()  # tiny pockets are closed with high buildings


@pytest.mark.parametrize("name", NAMES)
def test_zones_are_there_and_landing_zones_are_in_the_open(name):
    cities = draw(name, range(200), no_fly_zones=(3, 3), landing_zones=(2, 2), landing_size=(2, 2), building_share=(0.3, 0.3))
    zones = draw(name, range(200), no_fly_zones=(0, 0), landing_zones=(1, 1), landing_size=(3, 3), building_share=(0.3, 0.3))
    assert (cities == NO_FLY).any(axis=(1, 2)).mean() > 0.97
    assert not (zones == NO_FLY).any()
    landing = (cities == LANDING).sum(axis=(1, 2))
    assert np.median(landing) == 8
    assert landing.min() >= 4
    assert np.median((zones == LANDING).sum(axis=(1, 2))) == 9


def test_a_short_reach_needs_more_landing_zones():
    far, near = (draw("blocks-v0", range(50), (64, 64), reach, landing_zones=(1, 1)) for reach in (200, 15))
    assert (near == LANDING).sum() > 3 * (far == LANDING).sum()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("building_share", (0.5, 0.4)),
        ("building_share", (0.1, 0.9)),
        ("low_share", (-0.1, 0.5)),
        ("low_share", (0.5, float("nan"))),
        ("no_fly_zones", (0, 33)),
        ("no_fly_size", (0, 3)),
        ("landing_zones", (0, 2)),
        ("landing_size", (4, 2)),
        ("landing_size", (2.5, 3)),
        ("streets", (1, 2)),
    ],
)
def test_wrong_parameters_are_refused_by_name(field, value):
    with pytest.raises(ValidationError, match=field):
        CityParameters.model_validate({field: value})


def test_parameters_are_encoded_in_the_order_of_the_attributes():
    parameters = CityParameters()
    flat = [bound for field in CityParameters.model_fields for bound in getattr(parameters, field)]
    assert parameters.encoded().tolist() == flat


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"shape": (7, 30)}, "shape"),
        ({"shape": (30, 1025)}, "shape"),
        ({"reach": 3}, "reach"),
        ({"min_landing": 0}, "min_landing"),
        ({"min_places": -1}, "min_places"),
        ({"shape": (8, 8), "min_places": 32}, "min_landing"),
    ],
)
def test_impossible_demands_are_refused_by_name(wrong, named):
    demands = {"shape": (8, 8), "reach": 4, "min_landing": 1, "min_places": 31}
    check_demands(**demands)
    with pytest.raises(ValueError, match=rf"^{named}"):
        check_demands(**(demands | wrong))


def test_wrong_arrays_and_names_are_refused():
    keys, out = np.zeros(2, dtype=np.uint64), np.zeros((2, 10, 10), dtype=np.uint8)
    for name, wrong_keys, wrong_out, named in (
        ("villages-v0", keys, out, "generator"),
        ("blocks-v0", keys.astype(np.int64), out, "keys"),
        ("blocks-v0", keys[:1], out, "keys"),
        ("blocks-v0", keys, out.astype(np.int8), "out"),
        ("blocks-v0", keys, out.transpose(0, 2, 1), "out"),
        ("blocks-v0", keys, out[0], "shape"),
    ):
        with pytest.raises(ValueError, match=rf"^{named}"):
            draw_cities(name, wrong_keys, CityParameters(), 10, 1, 1, wrong_out)
