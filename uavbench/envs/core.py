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

#: What ``info["split"]`` says: 0 train, 1 validation, 2 test, 3 an episode that was set by hand.
SPLIT_CODES: dict[str, int] = {name: code for code, name in enumerate((*SPLITS, Simulator.CUSTOM))}

#: The least CR of a flight that landed and counts as a success, unless an environment was asked for another.
SUCCESS_CR = 0.9


class EnvState(NamedTuple):
    """The state of an environment's episodes, by ``get_state``: copies that no environment changes. It can be pickled."""

    simulator: SimulatorState
    trails: list[dict[str, Any] | None]
    elapsed: NDArray[np.int64] = np.zeros(1, dtype=np.int64)  # steps, where the environment counts them


class Changes(TypedDict, total=False):
    """What an environment may change of its scenario: keyword arguments of every environment."""

    local_size: int | None
    global_scale: int | None
    rewards: Mapping[str, float] | None
    budget: Sequence[int] | None


def load(scenario: str | Path | Scenario, **changes: Unpack[Changes]) -> Scenario:
    """Load a scenario with the observation, rewards and budgets that an environment was asked for."""
    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    rewards, budget = changes.pop("rewards", None), changes.pop("budget", None)
    for name in changes:
        if name not in Changes.__annotations__:
            raise TypeError(f"{name}: an environment has no such argument")
    if rewards is not None:
        loaded = loaded.with_rewards(**rewards)
    if budget is not None:
        listed = as_list(budget) or []
        if len(listed) != 2:
            raise ValueError(f"budget: {shown(budget)} is not a pair [low, high]")
        loaded = loaded.with_budget(*listed)
    return loaded.with_observation(changes.get("local_size"), changes.get("global_scale"))


def check_alone(scenario: Scenario) -> Scenario:
    """Refuse a team's scenario where one UAV flies alone."""
    if scenario.team:
        raise ValueError(f'{scenario.id} is for a team: use uavbench.parallel_env("{scenario.id}")')
    return scenario


def refuse_team(scenario: str, **_: Any) -> Any:
    """Say how a team's environment is made: what ``gymnasium.make`` and ``make_vec`` do with the id of a team's scenario."""
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
    """Refuse an unknown render mode."""
    if mode is not None and mode not in modes:
        raise ValueError(f"render_mode: {mode!r} is not one of {', '.join(modes)}")
    return mode


def check_success(cr: object) -> float:
    """Return the CR from which on a flight that landed counts as a success, or refuse what is not from 0 to 1."""
    least = as_array(cr)
    if least is None or least.shape or least.dtype == np.bool_ or not 0 <= least <= 1:
        raise ValueError(f"success_cr: {shown(cr)} is not a number from 0 to 1")
    return float(least)


def check_action(action: object, whose: str = "") -> int:
    """Return an action as an int, or refuse what is none."""
    chosen = as_integer(action)
    if chosen is None or not 0 <= chosen < NUM_ACTIONS:
        raise ValueError(f"actions: {shown(action)}{whose} is not one integer from 0 to {NUM_ACTIONS - 1}")
    return chosen


def information(simulator: Simulator, success_cr: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """Return what every info tells besides the mask: the episodes of all slots and their metrics so far, each of shape (B,).

    Returns
    -------
    dict
        ``split`` (int64: a code of `SPLIT_CODES`), ``episode_number`` (int64, −1 where set by hand), ``landed`` (bool),
        ``cr``, ``cral`` (float64), ``blocked`` (int64), ``is_success`` (bool: landed, and CR at least ``success_cr``).
    """
    splits, numbers = simulator.episodes()
    metrics = successes_of(simulator.state, simulator.slots, success_cr)
    return {"split": splits, "episode_number": numbers, **metrics}


def information_alone(simulator: Simulator, success_cr: float) -> dict[str, Any]:
    """Return the `information` about slot 0: the same values, in less time than arrays of one take.

    TorchRL asks each of them for its dtype. A bool is an array without a dimension: of NumPy's bool, Gymnasium's vector
    environments would make an array of objects.
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
    """Return the options of ``reset`` that every adapter knows."""
    return ("split", "episode", "start", "budget", mission.option, "noise")


def read_options(options: object) -> dict[str, Any]:
    """Return a copy of the options of ``reset``, or refuse what is no dictionary."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ValueError(f"reset(options=...): {shown(options)} is not a dictionary of options")
    return dict(cast("Mapping[str, Any]", options))


def check_options(options: Mapping[str, Any] | None, mission: Mission, extra: tuple[str, ...] = ()) -> dict[str, Any]:
    """Refuse options of ``reset`` that this scenario does not know."""
    known = (*known_options(mission), *extra)
    given = read_options(options)
    for name in given:
        if name not in known:
            raise ValueError(f"reset(options=...): unknown option {shown(name)}; known are {', '.join(known)}")
    return given
