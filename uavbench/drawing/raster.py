"""Pictures of a running episode: frames for ``rgb_array`` and text for ``ansi``; both work without a display."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from uavbench.drawing.scene import CRASH, PATH, Colour, Scene, scene_of
from uavbench.drawing.trail import Cell, Trail
from uavbench.simulation.simulator import Simulator
from uavbench.world.cells import CHARACTERS

_FRAME = 512  # pixels of the longer side, about
_LINE = 20  # pixels of a line of text
_WHITE: Colour = (255, 255, 255)


def frame(simulator: Simulator, i: int, trail: Trail) -> NDArray[np.uint8]:
    """Draw the episode in slot ``i`` as `raster` does."""
    return raster(scene_of(simulator, i, trail))


def raster(scene: Scene) -> NDArray[np.uint8]:
    """Draw a scene.

    Returns
    -------
    ndarray of uint8, shape (M · s, N · s, 3)
        s × s pixels for each cell: s is at least 3, or such that the longer side has about 512 pixels.
    """
    size = max(3, _FRAME // max(scene.cells.shape))
    large = scene.cells.repeat(size, axis=0).repeat(size, axis=1)
    if size >= 6:
        large[::size] = large[::size] * 0.93
        large[:, ::size] = large[:, ::size] * 0.93
    half, thick = size // 2, max(1, size // 10)
    for (r0, c0), (r1, c1), colour in scene.moves:
        (top, bottom), (left, right) = sorted((r0, r1)), sorted((c0, c1))
        large[
            top * size + half - thick : bottom * size + half + thick,
            left * size + half - thick : right * size + half + thick,
        ] = colour
        _stamp(large, _arrow(size, r1 - r0, c1 - c0), ((r0 + r1) / 2, (c0 + c1) / 2), colour)
    for device in scene.devices:
        _stamp(large, _disc(size, 0.62), device.cell, device.colour)
        _stamp(large, _disc(size, 0.48) & ~_pie(size, round(12 * device.left)), device.cell, _WHITE)
    for cell, colour in scene.hovers:  # drawn over devices, which may have the same colour
        _stamp(large, _cross(size, 0.38, 0.2), cell, _WHITE)
        _stamp(large, _cross(size, 0.32, 0.1), cell, colour)
    for cell, colour in scene.starts:  # drawn below ends; a start that is also an end leaves a rim
        _stamp(large, _diamond(size, 0.62), cell, colour)
        _stamp(large, _diamond(size, 0.38), cell, _WHITE)
    for cell, colour in scene.ends:
        _stamp(large, _diamond(size, 0.54), cell, _WHITE)
        _stamp(large, _diamond(size, 0.46), cell, colour)
    for cell in scene.crashes:
        _stamp(large, _diamond(size, 0.65), cell, CRASH)
        _stamp(large, _cross(size, 0.28, 0.1), cell, _WHITE)
    for cell, colour in scene.uavs:
        for radius, ring in ((0.6, _WHITE), (0.5, PATH), (0.36, _WHITE), (0.26, colour)):
            _stamp(large, _disc(size, radius), cell, ring)
    return large


def captioned(picture: NDArray[np.uint8], *lines: str) -> NDArray[np.uint8]:
    """Return a picture with lines of text below it."""
    width = picture.shape[1]
    strip = Image.new("RGB", (width, _LINE * len(lines) + _LINE // 2), _WHITE)
    pen = ImageDraw.Draw(strip)
    pen.fontmode = "1"  # no smoothed edges, since their greys would fill a film's palette
    for k, line in enumerate(lines):
        pen.text((_LINE // 3, _LINE // 4 + k * _LINE), line, PATH, ImageFont.load_default(_LINE * 0.72))
    return np.concatenate([picture, np.asarray(strip)])


def text(simulator: Simulator, i: int, trail: Trail) -> str:
    """Write the episode in slot ``i``: ``+`` for remaining target cells, ``·`` for flown paths, ``@`` for the UAV.

    The UAVs of a team are written as their numbers, in hexadecimal digits.
    """
    state = simulator.state
    cells = np.array(list(CHARACTERS))[simulator.city_at(i).cells]
    for way in trail.cells:
        for r, c in way:
            cells[r, c] = "·"
    cells[state.target[i] > 0] = "+"
    for u, way in enumerate(trail.cells):
        cells[way[-1]] = f"{u:X}" if simulator.scenario.team else "@"
    cr = float(simulator.outcomes([i])["cr"][0])
    budgets = ", ".join(f"{state.budget[i, u]}/{state.initial_budget[i, u]}" for u in range(state.uavs[i]))
    head = f"{simulator.scenario.id}  budget {budgets}  CR {cr:.3f}"
    return "\n".join([head, *("".join(row) for row in cells.tolist())]) + "\n"


def _stamp(picture: NDArray[np.uint8], shape: NDArray[np.bool_], cell: Cell | tuple[float, float], colour: Colour) -> None:
    """Paint a shape, which is two cells wide, centred on a cell; parts outside the picture are cut off."""
    side = len(shape)
    top, left = round((cell[0] + 0.5) * side / 2 - side / 2), round((cell[1] + 0.5) * side / 2 - side / 2)
    rows, cols = slice(max(0, top), top + side), slice(max(0, left), left + side)
    part = picture[rows, cols]
    part[shape[rows.start - top :, cols.start - left :][: part.shape[0], : part.shape[1]]] = colour


def _offsets(size: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far each pixel of a stamp is below and right of its centre, in cells."""
    at = (np.arange(2 * size) - size + 0.5) / size
    return at[:, None], at[None, :]


@lru_cache(maxsize=64)
def _disc(size: int, radius: float) -> NDArray[np.bool_]:
    down, right = _offsets(size)
    return down**2 + right**2 < radius**2


@lru_cache(maxsize=64)
def _pie(size: int, twelfths: int) -> NDArray[np.bool_]:
    """Return a sector around the centre of so many twelfths of a circle, clockwise from the top."""
    down, right = _offsets(size)
    return np.arctan2(-right, down) + np.pi < twelfths * np.pi / 6


@lru_cache(maxsize=64)
def _diamond(size: int, radius: float) -> NDArray[np.bool_]:
    down, right = _offsets(size)
    return np.abs(down) + np.abs(right) < radius


@lru_cache(maxsize=64)
def _cross(size: int, radius: float, thick: float) -> NDArray[np.bool_]:
    down, right = _offsets(size)
    near = np.minimum(np.abs(down - right), np.abs(down + right)) < thick
    return near & (np.maximum(np.abs(down), np.abs(right)) < radius)


@lru_cache(maxsize=64)
def _arrow(size: int, down: int, right: int) -> NDArray[np.bool_]:
    """Return the head of an arrow that points along a move."""
    y, x = _offsets(size)
    along, across = y * down + x * right, np.abs(y * right) + np.abs(x * down)
    return (along > -0.2) & (across < 0.55 * (0.2 - along))
