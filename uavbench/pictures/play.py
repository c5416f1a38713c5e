"""Lets a person fly episodes, and scores them."""

from collections.abc import Callable

import numpy as np

from uavbench.drawing.raster import captioned, raster
from uavbench.drawing.scene import scene_of
from uavbench.drawing.trail import Trail
from uavbench.drawing.window import Window
from uavbench.evaluation.evaluate import EpisodeRecord
from uavbench.evaluation.replay import fly_recorded
from uavbench.simulation.simulator import Simulator
from uavbench.world.city import EAST, HOVER, LAND, NORTH, SOUTH, WEST
from uavbench.world.episode import split_size
from uavbench.world.scenario import Scenario, ScenarioError, SplitName

KEYS = {
    "up": NORTH,
    "right": EAST,
    "down": SOUTH,
    "left": WEST,
    "space": HOVER,
    "h": HOVER,
    "return": LAND,
    "enter": LAND,  # on the keypad
    "l": LAND,
}
HELP = ("arrows fly, space hovers, return lands", "r starts again, n takes the next episode, q ends")


def play(
    scenario: Scenario,
    split: SplitName,
    episode: int,
    on_end: Callable[[EpisodeRecord], None] = lambda record: None,
    window: Window | None = None,
) -> None:
    """Let a person fly episodes in a window until it is closed; ``on_end`` is called with the record of each finished episode.

    Raises
    ------
    ScenarioError
        When the scenario is for a team.
    ValueError
        When the split has no such episode.
    WindowError
        When there is no display.
    ImportError
        When pygame-ce is missing.
    """
    if scenario.team:
        raise ScenarioError(f"{scenario.id} is for a team: choose a scenario for one UAV")
    window = window or Window()
    simulator, step = Simulator(scenario, 1), 0
    try:
        while step is not None:
            episode = (episode + step) % split_size(scenario, split)
            simulator.reset([0], split, [episode])
            step = _fly(simulator, split, episode, window, on_end)
    finally:
        window.close()


def _fly(
    simulator: Simulator, split: SplitName, episode: int, window: Window, on_end: Callable[[EpisodeRecord], None]
) -> int | None:
    """Fly one episode. Return 0 to fly it again, 1 to go on with the next one, or None to quit."""
    trail, state = Trail(simulator, 0), simulator.state
    actions: list[int] = []
    while True:
        scene = scene_of(simulator, 0, trail)
        title = f"{simulator.scenario.id} {split} {episode}"
        window.show(captioned(raster(scene), scene.title + _ended(simulator), *HELP), title)
        key = window.key()
        if key in (None, "q", "escape"):
            return None
        if key in ("r", "n"):
            return int(key == "n")
        if key in KEYS and not state.done[0, 0]:
            simulator.step([KEYS[key]])
            trail.extend()
            actions.append(KEYS[key])
            if state.done[0, 0]:
                record = fly_recorded(simulator.scenario, split, episode, np.array(actions, dtype=np.uint8)[:, None])
                assert record is not None
                on_end(record)


def _ended(simulator: Simulator) -> str:
    """Return how the episode ended, with its score; an empty text before it has ended."""
    if not simulator.state.done[0, 0]:
        return ""
    cral = float(simulator.outcomes([0])["cral"][0])
    return f"{', landed' if simulator.state.landed[0, 0] else ''}, CRAL = {cral:.2f}"
