"""Freezing the validation and test episodes of a scenario in files."""

import hashlib
from pathlib import Path

import numpy as np

from uavbench.simulation.memory import episodes_at_once
from uavbench.simulation.simulator import Simulator
from uavbench.world.cities import city_count, draw_city_cells
from uavbench.world.episode import Columns, episode_keys, split_size
from uavbench.world.files import ARRAYS_BYTES, pack_arrays, write_together
from uavbench.world.resources import scenario_paths
from uavbench.world.scenario import Scenario, ScenarioError, SplitName

FROZEN_SPLITS: tuple[SplitName, ...] = ("validation", "test")


def draw(scenario: Scenario, split: SplitName) -> Columns:
    """Draw all episodes of ``split`` from their keys, whether or not they are frozen already."""
    size = split_size(scenario, split)
    slots = min(size, episodes_at_once(scenario))
    simulator = Simulator(scenario, slots)
    parts: list[Columns] = []
    for first in range(0, size, slots):
        numbers = np.arange(first, min(first + slots, size))
        simulator.sample(np.arange(len(numbers)), episode_keys(split, numbers))
        parts.append({name: column[: len(numbers)].copy() for name, column in simulator.columns().items()})
        needed = sum(column.nbytes for column in parts[0].values()) * size // len(parts[0]["key"])
        if needed > ARRAYS_BYTES:
            raise ScenarioError(
                f"{scenario.path}: splits.{split}.episodes: {size:,} episodes take {needed >> 20:,} MB, and a frozen file may "
                f"have {ARRAYS_BYTES >> 20:,} MB: choose fewer, or leave them unfrozen"
            )
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def draw_frozen_cities(scenario: Scenario) -> Columns | None:
    """Draw the validation and test cities from their keys, by split, shape (cities, M, N); None if no generator draws them."""
    source = scenario.cities
    if source is None or source.generator is None:
        return None
    keys = {split: episode_keys(split, np.arange(city_count(source, split))) for split in FROZEN_SPLITS}
    return {split: draw_city_cells(source, each) for split, each in keys.items()}


def freeze(scenario: Scenario, *, replace: bool = False) -> str:
    """Write the files ``episodes/<id>-<split>.npz`` beside the scenario's file, and ``cities/<id>.npz`` if it has a generator.

    If the scenario names a file of frozen cities already, for example that of another scenario in the same cities, it is kept.

    Parameters
    ----------
    scenario : Scenario
    replace : bool
        Draw the episodes again even if they are frozen: for a scenario of your own of which nobody has seen a result.

    Returns
    -------
    str
        The lines that name the files, for the end of the scenario's file.

    Raises
    ------
    ScenarioError
        When the episodes are frozen already, or when the files would be too large or cannot be written. Nothing is written
        then.
    """
    shipped = scenario.id in scenario_paths()
    for split in FROZEN_SPLITS:
        if getattr(scenario.splits, split).file is not None and (shipped or not replace):
            hint = "" if shipped else "; if nobody has seen a result yet: --replace"
            raise ScenarioError(
                f"{scenario.path}: splits.{split}.file: frozen already, and the episodes of an id never change: "
                f"for other episodes, choose a new id and remove the [splits] tables that name files{hint}"
            )
    lines: list[str] = []
    contents: dict[Path, bytes] = {}
    cities = draw_frozen_cities(scenario)
    if cities is not None and scenario.cities and scenario.cities.frozen is None:
        content, name = pack_arrays(cities, compress=True), f"cities/{scenario.id}.npz"
        contents[scenario.path.parent / name] = content
        lines += ["[cities.frozen]", f'file = "{name}"', f'sha256 = "{hashlib.sha256(content).hexdigest()}"', ""]
    for split in FROZEN_SPLITS:
        content = pack_arrays(draw(scenario, split))  # uncompressed: compressed bytes differ between machines
        name = f"episodes/{scenario.id}-{split}.npz"
        contents[scenario.path.parent / name] = content
        lines += [
            f"[splits.{split}]",
            f"episodes = {split_size(scenario, split)}",
            f'file = "{name}"',
            f'sha256 = "{hashlib.sha256(content).hexdigest()}"',
            "",
        ]
    try:
        write_together(contents)
    except OSError as error:
        raise ScenarioError(f"{error.filename}: cannot write it: {error.strerror}") from None
    return "\n".join(lines)
