"""A flight as a figure for a paper, after the paper's Fig. 2 and Table II: PNG, SVG or PDF."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Wedge

from uavbench import scene as shown
from uavbench.results import ResultError
from uavbench.scenario import BUILDING, LANDING, NO_FLY, Scenario
from uavbench.scene import Colour, Scene

FORMATS = ("png", "svg", "pdf")
_INCHES = 5.0


def save_plot(scene: Scene, path: Path, scenario: Scenario) -> None:
    """Draw a scene with its legend to a file, whose ending says which format.

    Raises
    ------
    ResultError
        When the ending is none of `FORMATS`, or the file cannot be written.
    """
    if path.suffix.removeprefix(".") not in FORMATS:
        raise ResultError(f"{path}: write to a file that ends in {', '.join('.' + each for each in FORMATS)}")
    figure: Any = draw(scene, scenario)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=200)
    except OSError as error:
        raise ResultError(f"{path}: cannot write it: {error.strerror}") from None


def draw(scene: Scene, scenario: Scenario) -> Figure:
    """Return the figure of a scene."""
    rows, cols = scenario.shape
    figure: Any = Figure(figsize=(_INCHES, _INCHES * (rows / cols) + 1.3), layout="constrained")
    axes = figure.subplots()
    axes.imshow(scene.cells, interpolation="nearest")
    for (r0, c0), (r1, c1), colour in scene.moves:
        axes.annotate(
            "",
            (c1, r1),
            (c0, r0),
            arrowprops={"arrowstyle": "-|>", "color": _hex(colour), "lw": 1.1, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 5},
        )
    _marks(axes, [cell for cell, _ in scene.hovers], [colour for _, colour in scene.hovers], "x", 22, rows)
    for device in scene.devices:
        (r, c), colour = device.cell, _hex(device.colour)
        axes.add_patch(Wedge((c, r), 0.62, 0, 360, facecolor="white", edgecolor=colour, lw=1.2, zorder=3))
        axes.add_patch(Wedge((c, r), 0.5, 90 - 360 * device.left, 90, facecolor=colour, zorder=4))
    for marks in (scene.starts, scene.ends):
        _marks(axes, [cell for cell, _ in marks], [colour for _, colour in marks], "D", 26, rows)
    _marks(axes, [cell for cell, _ in scene.uavs], [colour for _, colour in scene.uavs], "o", 30, rows)
    axes.set(
        title=scene.title, xticks=range(0, cols, 5), yticks=range(0, rows, 5), xlim=(-0.5, cols - 0.5), ylim=(rows - 0.5, -0.5)
    )
    axes.tick_params(labelsize=6)
    figure.legend(handles=legend(scenario), loc="outside lower center", ncols=3, fontsize=6.5, frameon=False)
    return figure


def _marks(axes: Any, cells: Sequence[shown.Cell], colours: Sequence[Colour], marker: str, area: float, rows: int) -> None:
    if cells:
        r, c = np.array(cells).T
        axes.scatter(c, r, s=area * 32 / rows, marker=marker, c=[_hex(colour) for colour in colours], linewidths=1.1, zorder=5)


def legend(scenario: Scenario) -> list[Any]:
    """Return the entries of the paper's Table II that the mission has."""
    city = shown.city_colours(("".join((LANDING, NO_FLY, BUILDING)),))[0].tolist()
    coverage = scenario.mission.kind == "coverage"
    patches = {"start and landing zone": city[0], "no-fly zone": city[1], "building": city[2]}
    if coverage:
        patches |= {"target to cover": shown.REMAINING, "covered target": shown.COVERED}
    else:
        patches |= {"shadowed from devices": tuple(round(255 * shown.SHADOW) for _ in range(3))}
    lines = {"start and end": "D", "hover": "x"}
    found: list[Any] = [Patch(facecolor=_hex(colour), edgecolor="0.7", label=name) for name, colour in patches.items()]
    found += [
        Line2D([], [], marker=mark, ls="", color=_hex(shown.PATH), markersize=4, label=name) for name, mark in lines.items()
    ]
    moving = "movement" if coverage or scenario.team else "movement (of the served device)"
    found.append(Line2D([], [], marker=">", color=_hex(shown.PATH), markersize=4, lw=1, label=moving))
    if not coverage:
        found.append(
            Line2D(
                [],
                [],
                marker="o",
                ls="",
                markerfacecolor="white",
                color=_hex(shown.DEVICES[0]),
                markersize=6,
                label="device, with the data left",
            )
        )
    return found


def _hex(colour: Sequence[int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)
