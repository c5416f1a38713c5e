"""Minari: an agent's flights as a dataset, from which others learn without flying themselves.

Needs ``pip install 'uavbench[dataset]'``. The flights are of the train split, so that nobody learns from the episodes that
scores are made of.
"""

# pyright: basic, reportMissingImports=false
import contextlib
import os
import re
import tempfile
import warnings
from collections.abc import Callable, Generator, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from uavbench.envs.env import UAVEnv
from uavbench.errors import UavbenchError
from uavbench.evaluation.evaluate import EpisodeRecord, Job, evaluate
from uavbench.world.files import check_writable, make_folder
from uavbench.world.resources import scenario_paths

_AT_ONCE = 20  # episodes in memory
_INFOS = ("action_mask", "cr", "landed", "blocked")
_PATTERN = re.compile(r"([\w-]+/)*[\w-]+-v\d+")


class DatasetError(UavbenchError, ValueError):
    """A dataset that cannot be written; the message says why."""


def write_dataset(
    job: Job,
    episodes: int,
    out: Path | None = None,
    *,
    name: str | None = None,
    workers: int = 1,
    on_start: Callable[[], None] = lambda: None,
    on_record: Callable[[EpisodeRecord], None] = lambda record: None,
) -> Path:
    """Let an agent fly episodes of the train split, and write them as a dataset of Minari.

    Parameters
    ----------
    job : Job
        The agent and the scenario, which is for one UAV; the split must be ``"train"``.
    episodes : int
        How many episodes: numbers 0 to ``episodes`` − 1.
    out : Path, optional
        Minari's folder of datasets; by default its own (``MINARI_DATASETS_PATH``, or ``~/.minari/datasets``).
    name : str, optional
        The dataset's id; by default ``uavbench/<scenario>/<agent>-v0``.
    workers : int
        Processes that fly.
    on_start : callable
        Called once, when all is checked and the first episode is about to be flown.
    on_record : callable
        Called with every record.

    Returns
    -------
    Path
        The dataset's folder. It is there as a whole, or nothing is.

    Raises
    ------
    DatasetError
        When the id is malformed or taken, the scenario is for teams, or Minari is not installed.
    AgentError
        When the agent fails.
    OSError
        When the dataset cannot be written.
    """
    scenario = job.scenario
    if scenario.team:
        raise DatasetError(f"{scenario.id} is for teams; Minari's datasets are of one agent")
    if job.split != "train":
        raise DatasetError(f"split: {job.split}: datasets are of the train split")
    identity = name or f"uavbench/{scenario.id.rpartition('-v')[0]}/{job.source.name}-v0"
    if not _PATTERN.fullmatch(identity):
        raise DatasetError(f"--name: {identity!r} is not of the form folder/name-v0, with letters, digits, '_' and '-'")
    minari = _minari()
    root = out or Path(os.environ.get("MINARI_DATASETS_PATH") or Path.home() / ".minari" / "datasets")
    place = root.absolute() / identity
    if place.exists():
        raise DatasetError(f"{place} exists already: choose another --name or --out, or remove it")
    check_writable(root)
    on_start()
    with tempfile.TemporaryDirectory(prefix=".uavbench-new-", dir=root) as staging, _datasets_in(Path(staging)):
        buffers = _buffers(minari, job, episodes, workers, on_record)
        made = None
        for some in _batches(buffers, _AT_ONCE):
            made = _create(minari, job, identity, some) if made is None else _extend(made, some)
        _publish(Path(staging), root, identity)
    return place


def _minari() -> Any:
    """Import Minari."""
    try:
        import h5py  # noqa: F401 - which Minari's storage needs, and says so only later
        import minari
    except ImportError as error:
        raise DatasetError(f"needs {error.name}, which is not installed: pip install 'uavbench[dataset]'") from None
    return minari


@contextlib.contextmanager
def _datasets_in(folder: Path) -> Generator[None]:
    """Let Minari write its datasets to a folder, within a block."""
    before = os.environ.get("MINARI_DATASETS_PATH")
    os.environ["MINARI_DATASETS_PATH"] = str(folder)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "`|.*(code_permalink|author|algorithm_name|description).*", UserWarning)
            yield
    finally:
        if before is None:
            del os.environ["MINARI_DATASETS_PATH"]
        else:
            os.environ["MINARI_DATASETS_PATH"] = before


def _buffers(minari: Any, job: Job, episodes: int, workers: int, on_record: Callable[[EpisodeRecord], None]) -> Iterator[Any]:
    """Fly the episodes with the agent, in the order of their numbers, and again in an environment, which observes."""
    env = UAVEnv(job.scenario)
    kept: dict[int, EpisodeRecord] = {}
    following = 0
    for record in evaluate(job, range(episodes), workers):
        on_record(record)
        kept[record.episode] = record
        while following in kept:
            yield _buffer(minari, env, kept.pop(following), following)
            following += 1


def _buffer(minari: Any, env: UAVEnv, record: EpisodeRecord, number: int) -> Any:
    """Fly a recorded episode again; return what Minari keeps of it."""
    options = {"split": "train", "episode": number}
    observation, info = env.reset(options=options)
    observations, infos, rewards, terminations = [observation], [info], [], []
    for action in record.actions[:, 0].tolist():
        observation, reward, terminated, _, info = env.step(action)
        observations.append(observation)
        infos.append(info)
        rewards.append(reward)
        terminations.append(terminated)
    return minari.data_collector.EpisodeBuffer(
        id=number,
        options=options,
        observations={key: np.stack([each[key] for each in observations]) for key in observation},
        actions=record.actions[:, 0].astype(np.int64),
        rewards=rewards,
        terminations=terminations,
        truncations=[False] * len(rewards),
        infos={key: np.stack([each[key] for each in infos]) for key in _INFOS},
    )


def _batches(buffers: Iterator[Any], size: int) -> Iterator[list[Any]]:
    """Cut what comes into lists of a size."""
    some: list[Any] = []
    for each in buffers:
        some.append(each)
        if len(some) == size:
            yield some
            some = []
    if some:
        yield some


def _create(minari: Any, job: Job, identity: str, buffers: list[Any]) -> Any:
    """Begin the dataset."""
    scenario, version = job.scenario, metadata.version("uavbench")
    shipped = scenario_paths().get(scenario.id) == scenario.path
    env = UAVEnv(scenario)
    return minari.create_dataset_from_buffers(
        identity,
        buffers,
        env=gym.spec(f"uavbench/{scenario.id}") if shipped else None,
        observation_space=env.observation_space,
        action_space=env.action_space,
        algorithm_name=job.source.name,
        description=f"{scenario.id} of uavbench {version}, train episodes from 0 on, flown by {job.source.name}. "
        f"Scenario digest {scenario.digest}, agent digest {job.source.digest(scenario)}.",
        requirements=[f"uavbench=={version}"],
        data_format="hdf5",
        jpeg_encoding=False,
    )


def _extend(made: Any, buffers: list[Any]) -> Any:
    """Add episodes to the dataset."""
    made.update_dataset_from_buffer(buffers)
    return made


def _publish(staging: Path, root: Path, identity: str) -> None:
    """Move the dataset to its place, and describe the folders above it as Minari does, where they are new."""
    for parent in list(Path(identity).parents)[-2::-1]:
        make_folder(root / parent)
        for about in (staging / parent).glob("*.json"):
            if not (root / parent / about.name).exists():
                about.replace(root / parent / about.name)
    (staging / identity).replace(root / identity)
