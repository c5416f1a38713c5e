"""Changes of long flights, in which only a part is flown again, against flying all of it again."""

import numpy as np
import pytest
from worlds import HARVESTING, scenario

from uavbench import load_scenario
from uavbench.planning import nearby
from uavbench.planning.changes import propose
from uavbench.planning.distances import distances_of
from uavbench.planning.flights import landing_numbers
from uavbench.planning.rates import near_rates
from uavbench.planning.tours import first_flight
from uavbench.world.city import city_of


def collected(path, rates, data, cols):
    """Return the data that each action of a flight collects, and those left: a slow version of what the search does."""
    left, got = data.copy(), []
    for here, there in zip(path[:-1].tolist(), path[1:].tolist(), strict=True):
        action = {-cols: 0, 1: 1, cols: 2, -1: 3, 0: 4}[there - here]
        part, total = range(rates.begin[here], rates.begin[here + 1]), 0.0
        for k in range(rates.rates.shape[2]):
            waiting = [n for n in part if left[rates.devices[n]] > 0.0 and rates.rates[n, action, k] > 0.0]
            if waiting:
                best = max(waiting, key=lambda n: rates.rates[n, action, k])
                taken = min(float(rates.rates[best, action, k]), left[rates.devices[best]])
                left[rates.devices[best]] -= taken
                total += taken
        got.append(total)
    return got, left


@pytest.mark.parametrize("edge_snr", [pytest.param(-30.0, marks=pytest.mark.slow), -10.0])
def test_a_change_gains_what_flying_again_gains(edge_snr):
    urban = load_scenario("Urban50-DH-v0")
    world = scenario(urban.rows, {**HARVESTING, "edge_snr": edge_snr, "devices": (1, 12)})
    city, cols, rng = city_of(world), 50, np.random.default_rng(3)
    devices = np.argwhere(~city.building & ~city.landing)[rng.choice(1500, 12, replace=False)].astype(np.int32)
    data, rates = rng.uniform(5.0, 20.0, 12), near_rates(world, devices, city)
    start = tuple(city.landing_cells[0].tolist())
    reached = np.array([city.distance_to_landing[tuple(each)] >= 0 for each in devices.tolist()])
    flight = first_flight(city, start, 200, devices[reached], data[reached], 0, 50_000)
    path, length = np.zeros(400, dtype=np.int32), len(flight) - 1
    path[: length + 1] = [r * cols + c for r, c in flight]
    flown, trial = nearby.new_record(rates, 400), nearby.new_trial(rates, 400)
    aims = (devices[:, 0] * cols + devices[:, 1]).astype(np.int64)
    new, cursor, served = np.empty(30_000, dtype=np.int32), np.array([7], dtype=np.uint64), np.zeros(12, dtype=np.int32)
    tried = part = 0
    for _ in range(1500):
        before = nearby._fly(path, length, rates, data.copy(), cols, flown)
        got, _ = collected(path[: length + 1], rates, data, cols)
        assert before == pytest.approx(sum(got), rel=1e-9, abs=1e-9)
        fixed = distances_of(city), city.shape, landing_numbers(city), aims, served
        first, after, size = propose(path, length, 380, *fixed, True, length + 1, cursor, new)
        if size < 0:
            continue
        assert length + size - (after - first - 1) <= 380
        gain, affected = nearby._try(path, length, first, after, size, new, rates, data, cols, flown, trial)
        changed = np.concatenate([path[: first + 1], new[:size], path[after : length + 1]])
        again, _ = collected(changed, rates, data, cols)
        assert gain == pytest.approx(sum(again) - sum(got), abs=1e-6)
        kept = dict(zip(trial.action[:affected].tolist(), trial.record.got[:affected].tolist(), strict=True))
        assert [kept[t] for t in kept] == pytest.approx([again[t] for t in kept], abs=1e-9)
        part += affected < len(again) - first
        tried += 1
        if gain >= 0.0 or tried % 5 == 0:
            path[: len(changed)], length = changed, len(changed) - 1
    assert tried > 400
    assert part > 100
