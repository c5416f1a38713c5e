"""Bounding a scenario's test episodes from beginning to end; what is done is kept whenever it is interrupted."""

from collections.abc import Callable, Sequence
from pathlib import Path

from uavbench.bounds.episodes import bound_episodes, check_boundable
from uavbench.evaluation.reference import (
    SPLIT,
    Known,
    Reference,
    bounded,
    improved,
    load_reference,
    reference_path,
    save_reference,
)
from uavbench.evaluation.results import Result, ResultError
from uavbench.world.episode import split_size
from uavbench.world.scenario import Scenario


def run_bounds(
    scenario: Scenario,
    episodes: int | None,
    results: Sequence[Result],
    out: Path,
    *,
    seconds: float,
    workers: int = 1,
    on_start: Callable[[int], None] = lambda episodes: None,
    on_known: Callable[[Known], None] = lambda known: None,
) -> Reference:
    """Bound test episodes, take the best scores of results, and keep both in ``out``/<scenario>.csv.

    Goes on from that file, or from the scenario's own reference: bounds that are proved optimal, or were allowed ``seconds``
    already, are kept, and of others the lower one counts.

    Parameters
    ----------
    scenario : Scenario
        Of one UAV.
    episodes : int, optional
        Bound episodes 0 to ``episodes`` − 1; None for all.
    results : sequence of Result
        Of agents on the test split.
    out : Path
        A folder.
    seconds : float
        Processor time that each bound may take.
    workers : int
        Processes.
    on_start : callable
        Called once, when all is checked, with the number of episodes to bound.
    on_known : callable
        Called with what is known of each episode as it is bounded.

    Raises
    ------
    ScenarioError, ResultError
        When the scenario has no bounds, ``episodes`` is more than it has, a result or file cannot be used.
    ImportError
        When highspy is missing.
    """
    check_boundable(scenario)
    size = split_size(scenario, SPLIT)
    if episodes is not None and episodes > size:
        raise ResultError(f"--episodes: {episodes}, but {scenario.id} has {size} {SPLIT} episodes")
    path = out / f"{scenario.id}.csv"
    known = load_reference(path, scenario) or load_reference(reference_path(scenario), scenario)
    known = improved(known, scenario, results)
    _save(path, scenario, known)
    numbers = [number for number in range(size if episodes is None else episodes) if _is_open(known.get(number), seconds)]
    on_start(len(numbers))
    for bound in bound_episodes(scenario, numbers, known, results, seconds, workers):
        old = known.get(bound.episode, Known(bound.episode))
        known[bound.episode] = bounded(old, scenario, bound.value, bound.method, seconds)
        _save(path, scenario, known)
        on_known(known[bound.episode])
    return known


def _is_open(known: Known | None, seconds: float) -> bool:
    """Say whether an episode is to be bounded."""
    return known is None or not (known.proved_optimal or known.seconds >= seconds)


def _save(path: Path, scenario: Scenario, known: Reference) -> None:
    """Save, or say what is wrong with ``--out``."""
    try:
        save_reference(path, scenario, known)
    except OSError as error:
        raise ResultError(f"--out: cannot write to {path}: {error.strerror}") from None
