"""The files of an imported city: a scenario's TOML file, and the map as text beside it."""

import math
import re
import tempfile
from pathlib import Path
from typing import Any, Literal

import tomli_w
from numpy.typing import NDArray

from uavbench.errors import one_line
from uavbench.geodata.libraries import GeodataError
from uavbench.world.cells import rows_of
from uavbench.world.files import check_name, write_together
from uavbench.world.provenance import Provenance
from uavbench.world.scenario import Scenario, ScenarioError, load_scenario

MissionName = Literal["cpp", "dh"]

_URBAN_SIDE = 50  # cells of Urban50, whose budgets are scaled to the map
_BUDGETS: dict[MissionName, tuple[int, int]] = {"cpp": (150, 250), "dh": (100, 200)}
_LOCAL_SIZE, _GLOBAL_CELLS = 17, 10
_ID = re.compile(r"[A-Za-z0-9]+(-[A-Za-z0-9]+)*-v\d+")
_TABLES: dict[MissionName, str] = {
    "cpp": """\
[rewards]
movement = -0.2
safety = -1.0
crash = -150.0
collect = 0.4 # per newly covered cell

[observation]
local_size = {local_size}
global_scale = {global_scale}

[mission]
kind = "coverage"
camera_size = 5
shapes = [3, 8]
target_fraction = [0.2, 0.5]
""",
    "dh": """\
[rewards]
movement = -0.1
safety = -1.0
crash = -150.0
collect = 1.0 # per data unit

[observation]
local_size = {local_size}
global_scale = {global_scale}

[mission]
kind = "harvesting"
devices = [3, 10]
data = [5.0, 20.0]
communication_steps = 4
cell_size = {cell!r} # m
altitude = {altitude!r} # m
edge_snr = -30.0 # dB
path_loss_exponent = {{ los = 2.27, nlos = 3.64 }}
fading_variance = {{ los = 2.0, nlos = 5.0 }} # dB²
""",
}
_TITLES: dict[MissionName, str] = {"cpp": "Coverage of {place}", "dh": "Data harvesting in {place}"}


def default_id(out: Path, mission: MissionName) -> str:
    """Return the id of a scenario that is written to ``out``: ``my_city.toml`` becomes ``MyCity-CPP-v0``."""
    if _ID.fullmatch(out.stem):
        return out.stem
    return f"{_place(out.stem) or 'City'}-{mission.upper()}-v0"


def _place(text: str) -> str:
    """Return a text as one word of letters and digits, with a capital for each of its words."""
    return "".join(word[0].upper() + word[1:] for word in re.findall(r"[A-Za-z0-9]+", text))


def city_toml(name: str, out: Path, mission: MissionName, shape: tuple[int, int], provenance: Provenance) -> str:
    """Return the TOML file of a scenario on an imported map: Urban50's parameters, with budgets for the map's size."""
    scale = math.sqrt(shape[0] * shape[1]) / _URBAN_SIDE
    budget = [max(1, round(each * scale)) for each in _BUDGETS[mission]]
    place = name.rpartition("-v")[0].removesuffix(f"-{mission.upper()}")
    head: dict[str, Any] = {"id": name, "title": _TITLES[mission].format(place=place), "map": f"{out.stem}.txt"}
    table = _TABLES[mission].format(
        local_size=min(_LOCAL_SIZE, 2 * min(shape) - 1),
        global_scale=min(max(1, round(max(shape) / _GLOBAL_CELLS)), 2 * min(shape) - 1),
        cell=provenance.cell_size,
        altitude=provenance.altitude,
    )
    origin = tomli_w.dumps({"provenance": provenance.model_dump()})
    origin = re.sub(r"\[\n\s+(.*?),\n\]", lambda found: "[" + re.sub(r",\n\s+", ", ", found[1]) + "]", origin, flags=re.DOTALL)
    return f"{tomli_w.dumps(head)}budget = {budget}\n\n{table}\n{origin}"


def check_out(out: Path, overwrite: bool) -> None:
    """Refuse a name that the files of a city cannot have, or that is taken.

    Raises
    ------
    GeodataError
        The message says why.
    """
    if out.suffix != ".toml":
        raise GeodataError(f"{one_line(out)}: the file to write is a scenario, so its name must end in .toml")
    try:
        check_name(out.name)
    except ValueError as error:
        raise GeodataError(str(error)) from None
    for path in (out, out.with_suffix(".txt")):
        if not overwrite and path.exists():
            raise GeodataError(f"{one_line(path)}: exists already: choose another name, or --force to replace it")


def write_city(out: Path, text: str, cells: NDArray[Any]) -> Scenario:
    """Write a scenario and its map together, after loading both from another place: nothing stays that cannot be flown.

    Raises
    ------
    GeodataError
        When the scenario is not valid, or a file cannot be written.
    """
    contents = {out.name: text.encode(), f"{out.stem}.txt": ("\n".join(rows_of(cells)) + "\n").encode()}
    with tempfile.TemporaryDirectory() as folder:
        for name, content in contents.items():
            Path(folder, name).write_bytes(content)
        try:
            load_scenario(Path(folder, out.name))
        except ScenarioError as error:
            raise GeodataError(str(error).replace(str(Path(folder).resolve()), str(out.parent))) from None
    try:
        write_together({out.parent / name: content for name, content in contents.items()})
    except OSError as error:
        raise GeodataError(f"{error.filename}: cannot write it: {error.strerror}") from None
    return load_scenario(out)
