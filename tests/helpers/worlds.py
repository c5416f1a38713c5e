"""Small scenarios for tests, with maps of any shape, made in memory."""

from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from uavbench import Scenario
from uavbench.world.cells import rows_of

COVERAGE = {"kind": "coverage", "camera_size": 5, "shapes": (1, 3), "target_fraction": (0.1, 0.9)}
HARVESTING = {
    "kind": "harvesting",
    "devices": (1, 3),
    "data": (1.0, 20.0),
    "communication_steps": 4,
    "cell_size": 10.0,
    "altitude": 10.0,
    "edge_snr": -15.0,
    "path_loss_exponent": {"los": 2.27, "nlos": 3.64},
    "fading_variance": {"los": 2.0, "nlos": 5.0},
}
SIZES = st.tuples(st.sampled_from([1, 3, 5, 7]), st.integers(1, 7))  # local sizes and global scales
SURVEILLANCE = {
    "kind": "surveillance",
    "file": Path(__file__).with_name("surveillance.py"),
    "sites": (3, 6),
    "reach": 1,
    "cooldown": 4,
}


def scenario(rows, mission=COVERAGE, **changes):
    """Return a scenario on the map ``rows``."""
    values = {
        "id": "Test-v0",
        "title": "",
        "map": "",
        "budget": (5, 40),
        "rewards": {"movement": -0.2, "safety": -1.0, "crash": -150.0, "collect": 0.4},
        "observation": {"local_size": 5, "global_scale": 3},
        "mission": mission,
        "splits": {"validation": {"episodes": 20}, "test": {"episodes": 50}},
        "rows": tuple(rows),
        "path": "test.toml",
    }
    return Scenario(**{**values, **changes})


def in_city(world, city):
    """Return a scenario with one of its cities as the only map: its episodes in this city are the same."""
    same = {name: getattr(world, name) for name in Scenario.model_fields}
    return Scenario.model_validate({**same, "cities": None, "rows": rows_of(city.cells)})


@st.composite
def maps(draw, smallest=4, largest=9, landing=(1, 3)):
    """Draw a map of any shape with one landing zone, a row of cells, whose number is in the range ``landing``."""
    rows, cols = draw(st.integers(smallest, largest)), draw(st.integers(smallest, largest))
    cells = draw(st.lists(st.sampled_from("....N##b"), min_size=rows * cols, max_size=rows * cols))
    grid = np.array(cells).reshape(rows, cols)
    r, c = draw(st.integers(0, rows - 1)), draw(st.integers(0, cols - landing[0]))
    grid[r, c : c + draw(st.integers(*landing))] = "L"
    grid[r + 1 if r + 1 < rows else r - 1] = "."  # somewhere to fly and to put devices
    return tuple("".join(row) for row in grid.tolist())


def draw_start(data, rows):
    """Draw a landing cell."""
    cells = [(r, c) for r, row in enumerate(rows) for c, cell in enumerate(row) if cell == "L"]
    return data.draw(st.sampled_from(cells))


def draw_starts(data, rows, number):
    """Draw ``number`` distinct landing cells."""
    cells = [[r, c] for r, row in enumerate(rows) for c, cell in enumerate(row) if cell == "L"]
    return data.draw(st.permutations(cells))[:number]


def draw_targets(data, rows):
    """Draw a mask of at least one target outside buildings."""
    places = [(r, c) for r, row in enumerate(rows) for c, cell in enumerate(row) if cell not in "#b"]
    mask = np.zeros((len(rows), len(rows[0])), dtype=bool)
    for cell in data.draw(st.sets(st.sampled_from(places), min_size=1)):
        mask[cell] = True
    return mask


def draw_devices(data, rows, most=3):
    """Draw one to ``most`` devices, [row, column, data], outside buildings and landing zones."""
    places = [(r, c) for r, row in enumerate(rows) for c, cell in enumerate(row) if cell in ".N"]
    cells = data.draw(st.lists(st.sampled_from(places), min_size=1, max_size=most, unique=True))
    return [[r, c, data.draw(st.floats(1.0, 20.0))] for r, c in cells]
