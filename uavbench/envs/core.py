"""What the adapters share: spaces, actions, reset options, and the information about a step."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypedDict, Unpack, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from uavbench.simulation.missions import Mission
from uavbench.simulation.observation import Observer
from uavbench.simulation.outcomes import successes_of
from uavbench.simulation.simulator import Simulator
from uavbench.simulation.slots import SimulatorState
from uavbench.world.city import NUM_ACTIONS
from uavbench.world.scenario import SPLITS, Scenario, load_scenario
from uavbench.world.values import as_array, as_integer, as_list, shown

METADATA: dict[str, Any] = {"render_modes": ["human", "rgb_array", "ansi"], "render_fps": 8}

#: The values of ``info["split"]``: 0 train, 1 validation, 2 test, 3 an episode that was set by hand.
SPLIT_CODES: dict[str, int] = {name: code for code, name in enumerate((*SPLITS, Simulator.CUSTOM))}

#: The default of ``success_cr``: an episode is a success if the UAV landed and CR is at least this.
SUCCESS_CR = 0.9


class EnvState(NamedTuple):
    """What ``get_state`` returns: copies of the state of an environment's episodes. It can be pickled."""

    simulator: SimulatorState
    trails: list[dict[str, Any] | None]
    elapsed: NDArray[np.int64] = np.zeros(1, dtype=np.int64)  # steps so far, if the environment counts them


class Changes(TypedDict, total=False):
    """The keyword arguments of every environment that change its scenario."""

    local_size: int | None
    global_scale: int | None
    rewards: Mapping[str, float] | None
    budget: Sequence[int] | None


def load(scenario: str | Path | Scenario, **changes: Unpack[Changes]) -> Scenario:
    """Load a scenario, changed as the keyword arguments of an environment say."""
    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    rewards, budget = changes.pop("rewards", None), changes.pop("budget", None)
    for name in changes:
        if name not in Changes.__annotations__:
            # In Python's own words, for which TorchRL looks when it tries arguments out.
            raise TypeError(f"got an unexpected keyword argument {name!r}: an environment has no such argument")
    if rewards is not None:
        loaded = loaded.with_rewards(**rewards)
    if budget is not None:
        listed = as_list(budget) or []
        if len(listed) != 2:
            raise ValueError(f"budget: {shown(budget)} is not a pair [low, high]")
        loaded = loaded.with_budget(*listed)
    return loaded.with_observation(changes.get("local_size"), changes.get("global_scale"))


def check_alone(scenario: Scenario) -> Scenario:
    """Return the scenario; raise a ValueError if it is for a team."""
    if scenario.team:
        raise ValueError(f'{scenario.id} is for a team: use uavbench.parallel_env("{scenario.id}")')
    return scenario


def refuse_team(scenario: str, **_: Any) -> Any:
    """Raise a ValueError that says how to make a team's environment; ``gymnasium.make`` and ``make_vec`` do for team ids."""
    check_alone(load_scenario(scenario))


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
    """Return the render mode; raise a ValueError if it is unknown."""
    if mode is not None and mode not in modes:
        raise ValueError(f"render_mode: {mode!r} is not one of {', '.join(modes)}")
    return mode


def check_success(cr: object) -> float:
    """Return ``cr`` as a float; raise a ValueError if it is not a number from 0 to 1."""
    least = as_array(cr)
    if least is None or least.shape or least.dtype == np.bool_ or not 0 <= least <= 1:
        raise ValueError(f"success_cr: {shown(cr)} is not a number from 0 to 1")
    return float(least)


def check_threads(threads: object) -> int:
    """Return a number of threads; raise a ValueError if it is not an integer of at least 1."""
    number = as_integer(threads)
    if number is None or number < 1:
        raise ValueError(f"threads: {shown(threads)} is not an integer from 1 on")
    return number


def check_action(action: object, whose: str = "") -> int:
    """Return an action as an int; raise a ValueError if it is not an integer from 0 to 5."""
    chosen = as_integer(action)
    if chosen is None or not 0 <= chosen < NUM_ACTIONS:
        raise ValueError(f"actions: {shown(action)}{whose} is not one integer from 0 to {NUM_ACTIONS - 1}")
    return chosen


def information(simulator: Simulator, success_cr: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """Return the contents of every info besides the mask: the episodes of all slots and their metrics so far, of shape (B,).

    Returns
    -------
    dict
        ``split`` (int64: a code of `SPLIT_CODES`), ``episode_number`` (int64, −1 if set by hand), ``landed`` (bool),
        ``cr``, ``cral`` (float64), ``blocked`` (int64), ``is_success`` (bool: landed, and CR at least ``success_cr``).
    """
    splits, numbers = simulator.episodes()
    metrics = successes_of(simulator.state, simulator.slots, success_cr)
    return {"split": splits, "episode_number": numbers, **metrics}


def information_alone(simulator: Simulator, success_cr: float) -> dict[str, Any]:
    """Return the `information` about slot 0: the same values, faster than with arrays of one element.

    TorchRL needs a dtype for each value. A bool is a zero-dimensional array, because Gymnasium's vector environments would
    collect NumPy's bools in an array of objects.
    """
    split, number = simulator.episode_code(0)
    metrics = simulator.outcome(0)
    success = bool(metrics["landed"]) and metrics["cr"] >= success_cr
    return {
        "split": split,
        "episode_number": number,
        "landed": np.array(metrics["landed"]),
        "cr": np.float64(metrics["cr"]),
        "cral": np.float64(metrics["cral"]),
        "blocked": np.int64(metrics["blocked"]),
        "is_success": np.array(success),
    }


def known_options(mission: Mission) -> tuple[str, ...]:
    """Return the options of ``reset`` that every adapter accepts."""
    return ("split", "episode", "start", "budget", mission.option, "noise")


def read_options(options: object) -> dict[str, Any]:
    """Return a copy of the options of ``reset``; raise a ValueError if they are not a dictionary."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ValueError(f"reset(options=...): {shown(options)} is not a dictionary of options")
    return dict(cast("Mapping[str, Any]", options))


def check_options(options: Mapping[str, Any] | None, mission: Mission, extra: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return a copy of the options of ``reset``; raise a ValueError if one is unknown in this scenario."""
    known = (*known_options(mission), *extra)
    given = read_options(options)
    for name in given:
        if name not in known:
            raise ValueError(f"reset(options=...): unknown option {shown(name)}; known are {', '.join(known)}")
    return given
