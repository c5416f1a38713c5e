"""The form of observations: as the paper has them, or in a quarter of the memory, and with a budget from 0 to 1.

A compact observation holds the same information to the last bit, so that `Form.expand` gives the usual one back. Layers that
are 0 or 1 are uint8, and in the global map they are the sums of the g×g blocks instead of their means. The target map of data
harvesting has real numbers, but only few of them are not 0: it becomes a list.
"""

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from uavbench.simulation.observation import LAYERS, Observation, Observer
from uavbench.world.scenario import Scenario

Arrays = dict[str, NDArray[Any]]


class Form:
    """Turns batches of observations of a scenario into the form that an environment was asked for.

    Parameters
    ----------
    scenario : Scenario
        For one UAV, and with a mission without layers of its own, if ``compact``.
    compact : bool
        Whether observations are compact: ``local`` (n, l, l) and ``global`` (n, h, w) of unsigned integers, without the target
        layer in data harvesting; there ``local_target`` and ``global_target`` (K, 3), float32, list row, column and value of
        what is not 0 in it, for up to K devices, and zeros below. ``budget`` stays.
    normalize : bool
        Whether ``budget`` is divided by the scenario's largest.

    Raises
    ------
    ValueError
        When there is no compact form of the scenario's observations.
    """

    def __init__(self, scenario: Scenario, compact: bool = False, normalize: bool = False) -> None:
        observer, mission = Observer(scenario), scenario.mission
        if compact and (scenario.team or observer.layers != LAYERS or mission.pooling == "map"):
            raise ValueError(f"compact: observations of {scenario.id} have no compact form: use compact=False")
        self.compact, self.plain = compact, not compact and not normalize
        self.shapes = {"local": observer.local_shape, "global": observer.global_shape}
        self._area = scenario.observation.global_scale**2
        self._list = mission.max_targets if mission.pooling == "spots" else 0
        self._kind: Any = np.uint8 if self._area < 256 else np.uint16
        self._largest, self._target = scenario.budget[1], mission.largest_target
        self._scale = np.float32(self._largest if normalize else 1)

    def space(self, plain: spaces.Dict) -> spaces.Dict:
        """Return the space of one observation in this form; ``plain`` is that of the usual form."""
        found: dict[str, spaces.Space[Any]] = dict(plain.spaces)
        found["budget"] = spaces.Box(0.0, float(self._largest / self._scale), (1,), np.float32)
        if not self.compact:
            return spaces.Dict(found)
        for name, (layers, high, wide) in self.shapes.items():
            if name not in found:
                continue
            most = 1 if name == "local" else self._area
            shape = (layers - bool(self._list), high, wide)
            found[name] = spaces.Box(0, most, shape, self._kind)
            if self._list:
                limit = np.tile(np.array([high, wide, self._target], np.float32), (self._list, 1))
                found[f"{name}_target"] = spaces.Box(np.zeros_like(limit), limit, dtype=np.float32)
        return spaces.Dict(found)

    def apply(self, batch: Observation) -> Arrays:
        """Return B observations in this form."""
        found: Arrays = dict(batch)
        if self._scale != 1:
            found["budget"] = batch["budget"] / self._scale
        if not self.compact:
            return found
        for name, layers in {name: batch[name] for name in self.shapes if name in batch}.items():
            factor = np.float32(1 if name == "local" else self._area)
            kept = layers[:, : layers.shape[1] - bool(self._list)]
            found[name] = np.rint(kept * factor).astype(self._kind)
            if self._list:
                found[f"{name}_target"] = _listed(layers[:, -1], self._list)
        return found

    def expand(self, formed: Arrays) -> Observation:
        """Return B observations in the usual form, bit for bit, of `apply`'s; a normalised budget stays as it is."""
        found: Observation = {name: formed[name] for name in ("local", "global", "budget") if name in formed}
        if not self.compact:
            return found
        for name, shape in self.shapes.items():
            if name not in formed:
                continue
            given = formed[name]
            layers = np.zeros((len(given), *shape), dtype=np.float32)
            layers[:, : given.shape[1]] = given
            if name == "global":
                layers /= np.float32(self._area)
            if self._list:
                rows = formed[f"{name}_target"]
                i, k = np.nonzero(rows[..., 2])
                r, c = rows[i, k, :2].astype(np.int64).T
                layers[i, -1, r, c] = rows[i, k, 2]
            found[name] = layers
        return found


def _listed(target: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """Return what is not 0 in maps (B, h, w), as rows (B, count, 3) of row, column and value."""
    found = np.zeros((len(target), count, 3), dtype=np.float32)
    i, r, c = np.nonzero(target)  # in the order of i
    place = np.arange(len(i)) - np.searchsorted(i, i)
    found[i, place, 0], found[i, place, 1], found[i, place, 2] = r, c, target[i, r, c]
    return found
