"""The parameters that all generators of cities share.

This module does not import Numba: scenarios must be quick to read.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from uavbench.world.parameters import Record, ordered

_Covered = Annotated[float, Field(ge=0, le=0.8, strict=True)]
_Fraction = Annotated[float, Field(ge=0, le=1, strict=True)]
_Zones = Annotated[int, Field(ge=0, le=32, strict=True)]
_Landings = Annotated[int, Field(ge=1, le=32, strict=True)]
_Side = Annotated[int, Field(ge=1, le=32, strict=True)]


class CityParameters(Record):
    """What a drawn city looks like. Each range holds the smallest and the largest value; each city draws its own within it.

    The guarantees of `uavbench.world.generators.draw_cities` come first: where a city cannot have them and the drawn values,
    the values give way. On maps with sides of at least 16 cells this is rare.

    Attributes
    ----------
    building_share : (float, float)
        Fraction of all cells that buildings cover, high and low ones; at most 0.8.
    low_share : (float, float)
        Fraction of the cells of buildings that belong to low ones. Whole buildings are low or high.
    no_fly_zones : (int, int)
        Number of no-fly zones; at most 32. A zone that finds no room in a few trials is left out.
    no_fly_size : (int, int)
        Sides of a no-fly zone, in cells; at most 32. Buildings inside the rectangle stay buildings.
    landing_zones : (int, int)
        Number of landing zones; 1 to 32. There may be more, where cells would otherwise be too far away from them.
    landing_size : (int, int)
        Sides of a landing zone, in cells; at most 32. Zones are smaller where there is no room.
    """

    building_share: tuple[_Covered, _Covered] = (0.2, 0.45)
    low_share: tuple[_Fraction, _Fraction] = (0.0, 0.4)
    no_fly_zones: tuple[_Zones, _Zones] = (0, 3)
    no_fly_size: tuple[_Side, _Side] = (2, 6)
    landing_zones: tuple[_Landings, _Landings] = (1, 3)
    landing_size: tuple[_Side, _Side] = (2, 4)

    _ranges = field_validator("building_share", "low_share", "no_fly_zones", "no_fly_size", "landing_zones", "landing_size")(
        ordered
    )

    def encoded(self) -> NDArray[np.float64]:
        """Return the bounds in the order of the attributes, shape (12,), as kernels read them."""
        ranges = (
            self.building_share,
            self.low_share,
            self.no_fly_zones,
            self.no_fly_size,
            self.landing_zones,
            self.landing_size,
        )
        return np.array(ranges, dtype=np.float64).reshape(-1)
