"""Where the map lies if nobody says where: the window with the most buildings."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.geodata.footprints import Footprint
from uavbench.geodata.projection import DEGREE

_BINS = 4  # of a window, along each side
_DIGITS = 5  # of the centre, in degrees: about a metre


def densest(buildings: Sequence[Footprint], height: float, width: float) -> tuple[float, float]:
    """Return latitude and longitude of the centre of the window in which buildings cover the most ground.

    The windows that are compared begin at every quarter of a window; of equal ones, the southernmost counts.

    Parameters
    ----------
    buildings : sequence of Footprint
    height, width : float
        Of the window, in metres.
    """
    boxes = np.array([each.shape.bounds for each in buildings])
    lon, lat = boxes[:, [0, 2]].mean(axis=1), boxes[:, [1, 3]].mean(axis=1)
    shrink = np.cos(np.radians(lat))
    area = np.array([each.shape.area for each in buildings]) * shrink  # in degrees of latitude, squared
    step = height / DEGREE / _BINS, width / (DEGREE * math.cos(math.radians(float(np.median(lat))))) / _BINS
    bins = np.column_stack([np.floor((lat - lat.min()) / step[0]), np.floor((lon - lon.min()) / step[1])]).astype(np.int64)
    offsets = np.indices((_BINS, _BINS)).reshape(2, -1).T
    windows = (bins[:, None] - offsets).reshape(-1, 2)  # each bin is in the windows that begin up to three bins before it
    first, which = np.unique(windows, axis=0, return_inverse=True)
    total: NDArray[Any] = np.bincount(which.ravel(), weights=np.repeat(area, len(offsets)))
    row, col = first[int((total / total.max()).round(9).argmax())].tolist()
    centre = float(lat.min()) + (row + _BINS / 2) * step[0], float(lon.min()) + (col + _BINS / 2) * step[1]
    return round(centre[0], _DIGITS), round(centre[1], _DIGITS)
