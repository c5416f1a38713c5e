"""The files of an imported city: a scenario's TOML file, and the map as text beside it."""

import contextlib
import errno
import math
import os
import re
import tempfile
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from uavbench.errors import one_line
from uavbench.geodata.libraries import GeodataError
from uavbench.geodata.names import MissionName, place_of
from uavbench.world.cells import FREE, NO_FLY, rows_of
from uavbench.world.files import check_folder, check_name, write_together
from uavbench.world.provenance import Provenance
from uavbench.world.scenario import Scenario, ScenarioError, load_scenario

_URBAN_SIDE = 50  # cells of Urban50, whose budgets are scaled to the map
_BUDGETS: dict[MissionName, tuple[int, int]] = {"cpp": (150, 250), "dh": (100, 200)}
_LOCAL_SIZE, _GLOBAL_CELLS = 17, 10
_DEVICES = (3, 10)
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
devices = {devices}
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


def city_toml(name: str, out: Path, mission: MissionName, cells: NDArray[Any], provenance: Provenance) -> str:
    """Return the TOML file of a scenario on an imported map: Urban50's parameters, with budgets for the map's size.

    A small map has fewer devices: at most as many as there are cells for them.

    Raises
    ------
    GeodataError
        When data harvesting has no cell for a device.
    """
    shape, places = cells.shape, int(np.isin(cells, (FREE, NO_FLY)).sum())
    if mission == "dh" and not places:
        raise GeodataError(
            "mission: dh: besides the landing zones, no cell without buildings is left for a device: "
            "choose a larger --shape, another --centre, or --mission cpp"
        )
    scale = math.sqrt(shape[0] * shape[1]) / _URBAN_SIDE
    budget = [max(1, round(each * scale)) for each in _BUDGETS[mission]]
    head: dict[str, Any] = {"id": name, "title": _TITLES[mission].format(place=place_of(name)), "map": f"{out.stem}.txt"}
    table = _TABLES[mission].format(
        local_size=min(_LOCAL_SIZE, 2 * min(shape) - 1),
        global_scale=min(max(1, round(max(shape) / _GLOBAL_CELLS)), 2 * min(shape) - 1),
        devices=[min(number, places) for number in _DEVICES],
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
        raise GeodataError(f"--out {one_line(out)}: the file to write is a scenario, so its name must end in .toml")
    try:
        check_name(out.name)
    except ValueError as error:
        raise GeodataError(f"--out {one_line(out)}: {error}") from None
    with _saying_where(out):
        check_folder(out.parent)
        for path in (out, out.with_suffix(".txt")):
            if path.is_dir():
                raise IsADirectoryError(errno.EISDIR, "it is a folder, not a file", str(path))
            if not overwrite and path.exists():
                raise GeodataError(f"{one_line(path)}: exists already: choose another --out, or --force to replace it")


@contextlib.contextmanager
def _saying_where(out: Path) -> Generator[None]:
    """Turn an OSError in the block into an error that says that ``--out`` cannot be written."""
    try:
        yield
    except NotADirectoryError as error:
        raise GeodataError(f"--out {one_line(out)}: {error.strerror}: choose another folder") from None
    except OSError as error:
        raise GeodataError(f"--out {one_line(out)}: cannot write {error.filename or out}: {error.strerror or error}") from None


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
            place = Path(folder).resolve()  # which the user does not know, as the file that is not written either
            reason = str(error).removeprefix(f"{place / out.name}: ").replace(f"{place}{os.sep}", "")
            raise GeodataError(f"--out {one_line(out)}: nothing is written: {reason}") from None
    with _saying_where(out):
        write_together({out.parent / name: content for name, content in contents.items()})
    return load_scenario(out)
