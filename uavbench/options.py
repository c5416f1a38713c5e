"""Reading the options of ``reset`` that set an episode by hand: what does not fit the scenario is a ValueError."""

from collections.abc import Mapping
from typing import Any, SupportsIndex, cast

import numpy as np
from numpy.typing import NDArray

from uavbench.city import City
from uavbench.scenario import Scenario


def read_uavs(options: Mapping[str, Any], scenario: Scenario, drawn: int) -> int:
    """Return how many UAVs fly: ``num_uavs``, or as many as were drawn."""
    if "num_uavs" not in options:
        return drawn
    number = options["num_uavs"]
    fewest, most = scenario.uavs or (1, 1)
    if not _integer(number) or not fewest <= number <= most:
        wanted = f"an integer from {fewest} to {most}, the UAVs of {scenario.id}" if fewest < most else f"{most}"
        raise ValueError(f"num_uavs: {number!r} is not {wanted}")
    return int(number)


def read_start(value: Any, scenario: Scenario, city: City, uavs: int) -> NDArray[np.int32]:
    """Return start cells, shape (uavs, 2), from [row, column], or in a team a list of one for each UAV."""
    expected = "a cell [row, column] of two integers"
    if scenario.team:
        expected = f"a list of {uavs} cells [row, column] of two integers, one for each UAV"
    try:
        cells = np.asarray(value)
    except ValueError:
        raise ValueError(f"start: {value!r} is not {expected}") from None
    if cells.shape != ((uavs, 2) if scenario.team else (2,)) or cells.dtype.kind not in "iu":
        raise ValueError(f"start: {value!r} is not {expected}")
    rows, cols = city.shape
    cells = cells.reshape(uavs, 2)
    for r, c in cells.tolist():
        if not (0 <= r < rows and 0 <= c < cols):
            raise ValueError(f"start: ({r}, {c}) is off the {rows}×{cols} map")
        if not city.landing[r, c]:
            raise ValueError(f"start: ({r}, {c}) is outside the landing zones; episodes start in one")
    if len(np.unique(cells, axis=0)) < uavs:
        raise ValueError("start: two UAVs are on one cell")
    return cells.astype(np.int32)


def read_budget(value: Any, scenario: Scenario, uavs: int) -> NDArray[np.int32]:
    """Return budgets, shape (uavs,), from an integer, or in a team also a list of one for each UAV."""
    most = scenario.budget[1]
    each: list[Any] = list(value) if scenario.team and _listed(value) else [value] * uavs
    if len(each) != uavs:
        raise ValueError(f"budget: {len(each)} of them for {uavs} UAVs; give one for all, or one for each")
    for budget in each:
        if not _integer(budget) or not 1 <= budget <= most:
            raise ValueError(f"budget: {budget!r} is not an integer from 1 to {most}, the scenario's largest")
    return np.array(each, dtype=np.int32)


def read_noise(options: Mapping[str, Any]) -> bool:
    """Return whether shadow fading is on: ``noise``, or True."""
    noise: Any = options.get("noise", True)
    if not isinstance(noise, bool | np.bool_):
        raise ValueError(f"noise: {noise!r} is not True or False")
    return bool(cast("Any", noise))


def _listed(value: object) -> bool:
    """Say whether ``value`` is a list of some kind."""
    return isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim == 1)


def _integer(value: object) -> bool:
    """Say whether ``value`` is an integer, of Python or NumPy."""
    return isinstance(value, SupportsIndex) and not isinstance(value, bool | np.ndarray)
