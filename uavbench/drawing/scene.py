"""What every picture of an episode shows: coloured cells, and marks on them, in the style of the paper's Table II."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavbench.drawing.trail import Cell, Trail
from uavbench.simulation.simulator import Simulator
from uavbench.world.cells import COLOURS, LOW_BUILDING, Colour
from uavbench.world.scenario import Scenario

REMAINING: Colour = (66, 168, 84)
COVERED: Colour = (205, 232, 208)
PATH: Colour = (40, 40, 40)
SHADOW = 0.75  # brightness of a cell without line of sight to any device
CRASH: Colour = (200, 16, 16)
#: The colours of UAVs, used in turn; darker than those of devices.
UAVS: tuple[Colour, ...] = ((16, 40, 128), (136, 16, 56), (8, 92, 48), (92, 72, 8))
#: The colours of devices, used in turn.
DEVICES: tuple[Colour, ...] = (
    *((217, 119, 6), (37, 99, 235), (147, 51, 234), (13, 148, 136), (220, 38, 38)),
    *((101, 163, 13), (219, 39, 119), (8, 145, 178), (161, 98, 7), (79, 70, 229)),
)


@dataclass(frozen=True)
class Device:
    """A device: its cell, its colour, and the share of its data that is left."""

    cell: Cell
    colour: Colour
    left: float


@dataclass(frozen=True)
class Scene:
    """The content of a picture, before it is drawn.

    Attributes
    ----------
    cells : ndarray of uint8, shape (M, N, 3)
        The colour of each cell.
    moves : list of (cell, cell, colour)
        The moves that were flown, each drawn as an arrow.
    hovers : list of (cell, colour)
        Where a UAV stayed in its cell for a step, each drawn as a cross.
    starts, ends : list of (cell, colour)
        Where UAVs started, drawn as hollow diamonds, and where they landed, drawn as filled diamonds.
    crashes : list of cell
        Where UAVs crashed, drawn as red marks.
    uavs : list of (cell, colour)
        Where UAVs are that still fly.
    devices : list of Device
    title : str
        The used movement budget, CR, and whether a UAV crashed.
    scenario : Scenario
        The scenario of the episode.
    low_buildings : bool
        Whether the map has low buildings: the legend then names them.
    """

    cells: NDArray[np.uint8]
    moves: list[tuple[Cell, Cell, Colour]]
    hovers: list[tuple[Cell, Colour]]
    starts: list[tuple[Cell, Colour]]
    ends: list[tuple[Cell, Colour]]
    crashes: list[Cell]
    uavs: list[tuple[Cell, Colour]]
    devices: list[Device]
    title: str
    scenario: Scenario
    low_buildings: bool


def city_colours(cells: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the colours of a map that is given as codes of cells, shape (M, N, 3)."""
    return np.array(COLOURS, dtype=np.uint8)[cells]


def scene_of(simulator: Simulator, i: int, trail: Trail) -> Scene:
    """Return the scene of the episode in slot ``i`` after a flight along ``trail``."""
    state, devices = simulator.state, _devices(simulator, i, trail)
    moves: list[tuple[Cell, Cell, Colour]] = []
    hovers: list[tuple[Cell, Colour]] = []
    starts: list[tuple[Cell, Colour]] = []
    ends: list[tuple[Cell, Colour]] = []
    crashes: list[Cell] = []
    uavs: list[tuple[Cell, Colour]] = []
    for u, cells in enumerate(trail.cells):
        own = UAVS[u % len(UAVS)]
        plain = own if simulator.scenario.team else PATH
        served = trail.served if devices and not simulator.scenario.team else ()
        starts.append((cells[0], plain))
        for t, (here, there) in enumerate(pairwise(cells)):
            colour = DEVICES[served[t] % len(DEVICES)] if served and served[t] >= 0 else plain
            if here != there:
                moves.append((here, there, colour))
            elif t < len(cells) - 2 or not state.done[i, u]:  # the last action has landed, or has used up the budget
                hovers.append((here, colour))
        if not state.done[i, u]:
            uavs.append((cells[-1], own))
        elif state.landed[i, u]:
            ends.append((cells[-1], plain))
        else:
            crashes.append(cells[-1])
    used = int((state.initial_budget[i] - state.budget[i])[: len(trail.cells)].sum())
    cr = float(simulator.outcomes([i])["cr"][0])
    title = (
        f"Movement {used}/{int(state.initial_budget[i, : len(trail.cells)].sum())}, CR = {cr if cr == 1 else min(cr, 0.99):.2f}"
    )
    return Scene(
        cells=_cells(simulator, i, trail, targets=not devices),
        moves=moves,
        hovers=hovers,
        starts=starts,
        ends=ends,
        crashes=crashes,
        uavs=uavs,
        devices=devices,
        title=f"{title}, crashed" if crashes else title,
        scenario=simulator.scenario,
        low_buildings=bool((simulator.city_at(i).cells == LOW_BUILDING).any()),
    )


def _cells(simulator: Simulator, i: int, trail: Trail, targets: bool) -> NDArray[np.uint8]:
    """Return the map with its shade; with ``targets`` also remaining and covered target cells, through which the map shows."""
    colours = city_colours(simulator.city_at(i).cells).astype(np.float32)
    if trail.shade is not None:
        colours *= (1 - (1 - SHADOW) * trail.shade)[:, :, None]
    if targets:
        remaining = simulator.state.target[i] > 0
        for cells, colour in ((remaining, REMAINING), ((trail.target > 0) & ~remaining, COVERED)):
            colours[cells] = blend(colours[cells], colour)
    return colours.astype(np.uint8)


def blend(under: ArrayLike, colour: Colour) -> NDArray[np.float32]:
    """Return colours blended with 70 % of ``colour``."""
    return (0.3 * np.asarray(under, dtype=np.float32) + 0.7 * np.array(colour, dtype=np.float32)).astype(np.float32)


def _devices(simulator: Simulator, i: int, trail: Trail) -> list[Device]:
    """Return the mission's marks, each with the share of its amount that is left."""
    where, amounts = simulator.mission.marks(i)
    cells: Sequence[list[int]] = where.tolist()
    left: Sequence[float] = amounts.tolist()
    return [
        Device((r, c), DEVICES[d % len(DEVICES)], min(1.0, data / float(trail.target[r, c])))  # the map is rounded to float32
        for d, ((r, c), data) in enumerate(zip(cells, left, strict=True))
    ]
