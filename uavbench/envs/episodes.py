"""The choice of the episode that a reset starts."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from uavbench.world.episode import check_number, check_split, split_size
from uavbench.world.scenario import SPLITS, Scenario, SplitName
from uavbench.world.values import shown

ORDERS = ("random", "cycle")


class Episodes:
    """The episodes that resets start if their options name none.

    Parameters
    ----------
    scenario : Scenario
    split : {"train", "validation", "test"}
        The split of resets whose options name none.
    order : {"random", "cycle"}
        ``"random"`` draws each episode, with replacement. ``"cycle"`` takes the episodes of the split in order,
        from number 0 on, and starts again after the last.

    Raises
    ------
    ValueError
        When there is no such split or order.
    """

    def __init__(self, scenario: Scenario, split: str, order: str) -> None:
        self._scenario, self._order = scenario, order
        self.split: SplitName = check_split(split)
        if order not in ORDERS:
            raise ValueError(f"order: {shown(order)} is not one of {', '.join(ORDERS)}")
        self.restart()

    def restart(self) -> None:
        """Start the cycles again: the next episode of every split is its first."""
        self._next = dict.fromkeys(SPLITS, 0)

    def choose(self, options: Mapping[str, Any], generator: np.random.Generator) -> tuple[SplitName, int]:
        """Return the split and the number of the next episode: from ``options`` if they name it, otherwise by the order.

        Every call draws exactly one number, so that the options of one reset do not change the episodes of later ones.
        """
        drawn = int(generator.bit_generator.random_raw()) >> 2
        split = check_split(options["split"]) if "split" in options else self.split
        if "episode" in options:
            return split, check_number(self._scenario, split, options["episode"])
        size = split_size(self._scenario, split)
        if self._order == "random":
            return split, drawn % size
        number = self._next[split]
        self._next[split] = (number + 1) % size
        return split, number


class Generators:
    """The random generators of the slots of a vector environment; one that nobody has seeded is seeded by the system."""

    def __init__(self, count: int) -> None:
        self._each: list[np.random.Generator | None] = [None] * count

    def __getitem__(self, i: int) -> np.random.Generator:
        generator = self._each[i]
        if generator is None:
            generator = self._each[i] = seeding.np_random()[0]
        return generator

    def seed(self, seed: int | Sequence[int | None] | None, slots: Sequence[int]) -> list[int | None]:
        """Seed the generators of ``slots`` by ``seed + i`` or ``seed[i]``; return the seed of every slot, None for none.

        Raises
        ------
        ValueError
            When there is not one seed for each slot. Nothing is changed then.
        """
        count = len(self._each)
        if seed is None:
            return [None] * count
        seeds: list[int | None] = [int(seed) + i for i in range(count)] if isinstance(seed, int | np.integer) else list(seed)
        if len(seeds) != count:
            raise ValueError(f"seed: {len(seeds)} seeds for {count} environments")
        for i in slots:
            own = seeds[i]
            if own is not None:
                self._each[i] = seeding.np_random(own)[0]
        return seeds
