"""From buildings to a city that can be flown: low buildings, zones, and the repair after which all guarantees hold."""

import numpy as np
from numpy.typing import NDArray

from uavbench.world.cells import FREE, LANDING, LOW_BUILDING, NO_FLY
from uavbench.world.generators.canvas import Canvas, Window, between, fill
from uavbench.world.generators.heights import lower_buildings
from uavbench.world.generators.search import join_pockets, open_buildings, prepare, search_all, spread, within_reach
from uavbench.world.generators.zones import draw_no_fly, find_landing, landing_around, mark_landing
from uavbench.world.kernel import kernel
from uavbench.world.keyed import next_uniform

_LARGEST = 4  # a side of a landing zone is at most a quarter of the shorter side of the map
_MOST_LANDING = 8  # drawn landing zones cover at most an eighth of the map, besides the first one


@kernel
def finish(
    cursor: NDArray[np.uint64], canvas: Canvas, parameters: NDArray[np.float64], reach: int, min_landing: int, min_places: int
) -> None:
    """Make a city of a canvas with buildings; the guarantees are those of `uavbench.world.generators.draw_cities`.

    Parameters
    ----------
    cursor : ndarray of uint64, shape (1,)
        The stream of random numbers.
    canvas : Canvas
        Free cells and buildings.
    parameters : ndarray of float64, shape (12,)
        See `uavbench.world.generators.parameters.CityParameters.encoded`.
    reach, min_landing, min_places : int
        See `uavbench.world.generators.draw_cities`.
    """
    city = canvas.city
    lower_buildings(cursor, canvas, next_uniform(cursor, parameters[2], parameters[3]))
    no_fly_zones = between(cursor, int(parameters[4]), int(parameters[5]))
    draw_no_fly(cursor, city, no_fly_zones, int(parameters[6]), int(parameters[7]))
    zones = between(cursor, int(parameters[8]), int(parameters[9]))
    first = _first_landing(cursor, canvas, parameters)
    flyable, within = _measure(canvas, first, reach)
    missing = _missing(city, min_landing - first, min_places)
    if missing > 0:
        open_buildings(canvas, missing, reach)
        flyable, within = _measure(canvas, first, reach)
    gained, landing = _draw_zones(cursor, canvas, parameters, zones - 1, reach if _too_far(within, flyable) else 0)
    landing += first + _come_nearer(cursor, canvas, parameters, reach, flyable, within + gained)
    lacking = _widen(canvas, flyable, min_landing - landing)
    missing = _missing(city, 0, min_places)
    if lacking > 0 or (missing > 0 and open_buildings(canvas, missing, reach) > 0):
        _open_field(city, reach, min_landing)


