"""Pictures of a running episode: what happened is what is shown, in pixels and in text."""

import numpy as np
import pytest
from worlds import HARVESTING, scenario

from uavbench import load_scenario
from uavbench.drawing import scene
from uavbench.drawing.raster import frame, text
from uavbench.drawing.scene import scene_of
from uavbench.drawing.trail import Trail
from uavbench.simulation.simulator import Simulator

ROWS = ("....L.", "......", "..##..", "......")
NORTH, EAST, SOUTH, WEST, HOVER, LAND = range(6)


def begin(world, **options):
    simulator = Simulator(world, 1)
    simulator.reset([0], "train", [0])
    simulator.customise(0, {"start": [0, 4], "budget": 9, **options})
    return simulator, Trail(simulator, 0)


def fly(simulator, trail, actions):
    for action in actions:
        simulator.step([action])
        trail.extend()


def coverage(*cells):
    targets = np.zeros((4, 6), dtype=bool)
    for cell in cells:
        targets[cell] = True
    return begin(scenario(ROWS, budget=(5, 40)), targets=targets)


def test_a_scene_shows_moves_hovers_and_the_way_home():
    simulator, trail = coverage((0, 0), (3, 5))
    fly(simulator, trail, [WEST, SOUTH, HOVER])
    found = scene_of(simulator, 0, trail)
    assert [(here, there) for here, there, _ in found.moves] == [((0, 4), (0, 3)), ((0, 3), (1, 3))]
    assert [cell for cell, _ in found.hovers] == [(1, 3)]
    assert [cell for cell, _ in found.starts] == [(0, 4)]
    assert found.ends == []
    assert [cell for cell, _ in found.uavs] == [(1, 3)]
    assert found.title.startswith("Movement 3/9, CR = ")
    fly(simulator, trail, [NORTH, EAST, LAND])
    found = scene_of(simulator, 0, trail)
    assert [cell for cell, _ in found.ends] == [(0, 4)]
    assert found.uavs == []
    assert [cell for cell, _ in found.hovers] == [(1, 3)]  # landing is no hover
    assert found.title.startswith("Movement 6/9")


def test_a_crash_is_no_landing():
    simulator, trail = coverage((0, 0))
    fly(simulator, trail, [SOUTH] + [HOVER] * 8)
    found = scene_of(simulator, 0, trail)
    assert (found.crashes, found.ends, found.uavs) == ([(1, 4)], [], [])
    assert found.title == "Movement 9/9, CR = 0.00, crashed"
    assert tuple(frame(simulator, 0, trail)[1 * 85 + 42 - 30, 4 * 85 + 42]) == scene.CRASH


def test_hovers_are_seen_above_devices():
    simulator, trail = begin(scenario(ROWS, HARVESTING, budget=(5, 40)), devices=[[1, 3, 20.0]])
    fly(simulator, trail, [WEST, SOUTH, EAST])
    before = frame(simulator, 0, trail)[85:170, 3 * 85 : 4 * 85]
    simulator, trail = begin(scenario(ROWS, HARVESTING, budget=(5, 40)), devices=[[1, 3, 20.0]])
    fly(simulator, trail, [WEST, SOUTH, HOVER, EAST])
    after = frame(simulator, 0, trail)[85:170, 3 * 85 : 4 * 85]
    assert len(scene_of(simulator, 0, trail).hovers) == 1
    assert ((before != after).any(axis=2) & (after == 255).all(axis=2)).sum() > 100  # the rim of the cross


def test_targets_change_colour_when_they_are_covered():
    simulator, trail = coverage((0, 2), (3, 0))
    before = scene_of(simulator, 0, trail).cells
    fly(simulator, trail, [WEST])
    after = scene_of(simulator, 0, trail).cells
    assert (before[0, 2] != after[0, 2]).any()
    assert (before[3, 0] == after[3, 0]).all()
    assert (before[0, 2] == before[3, 0]).all()
    changed = np.zeros((4, 6), dtype=bool)
    changed[0, 2] = True
    assert ((before != after).any(axis=2) == changed).all()


