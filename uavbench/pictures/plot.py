"""A flight as a figure for publications, in the style of the paper's Fig. 2 and Table II: PNG, SVG or PDF."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uavbench.drawing import scene as shown
from uavbench.drawing.scene import Cell, Colour, Scene
from uavbench.evaluation.results import Result, ResultError, deliver, load_result
from uavbench.pictures.figures import Figure, Line2D, MaxNLocator, Patch, Wedge, fixed_style
from uavbench.pictures.watch import recorded_scenes
from uavbench.world.cells import BUILDING, CELL_NAMES, COLOURS, FREE, LANDING, LOW_BUILDING, NO_FLY

FORMATS = ("png", "svg", "pdf")
_WHITE: Colour = (255, 255, 255)
_INCHES, _TALLEST = 5.0, 7.5
_POINTS = 66.0  # in an inch of the figure's width, less what the axes' labels take


def check_plot(path: Path) -> None:
    """Raise a ResultError if the file's ending is not one of `FORMATS`."""
    if path.suffix.lower().removeprefix(".") not in FORMATS:
        raise ResultError(f"{path}: write to a file that ends in {', '.join('.' + each for each in FORMATS)}")


def save_plot(scene: Scene, path: Path) -> None:
    """Draw a scene with its legend to a file, in the format of its ending. On failure, an existing file does not change.

    Raises
    ------
    ResultError
        When the ending is not one of `FORMATS`, or the file cannot be written.
    """
    check_plot(path)
    buffer = io.BytesIO()
    with fixed_style():
        figure: Any = draw(scene)
        figure.savefig(buffer, dpi=200, format=path.suffix.lower().removeprefix("."))
    deliver({path: buffer.getvalue()})


def draw(scene: Scene) -> Figure:
    """Return the figure of a scene."""
    rows, cols, _ = scene.cells.shape
    height = min(_INCHES * rows / cols, _TALLEST)
    figure: Any = Figure(figsize=(_INCHES, height + 1.1), layout="constrained")
    axes = figure.subplots()
    draw_on(axes, scene, _POINTS * min(_INCHES / cols, height / rows))
    figure.legend(handles=legend(scene), loc="outside lower center", ncols=3, fontsize=6.5, frameon=False)
    return figure


def draw_on(axes: Any, scene: Scene, cell: float) -> None:
    """Draw a scene on Matplotlib axes, on which a cell of the map is about ``cell`` points wide."""
    rows, cols, _ = scene.cells.shape
    axes.imshow(scene.cells, interpolation="nearest")
    for (r0, c0), (r1, c1), colour in scene.moves:
        arrow = {"color": _hex(colour), "lw": 0.11 * cell, "mutation_scale": 0.5 * cell, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", (c1, r1), (c0, r0), arrowprops={"arrowstyle": "-|>", **arrow})
    for device in scene.devices:
        (r, c), colour = device.cell, _hex(device.colour)
        ring = Wedge((c, r), 0.62, 0, 360, facecolor="white", edgecolor=colour, lw=0.12 * cell, zorder=3, clip_on=False)
        axes.add_patch(ring)
        axes.add_patch(Wedge((c, r), 0.5, 90 - 360 * device.left, 90, facecolor=colour, zorder=4, clip_on=False))
    _marks(axes, scene.hovers, "x", 0.45 * cell)
    _marks(axes, scene.starts, "D", 0.62 * cell)
    _marks(axes, [(start, _WHITE) for start, _ in scene.starts], "D", 0.36 * cell)
    _marks(axes, scene.ends, "D", 0.5 * cell, edgecolors="white", linewidths=0.05 * cell)
    _marks(axes, [(cell, shown.CRASH) for cell in scene.crashes], "X", 0.7 * cell)
    _marks(axes, scene.uavs, "o", 0.8 * cell, edgecolors="white")
    axes.set(title=scene.title, xlim=(-0.5, cols - 0.5), ylim=(rows - 0.5, -0.5))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(8, integer=True, steps=[1, 2, 5, 10]))
    axes.tick_params(labelsize=6)


