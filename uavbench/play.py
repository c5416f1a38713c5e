"""A person flies, and is scored."""

from collections.abc import Callable

import numpy as np

from uavbench.city import EAST, HOVER, LAND, NORTH, SOUTH, WEST
from uavbench.evaluate import EpisodeRecord
from uavbench.render import raster
from uavbench.replay import fly_recorded
from uavbench.scenario import Scenario, ScenarioError, SplitName
from uavbench.scene import scene_of
from uavbench.simulator import Simulator
from uavbench.trail import Trail
from uavbench.window import Window

KEYS = {
    "up": NORTH,
    "right": EAST,
    "down": SOUTH,
    "left": WEST,
    "space": HOVER,
    "h": HOVER,
    "return": LAND,
    "l": LAND,
}
HELP = "arrows fly, space hovers, return lands, r starts again, n takes the next episode, q ends"


def play(
    scenario: Scenario,
    split: SplitName,
    episode: int,
    on_end: Callable[[EpisodeRecord], None] = lambda record: None,
    window: Window | None = None,
) -> None:
    """Let a person fly episodes in a window until it is closed; every finished one is shown to ``on_end``.

    Raises
    ------
    ScenarioError
        When the scenario is for a team.
    ValueError
        When the split has no such episode.
    """
    if scenario.team:
        raise ScenarioError(f"{scenario.id} is for a team: choose a scenario for one UAV")
    window = window or Window()
    simulator, step = Simulator(scenario, 1), 0
    try:
        while step is not None:
            episode += step
            simulator.reset([0], split, [episode])
            step = _fly(simulator, split, episode, window, on_end)
    finally:
        window.close()


def _fly(
    simulator: Simulator, split: SplitName, episode: int, window: Window, on_end: Callable[[EpisodeRecord], None]
) -> int | None:
    """Fly one episode; return how many episodes further to go on, or None to end."""
    trail, state = Trail(simulator, 0), simulator.state
    actions: list[int] = []
    while True:
        scene = scene_of(simulator, 0, trail)
        ended = "" if not state.done[0, 0] else " · landed" if state.landed[0, 0] else " · crashed"
        window.show(raster(scene), f"{simulator.scenario.id} {split} {episode}: {scene.title}{ended} · {HELP}")
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
