"""What the adapters share: spaces, reset options, and the information about a step."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from uavbench.city import NUM_ACTIONS
from uavbench.episode import check_number, check_split, split_size
from uavbench.missions import Mission
from uavbench.observation import Observer
from uavbench.scenario import Scenario, SplitName, load_scenario
from uavbench.slots import SimulatorState

METADATA: dict[str, Any] = {"render_modes": ["human", "rgb_array", "ansi"], "render_fps": 8}


class EnvState(NamedTuple):
    """The state of an environment's episodes, by ``get_state``: copies that no environment changes. It can be pickled."""

    simulator: SimulatorState
    trails: list[dict[str, Any] | None]


def load(scenario: str | Path | Scenario, local_size: int | None, global_scale: int | None) -> Scenario:
    """Load a scenario with the observation that an environment was asked for."""
    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    return loaded.with_observation(local_size, global_scale)


def check_alone(scenario: Scenario) -> Scenario:
    """Refuse a team's scenario where one UAV flies alone."""
    if scenario.team:
        raise ValueError(f"{scenario.id} is for a team: use uavbench.parallel_env({scenario.id!r})")
    return scenario


def observation_space(scenario: Scenario, observer: Observer) -> spaces.Dict:
    """Return the space of one observation: ``local`` (unless l = 0), ``global`` and ``budget``, all float32."""
    largest = {"target": scenario.mission.largest_target, "budgets": scenario.budget[1], **scenario.mission.layers}
    most = np.array([largest.get(layer, 1.0) for layer in observer.layers], dtype=np.float32)[:, None, None]
    shapes = {"local": observer.local_shape, "global": observer.global_shape}
    maps: dict[str, spaces.Space[Any]] = {
        name: spaces.Box(np.zeros(shape, np.float32), np.broadcast_to(most, shape), dtype=np.float32)
        for name, shape in shapes.items()
        if np.prod(shape) > 0
    }
    return spaces.Dict({**maps, "budget": spaces.Box(0.0, scenario.budget[1], (1,), np.float32)})


def action_space() -> spaces.Discrete:
    """Return the actions: 0 north, 1 east, 2 south, 3 west, 4 hover, 5 land."""
    return spaces.Discrete(NUM_ACTIONS)


def check_render_mode(mode: str | None, modes: Sequence[str] = METADATA["render_modes"]) -> str | None:
    """Refuse an unknown render mode."""
    if mode is not None and mode not in modes:
        raise ValueError(f"render_mode: {mode!r} is not one of {', '.join(modes)}")
    return mode


def known_options(mission: Mission) -> tuple[str, ...]:
    """Return the options of ``reset`` that every adapter knows."""
    return ("split", "episode", "start", "budget", mission.option, "noise")


def check_options(options: Mapping[str, Any] | None, mission: Mission, extra: tuple[str, ...] = ()) -> dict[str, Any]:
    """Refuse options of ``reset`` that this scenario does not know."""
    known = (*known_options(mission), *extra)
    given = dict(options or {})
    for name in given:
        if name not in known:
            raise ValueError(f"reset(options=...): unknown option {name!r}; known are {', '.join(known)}")
    return given


def choose_episode(
    scenario: Scenario, default: SplitName, options: Mapping[str, Any], generator: np.random.Generator
) -> tuple[SplitName, int]:
    """Return split and number of the next episode: what ``options`` name, else drawn with ``generator``.

    Exactly one number is drawn whatever is asked for, so that a seeded sequence of resets goes on alike.
    """
    drawn = int(generator.bit_generator.random_raw()) >> 2
    split = check_split(options.get("split", default))
    if "episode" in options:
        return split, check_number(scenario, split, options["episode"])
    return split, drawn % split_size(scenario, split)
