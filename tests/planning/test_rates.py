"""Rates of the devices near a cell are those of the table of all devices."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import HARVESTING, draw_devices, maps, scenario

from uavbench import load_scenario
from uavbench.planning.rates import NearRates, expected_rates, near_rates
from uavbench.world.city import city_of


def check(world, devices):
    city, (rows, cols) = city_of(world), world.shape
    near, whole = near_rates(world, devices, city), expected_rates(world, devices, city)
    assert isinstance(near, NearRates)
    for cell in range(rows * cols):
        r, c = divmod(cell, cols)
        part = slice(near.begin[cell], near.begin[cell + 1])
        reached = np.abs(devices - (r, c)).max(axis=1) <= near.reach
        assert near.devices[part].tolist() == np.flatnonzero(reached).tolist()
        assert np.array_equal(near.rates[part], np.moveaxis(whole[cell][..., reached], -1, 0))
    return near, whole


@settings(max_examples=20)
@given(st.data())
def test_on_a_small_map(data):
    rows = data.draw(maps())
    check(scenario(rows, HARVESTING), np.array([[r, c] for r, c, _ in draw_devices(data, rows)], dtype=np.int32))


def test_what_is_not_near_is_hardly_above_0():
    world = load_scenario("Urban50-DH-v0")
    devices = np.array([[10, 12], [25, 30], [48, 3]], dtype=np.int32)
    near, whole = check(world, devices)
    assert 1 < near.reach <= 20
    for j, (y, x) in enumerate(devices.tolist()):
        far = [r * 50 + c for r in range(50) for c in range(50) if max(abs(r - y), abs(c - x)) > max(near.reach, 20)]
        assert whole[far, 4, :, j].sum(axis=1).max() < 2.0
