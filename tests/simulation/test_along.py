"""Covering and collecting along a way outside the grid: along the cells of a flight, it is what the flight covered."""

import numpy as np
import pytest

from uavbench import evaluate, load_scenario
from uavbench.evaluation.replay import fly_recorded
from uavbench.simulation.along import collected_along
from uavbench.simulation.simulator import Simulator


class Cells:
    """Notes the cells of the UAVs after each step."""

    def __init__(self):
        self.found = []

    def __call__(self, simulator):
        self.found.append(simulator.state.position[0].copy())


@pytest.mark.parametrize("name", ["Block8-CPP-v0", "Manhattan32-CPP-v0", "Cities32-CPP-v0", "Manhattan32-CPP-Team-v0"])
def test_along_the_cells_of_a_flight_the_same_is_covered(name):
    scenario, result = load_scenario(name), evaluate("greedy", name, episodes=3)
    for number, actions in result.actions().items():
        cells = Cells()
        record = fly_recorded(scenario, "test", number, actions, cells)
        flown = [(actions[:, uav] < 6).sum() for uav in range(record.uavs)]
        # Nothing is covered at the start and in the step that lands.
        ways = [np.array([cell[uav] for cell in cells.found[1 : flown[uav]]], dtype=float) for uav in range(record.uavs)]
        assert collected_along(scenario, "test", number, ways) == pytest.approx(record.cr)


def test_radio_serves_from_where_the_uav_is():
    """Against the rule, slowly: the device with the highest rate is served, without fading."""
    scenario = load_scenario("Block8-DH-v0")
    random = np.random.default_rng(0)
    way = random.uniform(0, 7, (12, 2))
    simulator = Simulator(scenario, 1)
    simulator.reset([0], "test", [5])
    mission = scenario.mission
    calm = mission.fading_variance.model_copy(update={"los": 0.0, "nlos": 0.0})
    quiet = scenario.model_copy(update={"mission": mission.model_copy(update={"fading_variance": calm})})
    devices = simulator.mission.devices
    count = int(devices.number[0])
    cells, data = devices.cell[0, :count], devices.data[0, :count].astype(float)
    total, city = data.sum(), simulator.city
    far = max(scenario.shape) * mission.cell_size * 2**0.5 / 2
    for row, col in way:
        best, highest = -1, -1.0
        for k, (r, c) in enumerate(cells.tolist()):
            if data[k] <= 0:
                continue
            seen = city.visible((r, c))[round(row), round(col)]
            exponent = mission.path_loss_exponent.los if seen else mission.path_loss_exponent.nlos
            distance = ((mission.cell_size**2 * ((row - r) ** 2 + (col - c) ** 2)) + mission.altitude**2) ** 0.5
            snr = 10 ** (mission.edge_snr / 10) * far**mission.path_loss_exponent.los * distance**-exponent
            rate = np.log2(1 + snr)
            if rate > highest:
                best, highest = k, rate
        if best >= 0:
            data[best] -= min(highest, data[best])
    assert collected_along(quiet, "test", 5, [way]) == pytest.approx(1 - data.sum() / total, abs=1e-6)


def test_noise_belongs_to_the_step_and_places_off_the_map_count_as_the_nearest_cell():
    scenario = load_scenario("Block8-DH-v0")
    way = np.tile([[3.2, 4.1]], (6, 1))
    assert collected_along(scenario, "test", 1, [way]) == collected_along(scenario, "test", 1, [way])
    outside, edge = np.tile([[-3.0, 20.0]], (6, 1)), np.tile([[0.0, 7.0]], (6, 1))
    assert collected_along(scenario, "test", 1, [outside]) == collected_along(scenario, "test", 1, [edge])
    assert collected_along(scenario, "test", 1, [np.zeros((0, 2))]) == 0.0
    more = [collected_along(scenario, "test", 1, [way[:k]]) for k in range(7)]
    assert more == sorted(more)
    assert more[-1] > more[0]
