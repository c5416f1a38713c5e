"""The keys that episodes are drawn from, and the three splits of episodes.

A split is a stream of keys: the two highest bits of a key name the split, the other bits are the episode's number. The
splits are therefore disjoint by construction. The validation and test episodes of the shipped scenarios are also frozen in
files, so that a change of a generator cannot change them.
"""

import hashlib
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.world.files import ARRAYS_BYTES, FileError, read_bounded, unpack_arrays
from uavbench.world.keyed import mix
from uavbench.world.scenario import SPLITS, Scenario, ScenarioError, Split, SplitName
from uavbench.world.values import as_integer, shown

#: Number of episodes of the train split.
TRAIN_EPISODES = 2**62

_SPLIT_BITS = {split: np.uint64(place << 62) for place, split in enumerate(SPLITS)}

#: Columns of a table with one row per episode: ``key``, ``start``, ``budget``, in teams ``uavs``, and the mission's own.
Columns = dict[str, NDArray[Any]]


def split_size(scenario: Scenario, split: SplitName) -> int:
    """Return the number of episodes of ``split``."""
    return TRAIN_EPISODES if split == "train" else _fixed(scenario, split).episodes


def check_split(split: object) -> SplitName:
    """Return ``split`` if it names a split; raise a ValueError otherwise."""
    for name in SPLITS:
        if isinstance(split, str) and split == name:
            return name
    raise ValueError(f"split: {shown(split)} is not one of {', '.join(SPLITS)}")


def check_number(scenario: Scenario, split: SplitName, number: object) -> int:
    """Return ``number`` as an int if ``split`` has an episode of this number; raise a ValueError otherwise."""
    size = split_size(scenario, split)
    read = as_integer(number)
    if read is None:
        raise ValueError(f"episode: {shown(number)} is not an integer")
    if not 0 <= read < size:
        raise ValueError(f"episode: {shown(number)} is out of range; {scenario.id} has {split} episodes 0 to {size - 1}")
    return read


def episode_keys(split: SplitName, numbers: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Return the keys of the episodes ``numbers`` of ``split``."""
    return _SPLIT_BITS[split] | numbers.astype(np.uint64)


def fresh_keys(secret: int, numbers: Sequence[int]) -> NDArray[np.uint64]:
    """Return keys of episodes that belong to no split. Nobody may know ``secret`` before the episodes are flown.

    The two highest bits have the value 3, which no split uses. The other bits come from SHA-256 of ``secret`` and the
    episode's number, so that no key can be computed from other keys.
    """
    digests = [hashlib.sha256(f"uavbench fresh {secret} {number}".encode()).digest() for number in numbers]
    return np.uint64(3 << 62) | np.array([int.from_bytes(digest[:8], "little") >> 2 for digest in digests], dtype=np.uint64)


def train_numbers(seed: int, first: int, count: int) -> NDArray[np.int64]:
    """Return the numbers of a learner's train episodes ``first`` to ``first + count − 1``; each seed has its own sequence.

    Raises
    ------
    ValueError
        When the seed is not from 0 to 2^24 − 1.
    """
    if not 0 <= seed < 2**24:
        raise ValueError(f"seed: {seed} is not from 0 to {2**24 - 1}")
    keys = np.uint64(seed << 40) + np.arange(first, first + count, dtype=np.uint64)
    return np.array([int(mix(key)) >> 2 for key in keys], dtype=np.int64)


def _fixed(scenario: Scenario, split: str) -> Split:
    return scenario.splits.test if split == "test" else scenario.splits.validation


def frozen_columns(scenario: Scenario, split: str) -> Columns | None:
    """Return the frozen episodes of ``split``; None if it has no file.

    Raises
    ------
    ScenarioError
        When the file is missing or damaged, or when its SHA-256 or its number of episodes is not the one in the scenario.
    """
    if split == "train":
        return None
    fixed = _fixed(scenario, split)
    if fixed.file is None or fixed.sha256 is None:
        return None
    return _read_frozen(scenario.path, split, scenario.path.parent / fixed.file, fixed.sha256, fixed.episodes)


@lru_cache(maxsize=32)
def _read_frozen(scenario: Path, split: str, path: Path, sha256: str, episodes: int) -> Columns:
    """Read a frozen file, and refuse a file that does not belong to this scenario."""
    try:
        content = read_bounded(path, ARRAYS_BYTES)
    except FileError as error:
        raise ScenarioError(f"{scenario}: splits.{split}.file: {error}") from None
    found = hashlib.sha256(content).hexdigest()
    if found != sha256:
        raise ScenarioError(f"{scenario}: splits.{split}.sha256: {path} has {found}: it is not the frozen file")
    try:
        columns: Columns = unpack_arrays(content)
    except ValueError as error:
        raise ScenarioError(f"{scenario}: splits.{split}.file: {path}: {error}") from None
    if any(len(np.atleast_1d(column)) != episodes for column in columns.values()):
        raise ScenarioError(f"{scenario}: splits.{split}.episodes: {path} does not hold {episodes} episodes")
    for column in columns.values():
        column.flags.writeable = False
    return columns
