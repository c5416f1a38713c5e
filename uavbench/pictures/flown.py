"""Flights with physics, seen from above: a figure of the flown way beside the recorded path, and scenes for a film."""

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.drawing.scene import CRASH, UAVS, Colour, Scene
from uavbench.evaluation.results import Result, deliver
from uavbench.flight.flown import Flown, UavFlown
from uavbench.flight.frame import cells_of
from uavbench.flight.ground import cell_size
from uavbench.pictures.figures import Figure, Line2D, fixed_style
from uavbench.pictures.plot import check_plot, draw_on, legend
from uavbench.pictures.watch import recorded_scenes

_SIDE = 6.0  # inches
_PERIOD = 0.25  # seconds between two scenes of a film


def title_of(flown: Flown) -> str:
    """Return what is to be said of a flight in a line."""
    seconds, energy = sum(uav.seconds for uav in flown.uavs), sum(uav.energy for uav in flown.uavs)
    end = "" if flown.safe else ", hit something" if any(uav.hit for uav in flown.uavs) else ", entered a no-fly zone"
    wind = f", wind {flown.conditions.wind:g} m/s" if flown.conditions.wind else ""
    return f"{flown.conditions.speed:g} m/s{wind}: {seconds:.0f} s, {energy:.1f} Wh, CR = {flown.cr:.2f}{end}"


def save_flown(result: Result, flown: Flown, path: Path, scenario_file: str | None = None) -> None:
    """Draw the flown ways over the recorded path, in the format of the file's ending.

    Raises
    ------
    ResultError
        When the ending is unknown, or the file cannot be written.
    """
    check_plot(path)
    scene = recorded_scenes(result, flown.flight.episode, scenario_file)[-1]
    rows, cols, _ = scene.cells.shape
    buffer = io.BytesIO()
    with fixed_style():
        figure: Any = Figure(figsize=(_SIDE, _SIDE * rows / cols + 1.2), layout="constrained")
        axes = figure.subplots()
        draw_on(axes, replace(scene, title=title_of(flown)), 72 * _SIDE / cols * 0.8)
        handles = legend(scene)
        for number, uav in enumerate(flown.uavs):
            colour = _shade(UAVS[number % len(UAVS)])
            places = ways(flown, uav)
            axes.plot(places[:, 1], places[:, 0], color=colour, lw=1.2, zorder=6)
            if uav.hit:
                axes.plot(*places[-1][::-1], "X", color=_shade(CRASH), ms=9, zorder=7)
        handles.append(Line2D([], [], color=_shade(UAVS[0]), lw=1.2, label="flown with physics"))
        figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=6.5, frameon=False)
        figure.savefig(buffer, dpi=160, format=path.suffix.lower().removeprefix("."))
    deliver({path: buffer.getvalue()})


def flown_scenes(result: Result, flown: Flown, scenario_file: str | None = None) -> Sequence[Scene]:
    """Return the scenes of a film, four for each second: the recorded path, and where the quadrotors are."""
    base = recorded_scenes(result, flown.flight.episode, scenario_file)[-1]
    last = max(float(uav.trace.seconds[-1]) for uav in flown.uavs)
    scenes: list[Scene] = []
    for now in np.arange(0.0, last + _PERIOD, _PERIOD).tolist():
        there: list[tuple[Any, Any]] = []
        for number, uav in enumerate(flown.uavs):
            places, seconds = ways(flown, uav), uav.trace.seconds
            cell = tuple(float(np.interp(now, seconds, places[:, axis])) for axis in range(2))
            there.append((cell, UAVS[number % len(UAVS)]))
        scenes.append(replace(base, uavs=there, title=f"{now:.0f} s of {title_of(flown)}"))
    return scenes


def _shade(colour: Colour) -> tuple[float, float, float]:
    """Return a colour as Matplotlib has it."""
    red, green, blue = colour
    return red / 255, green / 255, blue / 255


def ways(flown: Flown, uav: UavFlown) -> NDArray[np.float64]:
    """Return where a quadrotor was, as rows and columns that are not rounded, shape (T, 2)."""
    scenario = flown.flight.scenario
    return cells_of(uav.trace.places, scenario.shape, cell_size(scenario))
