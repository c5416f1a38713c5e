"""Checking results by simulating the recorded actions again, and comparing two results on the same episodes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.evaluation.evaluate import NO_ACTION, EpisodeRecord
from uavbench.evaluation.metrics import METRICS, ROUNDING, Comparison, compare, tolerance
from uavbench.evaluation.results import COLUMNS, Result, ResultError, metrics_of, numbered, spread_of
from uavbench.simulation.simulator import Simulator
from uavbench.world.cities import city_numbers
from uavbench.world.city import HOVER, NUM_ACTIONS
from uavbench.world.episode import check_split, split_size
from uavbench.world.scenario import Scenario, ScenarioError, SplitName, load_scenario

_MAX_CELLS = 2**25  # of all maps that are simulated side by side; a target map takes 4 bytes per cell


def replay(result: Result, scenario_file: str | None = None) -> list[str]:
    """Simulate the actions of a result again and compare every number.

    Parameters
    ----------
    result : Result
        What is checked.
    scenario_file : str, optional
        The scenario's file, if it is the user's own and has moved.

    Returns
    -------
    list of str
        What differs, a line each; empty when every number is reproduced.

    Raises
    ------
    ResultError
        When the scenario's digest is not the result's, or a file is damaged.

    Examples
    --------
    >>> import uavbench
    >>> uavbench.replay(uavbench.evaluate("greedy", "Block8-CPP-v0", episodes=3))
    []
    """
    return fly_all_recorded(result, scenario_file)[1]


def fly_all_recorded(result: Result, scenario_file: str | None = None) -> tuple[list[EpisodeRecord], list[str]]:
    """Simulate the actions of a result again.

    Parameters
    ----------
    result : Result
        The result to check.
    scenario_file : str, optional
        The path of a user's own scenario, if its file has been moved.

    Returns
    -------
    records : list of EpisodeRecord
        What the simulation gives, independent of the numbers in the result.
    wrong : list of str
        One line for each number of the result that differs from it; empty when every number is reproduced.

    Raises
    ------
    ResultError
        When the scenario's digest is not the result's, or a file is damaged.
    """
    summary = result.summary
    scenario, split = flown_in(result, scenario_file)
    table, actions = result.episodes(), result.actions()
    episodes: int = summary["episodes"]
    for name, found in (("episodes.csv", table["episode"].tolist()), ("actions.npz", list(actions))):
        if not numbered(found, episodes) or not 0 < episodes <= split_size(scenario, split):
            return [], [f"{name} does not hold the episodes 0 to {episodes - 1}, each once and in order"]
    wrong: list[str] = []
    flown: list[EpisodeRecord] = []
    # CPP is exact on any machine; in DH, platforms' logarithms differ in their last digits.
    allowed = tolerance(scenario)
    expected = range(episodes)
    together = fly_together(scenario, split, expected, [actions[number] for number in expected])
    for number, record, row in zip(expected, together, table[list(COLUMNS)].to_dict("records"), strict=True):
        if record is None:
            wrong.append(f"episode {number}: actions.npz does not hold the actions of a whole episode")
            continue
        flown.append(record)
        for column, field in COLUMNS.items():
            value = float(getattr(record, field))
            if not abs(value - float(row[column])) <= allowed:  # so that NaN differs
                wrong.append(f"episode {number}: {column} is {value:g}, episodes.csv says {row[column]}")
    if wrong:
        return flown, wrong
    counted = sum(record.steps for record in flown)
    if summary["decisions"] != counted:
        wrong.append(f"summary.json: decisions is {counted}, the file says {summary['decisions']}")
    for name, interval in metrics_of(flown, scenario, split).items():
        said = asdict(result.metrics[name])
        wrong += [f"summary.json: metrics.{name}.{line}" for line in _differences(asdict(interval), said)]
    spread = spread_of(flown, scenario, split)
    if spread is not None:
        found = _differences(asdict(spread), summary.get("cral_over_cities") or {})
        wrong += [f"summary.json: cral_over_cities.{line}" for line in found]
    return flown, wrong


def _differences(values: Mapping[str, float], said: Mapping[str, Any]) -> list[str]:
    """Return a line for each value that is not what a file says."""
    return [
        f"{name} is {value:g}, the file says {said.get(name)}"
        for name, value in values.items()
        if not isinstance(said.get(name), int | float) or not abs(value - said[name]) <= ROUNDING
    ]


def flown_in(result: Result, scenario_file: str | None = None) -> tuple[Scenario, SplitName]:
    """Return the scenario and the split of a result.

    Parameters
    ----------
    result : Result
    scenario_file : str, optional
        The path of a user's own scenario, if its file has been moved.

    Raises
    ------
    ResultError
        When the scenario is missing or has another digest than that of the result, or there is no such split.
    """
    summary = result.summary
    try:
        scenario = load_scenario(scenario_file) if scenario_file else result.scenario
    except ScenarioError as error:
        hint = "" if scenario_file else "; if the scenario has moved: --scenario FILE"
        raise ResultError(f"{result.folder}: {error}{hint}") from None
    if scenario.digest != summary["scenario_digest"]:
        raise ResultError(
            f"{result.folder}: scenario_digest: the result is of another version of {scenario.id} "
            f"({summary['scenario_digest'][:12]}…, this one is {scenario.digest[:12]}…)"
        )
    try:
        return scenario, check_split(summary["split"])
    except ValueError as error:
        raise ResultError(f"{result.folder}: split: {error}") from None


def fly_recorded(
    scenario: Scenario,
    split: SplitName,
    number: int,
    actions: NDArray[np.uint8],
    watch: Callable[[Simulator], None] = lambda simulator: None,
) -> EpisodeRecord | None:
    """Fly one episode with recorded actions; ``watch`` sees the simulator at the start and after every step.

    Returns None when the actions are not those of a whole episode.
    """
    return _fly(Simulator(scenario, 1), split, [number], [actions], watch)[0]


def fly_together(
    scenario: Scenario, split: SplitName, numbers: Sequence[int], flights: Sequence[NDArray[np.uint8]]
) -> list[EpisodeRecord | None]:
    """Fly episodes with recorded actions side by side; the numbers are the same as when each episode is flown alone.

    Parameters
    ----------
    scenario : Scenario
    split : {"train", "validation", "test"}
    numbers : sequence of int
        Which episodes.
    flights : sequence of ndarray of uint8
        The actions of each episode, shape (T, U), as in `EpisodeRecord`.

    Returns
    -------
    list of EpisodeRecord or None
        One for each episode, in the same order; None where the actions are not those of a whole episode.
    """
    rows, cols = scenario.shape
    slots = max(1, min(len(numbers), _MAX_CELLS // (rows * cols)))
    simulator = Simulator(scenario, slots)
    found: list[EpisodeRecord | None] = []
    for k in range(0, len(numbers), slots):
        found += _fly(simulator, split, numbers[k : k + slots], flights[k : k + slots])
    return found


def _fly(
    simulator: Simulator,
    split: SplitName,
    numbers: Sequence[int],
    flights: Sequence[NDArray[np.uint8]],
    watch: Callable[[Simulator], None] = lambda simulator: None,
) -> list[EpisodeRecord | None]:
    """Fly the episodes ``numbers`` in the first slots. A UAV whose action is missing hovers; its episode is not whole."""
    state, count, most = simulator.state, len(numbers), simulator.scenario.max_uavs
    simulator.reset(np.arange(count), split, numbers)
    watch(simulator)
    longest = state.budget[:count].max(axis=1)  # each step costs every flying UAV 1 of its budget
    lengths = np.array([len(flight) for flight in flights])
    whole = np.array([flight.shape[1:] == (most,) for flight in flights]) & (lengths <= longest)
    actions = np.full((max(lengths[whole], default=0), simulator.num_envs, most), NO_ACTION, dtype=np.uint8)
    for i in np.flatnonzero(whole).tolist():
        actions[: lengths[i], i] = flights[i]
    steps, rewards = np.zeros(count, dtype=np.int64), np.zeros(count)
    for row in actions:
        flying = ~state.done[:count]
        steps += flying.any(axis=1)
        whole &= np.where(flying, row[:count] < NUM_ACTIONS, row[:count] == NO_ACTION).all(axis=1)
        chosen = np.where(row < NUM_ACTIONS, row, HOVER)
        simulator.step(chosen if simulator.scenario.team else chosen[:, 0])
        for uav in range(most):  # in the order in which `evaluate` adds them up
            rewards += state.reward[:count, uav]
        watch(simulator)
    whole &= state.done[:count].all(axis=1) & (steps == lengths)
    outcomes = {name: values.tolist() for name, values in simulator.outcomes(np.arange(count)).items()}
    return [
        EpisodeRecord(
            episode=int(number),
            uavs=int(state.uavs[i]),
            budget=int(state.initial_budget[i, : state.uavs[i]].sum()),
            steps=int((flights[i] != NO_ACTION).sum()),
            total_reward=float(rewards[i]),
            actions=flights[i],
            seconds=0.0,
            **{name: values[i] for name, values in outcomes.items()},
        )
        if whole[i]
        else None
        for i, number in enumerate(numbers)
    ]


def compare_results(first: Result, second: Result) -> tuple[dict[str, Comparison], int]:
    """Compare two results on the episodes that both flew, metric by metric.

    Returns
    -------
    comparison : dict of str to Comparison
        By the metric's name.
    episodes : int
        Number of episodes compared: the first ones, as many as the shorter result has.

    Raises
    ------
    ResultError
        When they are not of the same scenario and split.
    """
    check_paired(first, second)
    a, b = first.scores(), second.scores()
    episodes = min(len(a), len(b))
    paired = {name: (a[name].to_numpy(np.float64)[:episodes], b[name].to_numpy(np.float64)[:episodes]) for name in METRICS}
    cities = None
    if "cral_over_cities" in first.summary:  # else the scenario, which may have moved, is not needed
        scenario, split = flown_in(first)
        cities = city_numbers(scenario, split, np.arange(episodes))
    return {name: compare(*values, clusters=cities) for name, values in paired.items()}, episodes


def check_paired(first: Result, second: Result) -> None:
    """Raise a ResultError if two results are not of the same scenario and split."""
    for field in ("scenario", "scenario_digest", "split"):
        if first.summary[field] != second.summary[field]:
            raise ResultError(
                f"cannot compare: {field} is {first.summary[field]} in {first.folder}, "
                f"{second.summary[field]} in {second.folder}"
            )
