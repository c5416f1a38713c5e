"""Validation during a training: the present network flies validation episodes, and a validation that is killed goes on.

The episodes are flown in parts of fixed size. The scores of each part are kept in a file beside the checkpoint until the
validation ends, so that a training that was killed meanwhile flies only the part again that was cut off.
"""

import hashlib
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.agents.agent import AgentSource
from uavbench.agents.weights import save_weights
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.evaluation.metrics import METRICS
from uavbench.learning.group import ALONE, Group
from uavbench.world.files import FileError, read_bounded, write_atomic
from uavbench.world.scenario import Scenario

#: How many episodes are flown, if there are as many and nothing else is asked for.
EPISODES = 200
#: A part has as many episodes, or fewer where episodes are long: so many actions in all.
_PART, _PART_ACTIONS = 50, 20_000
_SCORES_BYTES = 2**20


@dataclass(frozen=True)
class Validation:
    """Where and with what a training validates.

    Attributes
    ----------
    source : AgentSource
        The agent that flies with the weights.
    scenario : Scenario
    folder : Path
        The folder of the training.
    label : str
        The stem of the names of the training's files.
    wanted : int, optional
        How many episodes are flown if there are as many; by default 200.
    group : Group, optional
        The processes that share the work; by default this one alone.
    """

    source: AgentSource
    scenario: Scenario
    folder: Path
    label: str
    wanted: int = EPISODES
    group: Group = ALONE

    def scores(
        self, arrays: Mapping[str, NDArray[Any]], record: Mapping[str, Any], stopped: Callable[[], bool] = lambda: False
    ) -> dict[str, float] | None:
        """Evaluate weights in the same way as weights on disk are evaluated.

        Parameters
        ----------
        arrays, record : mapping
            The weights, and what is said of their training.
        stopped : callable
            Asked before each part; if it returns True, what was flown is kept for the next call.

        Returns
        -------
        dict of str to float, or None
            The mean of each metric, in [0, 1]; None if it was stopped.
        """
        kept = self.folder / f".{self.label}.validation.json"
        digest = _digest(arrays)
        scores = _read(kept, digest)
        count = min(self.wanted, self.scenario.splits.validation.episodes)
        part = max(1, min(_PART, _PART_ACTIONS // self.scenario.budget[1]))
        parts = [range(first, min(first + part, count)) for first in range(len(scores), count, part)]
        for first in range(0, len(parts), self.group.size):
            if stopped():
                return None
            batch = parts[first : first + self.group.size]
            self.group.told(("fly", arrays, record, batch))
            scores += self.fly(arrays, record, batch)
            write_atomic(kept, json.dumps({"weights": digest, "scores": scores}).encode())
        kept.unlink(missing_ok=True)
        return dict(zip(METRICS, np.mean(scores, axis=0).tolist(), strict=True))

    def fly(
        self, arrays: Mapping[str, NDArray[Any]], record: Mapping[str, Any], parts: Sequence[Sequence[int]]
    ) -> list[list[float]]:
        """Fly one part in each process of the group.

        Parameters
        ----------
        arrays, record : mapping
            The weights, and what is said of their training.
        parts : sequence of sequence of int
            The episodes of each process; at most as many as there are processes.

        Returns
        -------
        list of list of float
            The metrics of all episodes, in the order of ``parts``, for the process that leads; an empty list for the others.
        """
        own = parts[self.group.rank] if self.group.rank < len(parts) else ()
        with tempfile.TemporaryDirectory() as folder:
            weights = Path(folder) / f"{self.label}.safetensors"
            save_weights(weights, arrays, record)
            job = Job(replace(self.source, weights=weights), self.scenario, "validation")
            records = sorted(evaluate(job, own), key=lambda each: each.episode) if own else []
        flown = self.group.gathered([[float(getattr(each, name)) for name in METRICS] for each in records])
        return [each for part in flown for each in part]


def _digest(arrays: Mapping[str, NDArray[Any]]) -> str:
    """Return a digest of weights."""
    found = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        found.update(f"{name} {array.dtype.str} {array.shape}".encode())
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def _read(path: Path, digest: str) -> list[list[float]]:
    """Return the scores of the episodes that these weights have flown; none if the file is of others or damaged."""
    try:
        found = json.loads(read_bounded(path, _SCORES_BYTES))
        return found["scores"] if found["weights"] == digest else []
    except (FileError, OSError, ValueError, KeyError, TypeError):
        return []
