"""Validation during a training: the present network flies validation episodes, and a validation that is killed goes on.

The episodes are flown in parts of fixed size. The scores of each part are kept in a file beside the checkpoint until the
validation ends, so that a training that was killed meanwhile flies only the part again that was cut off.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.agents.agent import AgentSource
from uavbench.agents.weights import save_weights
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.evaluation.metrics import METRICS
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
    """

    source: AgentSource
    scenario: Scenario
    folder: Path
    label: str
    wanted: int = EPISODES

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
        latest = self.folder / f".{self.label}.latest.safetensors"
        save_weights(latest, arrays, record)
        kept = self.folder / f".{self.label}.validation.json"
        digest = hashlib.sha256(latest.read_bytes()).hexdigest()
        scores = _read(kept, digest)
        job = Job(replace(self.source, weights=latest), self.scenario, "validation")
        count = min(self.wanted, self.scenario.splits.validation.episodes)
        part = max(1, min(_PART, _PART_ACTIONS // self.scenario.budget[1]))
        try:
            for first in range(0, count, part):
                if len(scores) > first:
                    continue
                if stopped():
                    return None
                records = sorted(evaluate(job, range(first, min(first + part, count))), key=lambda each: each.episode)
                scores += [[float(getattr(each, name)) for name in METRICS] for each in records]
                write_atomic(kept, json.dumps({"weights": digest, "scores": scores}).encode())
        finally:
            latest.unlink(missing_ok=True)
        kept.unlink(missing_ok=True)
        return dict(zip(METRICS, np.mean(scores, axis=0).tolist(), strict=True))


def _read(path: Path, digest: str) -> list[list[float]]:
    """Return the scores of the episodes that these weights have flown; none if the file is of others or damaged."""
    try:
        found = json.loads(read_bounded(path, _SCORES_BYTES))
        return found["scores"] if found["weights"] == digest else []
    except (FileError, OSError, ValueError, KeyError, TypeError):
        return []
