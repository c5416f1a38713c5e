"""Evaluating an agent on a scenario with one call, and comparing two results."""

import shutil
import tempfile
import weakref
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, Unpack

from uavbench.agents.agent import AgentSource, find_agent
from uavbench.agents.in_memory import ObjectSource
from uavbench.evaluation.evaluate import EpisodeRecord, Job
from uavbench.evaluation.metrics import Comparison
from uavbench.evaluation.replay import compare_results
from uavbench.evaluation.results import Result, ResultError, load_result
from uavbench.evaluation.run import TRAIN_EPISODES, run
from uavbench.world.episode import check_split, split_size
from uavbench.world.scenario import Scenario, load_scenario
from uavbench.world.values import as_integer, shown


class Options(TypedDict, total=False):
    """The keyword arguments of `evaluate` that are seldom needed."""

    name: str | None
    weights: str | Path | None
    decision_timeout: float | None
    overwrite: bool
    on_record: Callable[[EpisodeRecord], None]


def evaluate(
    agent: Any,
    scenario: str | Path | Scenario,
    *,
    split: str = "test",
    episodes: int | None = None,
    workers: int = 0,
    out: str | Path | None = None,
    **options: Unpack[Options],
) -> Result:
    """Let an agent fly a scenario's episodes, and return its score.

    Parameters
    ----------
    agent : object, class, str or Path
        An agent, or a class that makes one from a scenario; or, as in ``uavbench evaluate --agent``, the name of a built-in
        agent (``"greedy"``), or the path of a Python file, an ONNX model or weights.
    scenario : str, Path or Scenario
        An id, the path of a TOML file, or a loaded scenario.
    split : {"train", "validation", "test"}
        The split whose episodes are flown.
    episodes : int, optional
        How many episodes are flown: those with the numbers 0 to ``episodes`` − 1. By default all, but 1,000 of the train split.
    workers : int
        Number of processes in which the agent flies. With 0 it flies in this process. To fly in others, an object in memory
        must be picklable.
    out : str or Path, optional
        Where the result is written: ``out/<scenario>/<agent>``. By default to a temporary folder, which is removed
        when the result is no longer used.
    name : str, optional
        The agent's name in the result; by default the name of its file or class.
    weights : str or Path, optional
        The file of the weights, for an agent from a Python file.
    decision_timeout : float, optional
        Seconds that one decision may take, 60 by default; None for no limit.
    overwrite : bool
        Whether a finished result in ``out`` of another agent or another job may be replaced.
    on_record : callable
        Called with the `EpisodeRecord` of every episode when it ends, to show progress.

    Returns
    -------
    Result
        With ``metrics``, ``episodes()`` and ``actions()``.

    Raises
    ------
    UavbenchError
        When the scenario, the agent, the split or an episode does not exist, the agent fails, or the result cannot be
        written.

    Examples
    --------
    >>> import uavbench
    >>> result = uavbench.evaluate("random", "Block8-CPP-v0", episodes=20)
    >>> 0.0 <= result.metrics["cral"].mean <= 1.0
    True
    >>> class Hover:
    ...     def act(self, observation, info):
    ...         return 4
    >>> uavbench.evaluate(Hover(), "Block8-CPP-v0", episodes=5).metrics["landed"].mean
    0.0
    """
    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    try:
        checked = check_split(split)
    except ValueError as error:
        raise ResultError(str(error)) from None
    size = split_size(loaded, checked)
    count = min(size, TRAIN_EPISODES) if episodes is None else as_integer(episodes)
    if count is None or not 1 <= count <= size:
        known = f"an integer from 1 to {size}, the {split} episodes of {loaded.id}"
        raise ResultError(f"episodes: {shown(episodes)} is not {known}")
    source = _source(agent, options.get("weights"), options.get("name"))
    job = Job(source, loaded, checked, options.get("decision_timeout", 60.0))
    where = Path(tempfile.mkdtemp(prefix="uavbench-result-")) if out is None else Path(out)
    try:
        result = run(
            job,
            count,
            where,
            workers=workers,
            overwrite=options.get("overwrite", False),
            on_record=options.get("on_record", lambda record: None),
        )
    except BaseException:
        if out is None:
            shutil.rmtree(where, ignore_errors=True)
        raise
    result = replace(result, given_scenario=loaded)
    if out is None:
        weakref.finalize(result, shutil.rmtree, where, ignore_errors=True)
    return result


def _source(agent: Any, weights: str | Path | None, name: str | None) -> AgentSource:
    """Return the source of an agent."""
    if isinstance(agent, str | Path):
        return find_agent(str(agent), None if weights is None else Path(weights), name)
    return agent if isinstance(agent, AgentSource) else ObjectSource.of(agent, name)


def compare(first: Result | str | Path, second: Result | str | Path) -> dict[str, Comparison]:
    """Compare two results on the episodes that both flew.

    Parameters
    ----------
    first, second : Result, str or Path
        Results of the same scenario and split, or their folders.

    Returns
    -------
    dict of str to Comparison
        By the metric's name (``landed``, ``cr``, ``cral``): ``difference``, the mean of first minus second, and
        ``improvement``, the probability that the first is better; each with its confidence interval.

    Raises
    ------
    ResultError
        When they are not of the same scenario and split.

    Examples
    --------
    >>> import uavbench
    >>> greedy = uavbench.evaluate("greedy", "Block8-CPP-v0", episodes=20)
    >>> random = uavbench.evaluate("random", "Block8-CPP-v0", episodes=20)
    >>> uavbench.compare(greedy, random)["cral"].difference.mean > 0
    True
    """
    results = [each if isinstance(each, Result) else load_result(Path(each)) for each in (first, second)]
    return compare_results(*results)[0]
