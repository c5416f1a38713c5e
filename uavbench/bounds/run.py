"""Computing and saving upper bounds of a scenario's test episodes; after an interruption the finished bounds are kept."""

from collections.abc import Callable, Sequence
from pathlib import Path

from uavbench.bounds.episodes import bound_episodes, check_boundable
from uavbench.evaluation.crew import Crew
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
    workers: Crew = 1,
    on_start: Callable[[int], None] = lambda episodes: None,
    on_known: Callable[[Known], None] = lambda known: None,
) -> Reference:
    """Compute upper bounds of test episodes, take the best scores of results, and save both in ``out``/<scenario>.csv.

    It continues from that file, or from the scenario's own reference if there is no such file. Bounds that are proved optimal,
    or that were already allowed ``seconds``, are kept; the others are computed again, and the lower bound counts.

    Parameters
    ----------
    scenario : Scenario
        A scenario for one UAV.
    episodes : int, optional
        The bounds are those of episodes 0 to ``episodes`` − 1; None for all.
    results : sequence of Result
        Results of agents on the test split.
    out : Path
        The folder of the file.
    seconds : float
        Processor time that each bound may take.
    workers : int or Cluster
        The number of processes, or a cluster.
    on_start : callable
        Called once after all checks, with the number of episodes whose bounds are to be computed.
    on_known : callable
        Called after each bound with what is known about its episode.

    Raises
    ------
    ScenarioError, ResultError
        When the scenario has no bounds, has fewer than ``episodes`` test episodes, or a result or file cannot be used.
    ImportError
        When highspy is missing and a bound of CPP needs it.
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
    try:
        for bound in bound_episodes(scenario, numbers, known, results, seconds, workers):
            old = known.get(bound.episode, Known(bound.episode))
            known[bound.episode] = bounded(old, scenario, bound.value, bound.method, seconds)
            _save(path, scenario, known)
            on_known(known[bound.episode])
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; what is done is kept in {out}, and the same command goes on") from None
    return known


def _is_open(known: Known | None, seconds: float) -> bool:
    """Return whether the bound of an episode is to be computed."""
    return known is None or not (known.proved_optimal or known.seconds >= seconds)


def _save(path: Path, scenario: Scenario, known: Reference) -> None:
    """Save the reference; if that fails, raise a ResultError that names ``--out``."""
    try:
        save_reference(path, scenario, known)
    except OSError as error:
        raise ResultError(f"--out: cannot write to {path}: {error.strerror}") from None