def plot(result: Result | str | Path, episode: int = 0, *, ax: Any = None, scenario: str | None = None) -> Any:
    """Draw an episode of a result on Matplotlib axes, as the paper's Fig. 2 does.

    Parameters
    ----------
    result : Result, str or Path
        A result, or its folder.
    episode : int
        Which of its episodes.
    ax : matplotlib.axes.Axes, optional
        Where to draw; by default new axes of ``matplotlib.pyplot``.
    scenario : str, optional
        The scenario's file, if it is your own and has moved.

    Returns
    -------
    matplotlib.axes.Axes
        ``ax``, or the new axes.

    Raises
    ------
    ResultError
        When the result does not hold the episode, or its scenario cannot be found.

    Examples
    --------
    >>> import matplotlib; matplotlib.use("Agg")
    >>> import uavbench
    >>> ax = uavbench.plot(uavbench.evaluate("greedy", "Block8-CPP-v0", episodes=3), episode=2)
    >>> ax.get_title().startswith("Movement")
    True
    """
    loaded = result if isinstance(result, Result) else load_result(Path(result))
    scene = recorded_scenes(loaded, episode, scenario)[-1]
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.subplots(figsize=(_INCHES, _INCHES), layout="constrained")[1]
    box = ax.get_window_extent()
    rows, cols, _ = scene.cells.shape
    draw_on(ax, scene, 72 / ax.figure.dpi * min(box.width / cols, box.height / rows))
    return ax


def _marks(axes: Any, marks: Sequence[tuple[Cell, Colour]], shape: str, points: float, **more: Any) -> None:
    """Draw marks of one shape and a width in points, in their colours; ``more`` goes to Matplotlib."""
    if marks:
        r, c = np.array([cell for cell, _ in marks]).T
        colours = [_hex(colour) for _, colour in marks]
        more = {"linewidths": 0.1 * points, **more}
        axes.scatter(c, r, s=points**2, marker=shape, c=colours, zorder=5, clip_on=False, **more)


def city_legend(low: bool = False) -> list[Any]:
    """Return the legend's entries for the cells of a map, with ``low`` also the one for low buildings."""
    names = {**dict(enumerate(CELL_NAMES)), LANDING: "start and landing zone"}
    return _patches({names[code]: COLOURS[code] for code in (LANDING, NO_FLY, BUILDING, *((LOW_BUILDING,) if low else ()))})


def _patches(colours: Mapping[str, Any]) -> list[Any]:
    """Return a legend entry for each colour that has a name."""
    return [Patch(facecolor=_hex(colour), edgecolor="0.7", label=name) for name, colour in colours.items() if name]


def legend(scene: Scene) -> list[Any]:
    """Return the legend's entries, as in the paper's Table II but in the mission's words; for a team also those of its UAVs."""
    scenario, words = scene.scenario, scene.scenario.mission.words
    free = np.array(COLOURS[FREE])
    patches = {words.target: shown.blend(free, shown.REMAINING), words.done: shown.blend(free, shown.COVERED)}
    found = [*city_legend(scene.low_buildings), *_patches({**patches, words.shade: free * shown.SHADOW})]
    found += [
        _line("D", "", "start", markerfacecolor="white"),
        _line("D", "", "end"),
        _line("x", "", "hover"),
        _line("X", "", "crash", shown.CRASH, markersize=6, mew=0),
    ]
    if scenario.team:
        found += [_line(">", "-", f"UAV {u}", shown.UAVS[u % len(shown.UAVS)]) for u in range(len(scene.starts))]
    else:
        found.append(_line(">", "-", words.movement))
    if words.mark:
        found.append(_line("o", "", words.mark, shown.DEVICES[0], markerfacecolor="white", markersize=6))
    return found


def _line(marker: str, style: str, label: str, colour: Colour = shown.PATH, **more: Any) -> Line2D:
    options: dict[str, Any] = {"markersize": 4, "lw": 1, **more}
    return Line2D([], [], marker=marker, ls=style, color=_hex(colour), label=label, **options)


def _hex(colour: Any) -> str:
    return "#{:02x}{:02x}{:02x}".format(*(round(float(part)) for part in colour))
