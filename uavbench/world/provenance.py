"""Where the map of a real city comes from: the table ``[provenance]`` of a scenario."""

from typing import Annotated

from pydantic import Field

from uavbench.world.parameters import Record

_Degrees = Annotated[float, Field(ge=-180, le=180, allow_inf_nan=False)]
_Metres = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Provenance(Record):
    """The origin of a map that was made from data about a real place. It is not part of the scenario's digest.

    Attributes
    ----------
    source : str
        The file that the map was made from, without its folders.
    sha256 : str
        SHA-256 of that file.
    licence : str
        The licence of the data, with the notice that it asks for.
    centre : (float, float)
        Latitude and longitude of the map's centre, in degrees (WGS 84).
    bounds : (float, float, float, float)
        South, west, north and east of the map, in degrees (WGS 84).
    projection : str
        The projection to metres, as a PROJ string: the map's centre is at (0, 0), rows go south and columns go east.
    cell_size : float
        Side of a cell in metres.
    altitude : float
        Flying altitude in metres; buildings that are not higher are low buildings.
    default_height : float
        The height in metres of buildings of which the data gives none.
    """

    source: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    licence: str
    centre: tuple[_Degrees, _Degrees]
    bounds: tuple[_Degrees, _Degrees, _Degrees, _Degrees]
    projection: str
    cell_size: _Metres
    altitude: _Metres
    default_height: _Metres
