"""What ``render`` shows, for all adapters. Without a render mode nothing is stored, and no drawing library is imported."""

from collections.abc import Iterable, Sequence
from typing import Any

from uavbench.drawing.trail import Trail
from uavbench.envs.core import METADATA
from uavbench.simulation.simulator import Simulator


class Pictures:
    """Pictures of a simulator's episodes.

    Parameters
    ----------
    simulator : Simulator
    mode : {"human", "rgb_array", "ansi"}, optional
        ``"human"`` shows slot 0 in a window after every reset and step.
    """

    def __init__(self, simulator: Simulator, mode: str | None) -> None:
        self._simulator, self._mode = simulator, mode
        self._trails: dict[int, Trail] = {}
        self._window: Any = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave the window out of copies and pickles: each copy opens its own window when it has something to show."""
        return {**self.__dict__, "_window": None}

    def begin(self, index: Iterable[int]) -> None:
        """Start the trails of the episodes that begin in the slots ``index``."""
        if self._mode is not None:
            self._trails.update({i: Trail(self._simulator, i) for i in index})
            self._show()

    def end(self, index: Iterable[int]) -> None:
        """Remove the trails of the slots ``index``, in which no episode runs until one begins."""
        for i in index:
            self._trails.pop(i, None)

    def extend(self) -> None:
        """Add the step that was just flown to the trails."""
        if self._mode is not None:
            for trail in self._trails.values():
                trail.extend()
            self._show()

    def get_state(self, index: Sequence[int]) -> list[dict[str, Any] | None]:
        """Return the states of the trails in the slots ``index``; None for a slot without a trail."""
        return [self._trails[i].get_state() if i in self._trails else None for i in index]

    def set_state(self, states: list[dict[str, Any] | None], index: Sequence[int]) -> None:
        """Restore the trails from `get_state` in the slots ``index``; a single one in all of them. None starts a new trail."""
        self.begin(index)
        for i, state in zip(index, states * (len(index) if len(states) == 1 else 1), strict=True):
            if i in self._trails and state is not None:
                self._trails[i].set_state(state)
        self._show()

    def of(self, i: int) -> Any:
        """Return the picture of slot ``i``: an array (rows, columns, 3) of uint8, or text; None with a window or no mode.

        Raises
        ------
        RuntimeError
            When no episode has begun.
        """
        if self._mode is None:
            return None
        if i not in self._trails:
            raise RuntimeError("no episode has begun: call reset() first")
        from uavbench.drawing import raster as render

        if self._mode == "human":
            return self._show()
        draw = render.frame if self._mode == "rgb_array" else render.text
        return draw(self._simulator, i, self._trails[i])

    def close(self) -> None:
        """Close the window, if one is open."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def _show(self) -> None:
        """Show slot 0 in the window."""
        if self._mode != "human":
            return
        from uavbench.drawing.raster import captioned, raster
        from uavbench.drawing.scene import scene_of
        from uavbench.drawing.window import Window

        self._window = self._window or Window()
        scene = scene_of(self._simulator, 0, self._trails[0])
        self._window.show(captioned(raster(scene), scene.title), self._simulator.scenario.id, METADATA["render_fps"])
