"""Flights, the results of a search, for one UAV or for a team."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavbench.planning.paths import follow
from uavbench.world.city import City

Cell = tuple[int, int]


@dataclass(frozen=True)
class Plan:
    """The flights of a team, each of which lands.

    Attributes
    ----------
    flights : list of list of (int, int)
        For each UAV the cells from its current cell to a landing cell; where it hovers, its cell is repeated. A flight has at
        most budget − 1 actions, because landing takes one more.
    value : float
        What the flights cover or collect together: target cells or data units.
    """

    flights: list[list[Cell]]
    value: float


def pack(
    city: City,
    starts: Sequence[Cell],
    budgets: Sequence[int],
    flights: Sequence[Sequence[Cell]] | None,
    cursor: NDArray[np.uint64],
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return flights as rows of cells (row-major numbers), and their lengths in actions.

    If ``flights`` is None, they are shortest paths to the nearest landing cell.
    """
    cols = city.shape[1]
    paths = np.zeros((len(starts), max(budgets) + 2), dtype=np.int32)
    lengths = np.zeros(len(starts), dtype=np.int64)
    for u, (r, c) in enumerate(starts):
        if flights is None:
            here = r * cols + c
            paths[u, 0] = here
            away = city.distances((r, c))[city.landing_cells[:, 0], city.landing_cells[:, 1]]
            nearest = city.landing_cells[np.argmin(np.where(away >= 0, away, np.iinfo(away.dtype).max))]
            onward = city.distances(nearest).reshape(-1)
            lengths[u] = follow(onward, cols, here, cols, here, True, cursor, paths[u], 1) - 1
        else:
            cells = np.array(flights[u], dtype=np.int32).reshape(-1, 2)
            lengths[u] = len(cells) - 1
            paths[u, : len(cells)] = cells[:, 0] * cols + cells[:, 1]
    return paths, lengths


def unpack(city: City, paths: NDArray[np.int32], lengths: NDArray[np.int64]) -> list[list[Cell]]:
    """Return rows of cells as flights."""
    cols = city.shape[1]
    return [[divmod(cell, cols) for cell in path[: length + 1].tolist()] for path, length in zip(paths, lengths, strict=True)]


def landing_numbers(city: City) -> NDArray[np.int32]:
    """Return the landing cells' row-major numbers."""
    return (city.landing_cells[:, 0] * city.shape[1] + city.landing_cells[:, 1]).astype(np.int32)
