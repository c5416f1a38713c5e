"""Reading the options of ``reset`` that set an episode by hand. A value that does not fit the scenario raises a ValueError."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.world.city import City
from uavbench.world.scenario import Scenario
from uavbench.world.values import as_array, as_integer, as_list, shown


def read_uavs(options: Mapping[str, Any], scenario: Scenario, drawn: int) -> int:
    """Return the number of UAVs: the option ``num_uavs``, by default the number that was ``drawn``."""
    if "num_uavs" not in options:
        return drawn
    number = as_integer(options["num_uavs"])
    min_uavs, max_uavs = scenario.uavs or (1, 1)
    if number is None or not min_uavs <= number <= max_uavs:
        wanted = (
            f"an integer from {min_uavs} to {max_uavs}, the UAVs of {scenario.id}" if min_uavs < max_uavs else f"{max_uavs}"
        )
        raise ValueError(f"num_uavs: {shown(options['num_uavs'])} is not {wanted}")
    return number


#: What ``start`` may be besides a cell: a landing cell, as drawn, or any cell.
STARTS = ("landing", "anywhere")


def check_start(value: object) -> str:
    """Return ``value`` when it is one of `STARTS`, else raise a ValueError that says so."""
    if isinstance(value, str) and value in STARTS:
        return value
    raise ValueError(f"start: {shown(value)} is not one of {', '.join(STARTS)}")


def is_anywhere(options: Mapping[str, Any]) -> bool:
    """Return whether an episode starts anywhere: ``start`` is ``"anywhere"``."""
    return isinstance(options.get("start"), str) and check_start(options["start"]) == "anywhere"


def read_start(value: Any, scenario: Scenario, city: City, uavs: int) -> NDArray[np.int32]:
    """Return start cells, shape (uavs, 2), from one cell [row, column], in teams from a list with one cell for each UAV."""
    expected = "a cell [row, column] of two integers"
    if scenario.team:
        expected = f"a list of {uavs} cells [row, column] of two integers, one for each UAV"
    listed = as_list(value) if scenario.team else [value]
    cells = [[as_integer(number) for number in as_list(cell) or ()] for cell in listed or ()]
    if len(cells) != uavs or any(len(cell) != 2 or None in cell for cell in cells):
        raise ValueError(f"start: {shown(value)} is not {expected}")
    rows, cols = city.shape
    starts = [(r, c) for r, c in cells if r is not None and c is not None]
    for r, c in starts:
        if not (0 <= r < rows and 0 <= c < cols):
            raise ValueError(f"start: ({shown(r)}, {shown(c)}) is off the {rows}×{cols} map")
        if not city.landing[r, c]:
            raise ValueError(f"start: ({r}, {c}) is outside the landing zones; episodes start in one")
    if len(set(starts)) < uavs:
        raise ValueError("start: two UAVs are on one cell")
    return np.array(starts, dtype=np.int32)


def read_budget(value: Any, scenario: Scenario, uavs: int) -> NDArray[np.int32]:
    """Return budgets, shape (uavs,), from one integer for all UAVs, in teams also from a list with one for each UAV."""
    largest = scenario.budget[1]
    listed = as_list(value) if scenario.team else None
    each: list[Any] = [value] * uavs if listed is None else listed
    if len(each) != uavs:
        raise ValueError(f"budget: {len(each)} given for {uavs} UAVs; give one for all, or one for each")
    budgets: list[int] = []
    for given in each:
        budget = as_integer(given)
        if budget is None or not 1 <= budget <= largest:
            raise ValueError(f"budget: {shown(given)} is not an integer from 1 to {largest}, the scenario's largest")
        budgets.append(budget)
    return np.array(budgets, dtype=np.int32)


def read_noise(options: Mapping[str, Any]) -> bool:
    """Return whether shadow fading is on: the option ``noise``, True by default."""
    noise = as_array(options.get("noise", True))
    if noise is None or noise.shape or noise.dtype != np.bool_:
        raise ValueError(f"noise: {shown(options['noise'])} is not True or False")
    return bool(noise)