def test_moves_have_the_colour_of_the_device_that_was_served_most():
    simulator, trail = begin(scenario(ROWS, HARVESTING, budget=(5, 40)), devices=[[3, 0, 2.0], [1, 4, 5.0]], noise=False)
    data = simulator.mission.view(0)["device_data"].copy()
    expected = []
    for action in (WEST, WEST, WEST, WEST, SOUTH, SOUTH):
        fly(simulator, trail, [action])
        now = simulator.mission.view(0)["device_data"].copy()
        expected.append(int((data - now).argmax()) if (data > now).any() else -1)
        data = now
    assert {0, 1} <= set(expected)
    found = scene_of(simulator, 0, trail)
    assert [colour for _, _, colour in found.moves] == [scene.PATH if d < 0 else scene.DEVICES[d] for d in expected]
    assert [device.left for device in found.devices] == pytest.approx([data[0] / 2.0, data[1] / 5.0])


def test_shadows_are_where_devices_are_not_in_sight():
    simulator, trail = begin(scenario(ROWS, HARVESTING, budget=(5, 40)), devices=[[3, 2, 2.0]])
    assert np.array_equal(trail.shade == 0, simulator.city.visible((3, 2)) | simulator.city.building)
    cells = scene_of(simulator, 0, trail).cells
    assert (cells[3, 3] == 255).all()
    assert trail.shade[0, 2] == 1
    assert (cells[0, 2] == int(255 * scene.SHADOW)).all()


def test_a_trail_ends_with_the_episode():
    simulator, trail = coverage((0, 0))
    fly(simulator, trail, [LAND, EAST, EAST])
    assert trail.cells == [[(0, 4), (0, 4)]]


def test_teams_have_a_colour_a_uav():
    simulator = Simulator(load_scenario("Manhattan32-CPP-Team-v0"), 1)
    simulator.reset([0], "test", [13])
    trail = Trail(simulator, 0)
    simulator.step([[EAST] * 3])
    trail.extend()
    found = scene_of(simulator, 0, trail)
    assert len(found.uavs) == int(simulator.state.uavs[0]) > 1
    assert len({colour for _, colour in found.uavs}) == len(found.uavs)
    assert {colour for _, _, colour in found.moves} <= {colour for _, colour in found.uavs}


@pytest.fixture
def simulator():
    simulator = Simulator(load_scenario("Block8-CPP-v0"), 2)
    simulator.reset([0, 1], "test", [0, 1])
    return simulator


def test_text_shows_uav_path_and_targets(simulator):
    r, c = simulator.state.position[1, 0].tolist()
    head, *rows = text(simulator, 1, Trail(simulator, 1)).splitlines()
    assert rows[r][c] == "@"
    shown = np.array([[cell in "+@" for cell in row] for row in rows])
    assert (simulator.state.target[1] > 0)[~shown].sum() == 0
    assert f"budget {simulator.state.budget[1, 0]}" in head


def test_a_frame_shows_what_changes(simulator):
    trail = Trail(simulator, 0)
    before = frame(simulator, 0, trail)
    assert before.shape == (512, 512, 3)
    simulator.step([SOUTH, SOUTH])
    trail.extend()
    after = frame(simulator, 0, trail)
    r, c = np.argwhere(simulator.city.building)[0] * 64 + 5
    assert (before[r, c] == after[r, c]).all()
    (r0, c0), (r1, c1) = trail.cells[0]
    assert (r0, c0) != (r1, c1)
    for r, c in trail.cells[0]:
        assert (before[r * 64 + 32, c * 64 + 32] != after[r * 64 + 32, c * 64 + 32]).any()
    assert tuple(after[r1 * 64 + 32, c1 * 64 + 32]) == scene.UAVS[0]


def test_marks_at_the_edge_are_cut_off():
    simulator, trail = begin(scenario(("L....", ".....", ".....", ".....")), start=[0, 0])
    fly(simulator, trail, [HOVER, EAST, SOUTH, SOUTH, SOUTH, HOVER])
    assert frame(simulator, 0, trail).shape == (4 * 102, 5 * 102, 3)


def test_frames_need_not_be_square():
    simulator, trail = begin(scenario(ROWS))
    assert frame(simulator, 0, trail).shape == (4 * 85, 6 * 85, 3)
