"""Pictures of a running episode: frames for ``rgb_array`` and text for ``ansi``; both work headless."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from uavbench.scenario import BUILDING, FREE, LANDING, NO_FLY
from uavbench.simulator import Simulator

_COLOURS = {
    FREE: (255, 255, 255),
    LANDING: (150, 178, 228),
    NO_FLY: (244, 176, 168),
    BUILDING: (96, 96, 104),
}
_TARGET = np.array((66, 168, 84))
_PATH = (40, 40, 40)
_UAVS = ((214, 96, 16), (36, 104, 190), (150, 60, 160), (20, 140, 140))  # in turn
_FRAME = 512  # pixels of the longer side, about

Cells = Sequence[tuple[int, int]]


def _characters(simulator: Simulator) -> NDArray[np.str_]:
    """Return the map, one character a cell; shape (M, N)."""
    return np.array([list(row) for row in simulator.scenario.rows])


def _positions(simulator: Simulator, i: int) -> list[tuple[int, int]]:
    """Return where the UAVs of slot ``i`` are."""
    state = simulator.state
    return [(r, c) for r, c in state.position[i, : state.uavs[i]].tolist()]


def frame(simulator: Simulator, i: int, paths: Sequence[Cells]) -> NDArray[np.uint8]:
    """Draw the episode in slot ``i``: the map, what is left of the targets in green, and each UAV with its path.

    Returns
    -------
    ndarray of uint8, shape (M · s, N · s, 3)
        s pixels a cell, so that the longer side has about 512.
    """
    city, target = simulator.city, simulator.state.target[i]
    size = max(3, _FRAME // max(city.shape))
    cells = _characters(simulator)
    picture = np.empty((*city.shape, 3))
    for kind, colour in _COLOURS.items():
        picture[cells == kind] = colour
    strength = 0.75 * np.sqrt(target / max(float(target.max()), 1.0))[:, :, None]
    picture = (picture * (1 - strength) + _TARGET * strength).astype(np.uint8)
    large = picture.repeat(size, axis=0).repeat(size, axis=1)
    if size >= 6:
        large[::size] = large[::size] * 0.93
        large[:, ::size] = large[:, ::size] * 0.93
    half, thick = size // 2, max(1, size // 8)
    for u, path in enumerate(paths):
        colour = np.multiply(_UAVS[u % len(_UAVS)], 0.8) if simulator.scenario.team else _PATH
        for (r0, c0), (r1, c1) in pairwise(path):
            (top, bottom), (left, right) = sorted((r0, r1)), sorted((c0, c1))
            large[
                top * size + half - thick : bottom * size + half + thick,
                left * size + half - thick : right * size + half + thick,
            ] = colour
    y, x = np.ogrid[:size, :size]
    disc = (y - (size - 1) / 2) ** 2 + (x - (size - 1) / 2) ** 2 < (0.46 * size) ** 2
    for u, (r, c) in enumerate(_positions(simulator, i)):
        large[r * size : (r + 1) * size, c * size : (c + 1) * size][disc] = _UAVS[u % len(_UAVS)]
    return large


def text(simulator: Simulator, i: int, paths: Sequence[Cells]) -> str:
    """Write the episode in slot ``i``: ``+`` what is left of the targets, ``·`` the flown paths, ``@`` the UAV.

    The UAVs of a team are written as the digits of their numbers.
    """
    state = simulator.state
    cells = _characters(simulator)
    for path in paths:
        for r, c in path:
            cells[r, c] = "·"
    cells[state.target[i] > 0] = "+"
    for u, cell in enumerate(_positions(simulator, i)):
        cells[cell] = f"{u:X}" if simulator.scenario.team else "@"
    cr = float(simulator.outcomes([i])["cr"][0])
    budgets = ", ".join(f"{state.budget[i, u]}/{state.initial_budget[i, u]}" for u in range(state.uavs[i]))
    head = f"{simulator.scenario.id}  budget {budgets}  CR {cr:.3f}"
    return "\n".join([head, *("".join(row) for row in cells.tolist())]) + "\n"
