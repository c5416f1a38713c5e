"""Pictures of a running episode."""

import numpy as np
import pytest

from uavbench import load_scenario
from uavbench.render import frame, text
from uavbench.simulator import Simulator


@pytest.fixture
def simulator():
    simulator = Simulator(load_scenario("Block8-CPP-v0"), 2)
    simulator.reset([0, 1], "test", [0, 1])
    return simulator


def test_text_shows_uav_path_and_targets(simulator):
    r, c = simulator.state.position[1, 0].tolist()
    head, *rows = text(simulator, 1, [[(r, c)]]).splitlines()
    assert rows[r][c] == "@"
    shown = np.array([[cell in "+@" for cell in row] for row in rows])
    assert (simulator.state.target[1] > 0)[~shown].sum() == 0
    assert f"budget {simulator.state.budget[1, 0]}" in head


def test_a_frame_shows_what_changes(simulator):
    before = frame(simulator, 0, [])
    assert before.shape == (512, 512, 3)
    simulator.step([4, 4])
    covered = frame(simulator, 0, [])
    r, c = np.argwhere(simulator.city.building)[0] * 64 + 5
    assert (before[r, c] == covered[r, c]).all()
    simulator.state.position[0, 0] = (0, 2)
    assert (frame(simulator, 0, [[(0, 0), (0, 2)]]) != covered).any()


def test_frames_need_not_be_square():
    from worlds import scenario

    simulator = Simulator(scenario(("....L.", "......", "..##..", "......")), 1)
    simulator.reset([0], "train", [0])
    assert frame(simulator, 0, []).shape == (4 * 85, 6 * 85, 3)
