"""Surveillance: see every site, again and again. Some steps after a site was seen, seeing it is rewarded again."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import field_validator

from uavbench.simulation.missions import Mission
from uavbench.world.city import city_of
from uavbench.world.kernel import kernel
from uavbench.world.keyed import CONTENT, next_integer, stream
from uavbench.world.parameters import Count, MissionParameters, Words, ordered


class Surveillance(MissionParameters):
    """The parameters.

    Attributes
    ----------
    sites : (int, int)
        Least and largest number of sites.
    reach : int
        A UAV sees the sites that are at most this many rows and columns away.
    cooldown : int
        Number of steps until a site that was seen pays again.
    """

    kind: Literal["surveillance"]
    sites: tuple[Count, Count]
    reach: Count
    cooldown: Count

    words: ClassVar[Words] = Words(target="site that pays", done="site that was seen")
    counted: ClassVar[str] = "sites"
    largest_target: ClassVar[float] = 1.0
    exact: ClassVar[bool] = True

    _ranges = field_validator("sites")(ordered)

    @property
    def layers(self):
        return {"wait": self.cooldown}

    @property
    def targets(self):
        return f"{self.sites[0]}–{self.sites[1]} sites"

    def check_map(self, rows):
        places = sum(row.count(".") + row.count("N") for row in rows)
        if places < self.sites[1]:
            raise ValueError(f"mission.sites: up to {self.sites[1]} sites, and the map has {places} cells for them")

    def make(self, scenario, num_envs):
        return SurveillanceMission(scenario, num_envs)


class SurveillanceMission(Mission):
    """The mission. It has two arrays of its own, both of shape (B, M, N): ``wait`` is −1 where there is no site, otherwise the
    number of steps until the site pays again; ``seen`` says which sites have been seen at least once.
    """

    option = "sites"

    def __init__(self, scenario, num_envs):
        city = city_of(scenario)
        self._parameters = scenario.mission
        self._reward = scenario.rewards.collect
        self._free = ~(city.building | city.landing)
        self._places = np.argwhere(self._free)
        self.wait = np.full((num_envs, *city.shape), -1, dtype=np.int32)
        self.seen = np.zeros((num_envs, *city.shape), dtype=np.bool_)

    def sample(self, state, index):
        sites = np.zeros((len(index), *self._free.shape), dtype=np.bool_)
        _draw(state.key[index], self._places, *self._parameters.sites, sites)
        self._begin(state, index, sites)

    def columns(self, state, index):
        return {"sites": np.packbits(self.wait[index].reshape(len(index), -1) >= 0, axis=1)}

    def restore(self, state, index, columns):
        self._begin(state, index, self._unpacked(columns))

    def fits(self, columns, city):
        if "sites" not in columns or columns["sites"].shape[1:] != ((self._free.size + 7) // 8,):
            return False
        sites = self._unpacked(columns)
        number = sites.sum(axis=(1, 2))
        low, high = self._parameters.sites
        return not (sites & ~self._free).any() and low <= number.min() and number.max() <= high

    def parse(self, value, city):
        sites = np.asarray(value)
        if sites.shape != self._free.shape or sites.dtype != np.bool_:
            raise ValueError(f"sites: {sites.dtype} of shape {sites.shape}, expected a mask, bool {self._free.shape}")
        if not sites.any() or (sites & ~self._free).any():
            raise ValueError("sites: at least one, none in a building or a landing zone")
        return {"sites": np.packbits(sites.reshape(1, -1), axis=1)}

    def collect(self, state, uav):
        _collect(
            uav,
            state.position,
            state.done,
            state.target,
            state.remaining,
            state.reward,
            state.layers,
            self.wait,
            self.seen,
            self._parameters.reach,
            self._parameters.cooldown,
            self._reward,
        )

    def arrays(self):
        return {"wait": self.wait, "seen": self.seen}

    def view(self, i):
        return {"wait": self.wait[i]}

    def _unpacked(self, columns):
        bits = np.unpackbits(columns["sites"].astype(np.uint8), axis=1, count=self._free.size)
        return bits.reshape(-1, *self._free.shape).astype(np.bool_)

    def _begin(self, state, index, sites):
        self.wait[index] = np.where(sites, 0, -1)
        self.seen[index] = False
        state.target[index] = sites
        state.layers[index] = 0.0
        state.total[index] = state.remaining[index] = sites.sum(axis=(1, 2))


@kernel
def _draw(keys, places, fewest, most, sites):
    """Draw the sites of each key, at most one per cell."""
    cursor = np.empty(1, dtype=np.uint64)
    for n in range(len(keys)):
        cursor[0] = stream(keys[n], CONTENT)
        left = fewest + next_integer(cursor, most - fewest + 1)
        while left > 0:
            r, c = places[next_integer(cursor, len(places))]
            left -= not sites[n, r, c]
            sites[n, r, c] = True


@kernel
def _collect(uav, position, done, target, remaining, reward, layers, wait, seen, reach, cooldown, value):
    """Let UAV ``uav`` of each slot see sites, if it still flies; for the first UAV, first let the step pass at all sites."""
    rows, cols = target.shape[1:]
    for i in range(len(done)):
        if uav == 0:
            for r in range(rows):
                for c in range(cols):
                    if wait[i, r, c] > 0:
                        wait[i, r, c] -= 1
                        layers[i, 0, r, c] -= 1.0
                        if wait[i, r, c] == 0:
                            target[i, r, c] = 1.0
        if done[i, uav]:
            continue
        y, x = position[i, uav]
        for r in range(max(0, y - reach), min(rows, y + reach + 1)):
            for c in range(max(0, x - reach), min(cols, x + reach + 1)):
                if wait[i, r, c] == 0:
                    wait[i, r, c] = layers[i, 0, r, c] = cooldown
                    target[i, r, c] = 0.0
                    remaining[i] -= not seen[i, r, c]
                    seen[i, r, c] = True
                    reward[i, uav] += value