@kernel
def _sides(cursor: NDArray[np.uint64], city: NDArray[np.uint8], parameters: NDArray[np.float64]) -> tuple[int, int]:
    """Draw the sides of a landing zone."""
    largest = max(1, (min(city.shape) - 2) // _LARGEST)
    down = min(largest, between(cursor, int(parameters[10]), int(parameters[11])))
    return down, min(largest, between(cursor, int(parameters[10]), int(parameters[11])))


@kernel
def _first_landing(cursor: NDArray[np.uint64], canvas: Canvas, parameters: NDArray[np.float64]) -> int:
    """Draw the first landing zone, and list its cells in the queue; return how many they are.

    Where no cell is free, it is the cell in the middle.
    """
    down, across = _sides(cursor, canvas.city, parameters)
    zone = find_landing(cursor, canvas.city, down, across)
    if zone[2] == zone[0]:
        r, c = canvas.city.shape[0] // 2, canvas.city.shape[1] // 2
        zone = (r, c, r + 1, c + 1)
    return mark_landing(canvas, zone, canvas.queue)


@kernel
def _measure(canvas: Canvas, first: int, reach: int) -> tuple[int, int]:
    """Measure the distances to the first landing zone, and join all that can be flown over to one region.

    Parameters
    ----------
    canvas : Canvas
        The city; the queue begins with the cells of the landing zone.
    first : int
        How many they are.
    reach : int
        See `uavbench.world.generators.draw_cities`.

    Returns
    -------
    flyable : int
        Cells that can be flown over: the first cells of the queue, nearest first.
    within : int
        How many of them are at most ``reach`` moves away.
    """
    distance, wide = canvas.distance.reshape(-1), canvas.city.shape[1]
    flyable = prepare(canvas)
    visited = search_all(distance, canvas.queue, first, wide)
    if visited < flyable and join_pockets(canvas, visited):
        prepare(canvas)
        visited = search_all(distance, canvas.queue, first, wide)
    return visited, within_reach(distance, canvas.queue, visited, reach)


@kernel
def _too_far(within: int, flyable: int) -> bool:
    """Return whether less than 95 % of the cells that can be flown over are within reach of a landing cell."""
    return 20 * within < 19 * flyable


@kernel
def _missing(city: NDArray[np.uint8], landing: int, min_places: int) -> int:
    """Return how many cells must become free: for more landing cells, ``min_places`` places, and one other cell to fly to."""
    landing = max(0, landing)
    free = low = no_fly = 0
    cells = city.reshape(-1)
    for k in range(len(cells)):
        free += cells[k] == FREE
        low += cells[k] == LOW_BUILDING
        no_fly += cells[k] == NO_FLY
    return landing + max(min_places - free - no_fly, 1 - free - low, -free)


@kernel
def _land(canvas: Canvas, zone: Window, reach: int) -> tuple[int, int]:
    """Make a landing zone, and lower the distances around it; return how many cells came within reach, and its area."""
    count = mark_landing(canvas, zone, canvas.spare)
    if reach == 0:
        return 0, count
    _, gained = spread(canvas.distance.reshape(-1), canvas.spare, count, canvas.city.shape[1], reach)
    return gained, count


@kernel
def _draw_zones(
    cursor: NDArray[np.uint64], canvas: Canvas, parameters: NDArray[np.float64], zones: int, reach: int
) -> tuple[int, int]:
    """Draw the other landing zones; return how many cells came within reach, and how many are landing cells.

    Distances are lowered up to ``reach`` moves around them. If that is 0, no distance matters any more.
    """
    within = landing = 0
    most = (canvas.city.shape[0] - 2) * (canvas.city.shape[1] - 2) // _MOST_LANDING
    for _ in range(zones):
        down, across = _sides(cursor, canvas.city, parameters)
        zone = find_landing(cursor, canvas.city, down, across)
        if landing + (zone[2] - zone[0]) * (zone[3] - zone[1]) <= most:
            gained, count = _land(canvas, zone, reach)
            within += gained
            landing += count
    return within, landing


@kernel
def _come_nearer(
    cursor: NDArray[np.uint64],
    canvas: Canvas,
    parameters: NDArray[np.float64],
    reach: int,
    flyable: int,
    within: int,
) -> int:
    """Add landing zones until 95 % of all cells that can be flown over are within reach of one; return their cells.

    The cells are visited once, the farthest one first. For one that is out of reach, a landing zone is made on its way to the
    other zones. A search goes no farther than the reach, so that the work is about proportional to the number of cells.
    """
    landing = 0
    for k in range(flyable - 1, -1, -1):
        if not _too_far(within, flyable):
            break
        cell = canvas.queue[k]
        if canvas.distance.reshape(-1)[cell] > reach:
            down, across = _sides(cursor, canvas.city, parameters)
            zone = landing_around(cursor, canvas.city, _on_the_way(canvas, cell, reach), down, across)
            gained, count = _land(canvas, zone, reach)
            within += gained
            landing += count
    return landing


@kernel
def _on_the_way(canvas: Canvas, cell: int, reach: int) -> int:
    """Return a free cell at most ``reach`` moves from ``cell``, about two thirds of that; if none is free, the cell itself."""
    city, distance, wide = canvas.city.reshape(-1), canvas.distance.reshape(-1), canvas.city.shape[1]
    chosen = here = cell
    for moves in range(reach + 1):
        if city[here] == FREE:
            chosen = here
            if 3 * moves >= 2 * reach:
                break
        nearer = here
        for step in (-wide, 1, wide, -1):
            if 0 <= distance[here + step] < distance[nearer]:
                nearer = here + step
        here = nearer
    return chosen


@kernel
def _widen(canvas: Canvas, flyable: int, missing: int) -> int:
    """Make landing cells of the free cells that are nearest to the first landing zone; return how many are still missing."""
    city, queue = canvas.city.reshape(-1), canvas.queue
    for k in range(flyable):
        if missing <= 0:
            break
        if city[queue[k]] == FREE:
            city[queue[k]] = LANDING
            missing -= 1
    return missing


@kernel
def _open_field(city: NDArray[np.uint8], reach: int, min_landing: int) -> None:
    """Make an open field with landing cells at equal distances, where a city cannot have all guarantees.

    From the middle of a square of ``reach`` × ``reach`` cells, no cell of it is more than ``reach`` moves away.
    """
    rows, cols = city.shape[0] - 2, city.shape[1] - 2
    fill(city, (1, 1, rows + 1, cols + 1), FREE)
    for r in range(reach // 2, rows + reach // 2, reach):
        for c in range(reach // 2, cols + reach // 2, reach):
            city[1 + min(r, rows - 1), 1 + min(c, cols - 1)] = LANDING
            min_landing -= 1
    for r in range(1, rows + 1):
        for c in range(1, cols + 1):
            if min_landing > 0 and city[r, c] == FREE:
                city[r, c] = LANDING
                min_landing -= 1
