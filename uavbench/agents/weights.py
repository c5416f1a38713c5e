"""Weights of learned agents: safetensors files with arrays and a JSON record of the training, without pickles."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from uavbench.agents.onnx_file import OnnxFileError, metadata
from uavbench.errors import UavbenchError, one_line
from uavbench.world.files import MODEL_BYTES, FileError, check_plain, read_bounded, write_atomic
from uavbench.world.resources import scenario_paths, shipped_weights
from uavbench.world.scenario import Scenario, load_scenario

_RECORD = "uavbench"  # the key of the record in a file's metadata
#: The prefix of those metadata names of an ONNX model that describe its training.
METADATA = "uavbench."
_MAP = "map_sha256"


class WeightsError(UavbenchError, ValueError):
    """Weights that cannot be used; the message names the file and the reason."""


def save_weights(path: Path, arrays: Mapping[str, NDArray[Any]], record: Mapping[str, Any]) -> None:
    """Write arrays and a record of their training, completely or not at all.

    Parameters
    ----------
    path : Path
        The file.
    arrays : mapping of str to ndarray
    record : mapping
        How the arrays were made; anything that JSON can hold.
    """
    from safetensors.numpy import save

    packed = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    write_atomic(path, save(packed, metadata={_RECORD: json.dumps(record)}))


def load_weights(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return the arrays of a file by name, and the record of their training.

    Raises
    ------
    WeightsError
        When the file is missing, damaged, or not one that `save_weights` wrote.
    """
    from safetensors import SafetensorError, safe_open

    try:
        check_plain(path, MODEL_BYTES)
        opened: Any = safe_open(path, framework="numpy")
        with opened as file:
            record = _read_record(file)
            return {name: file.get_tensor(name) for name in file.keys()}, record  # noqa: SIM118
    except FileError as error:
        raise WeightsError(str(error)) from None
    except KeyError:
        raise WeightsError(f"{path}: not weights that uavbench train wrote: it has no record of a training") from None
    except (OSError, ValueError, TypeError, AttributeError, RecursionError, SafetensorError) as error:
        raise WeightsError(f"{path}: damaged: {one_line(error)}") from None


def _read_record(file: Any) -> dict[str, Any]:
    """Return the training record of an open file, in which ``agent`` and ``scenario`` are strings if they are there.

    Raises
    ------
    KeyError, ValueError, RecursionError
        When there is no record, or it is not of this form.
    """
    about: dict[str, str] = file.metadata() or {}
    record: Any = json.loads(about[_RECORD])
    if not isinstance(record, dict):
        raise ValueError("its record is no table")
    for name in ("agent", "scenario"):
        if not isinstance(record.get(name, ""), str):  # pyright: ignore[reportUnknownMemberType]
            raise ValueError(f"its record's {name} is no text")
    return cast("dict[str, Any]", record)


def weights_for(path: Path, scenario: Scenario) -> dict[str, NDArray[Any]]:
    """Return the arrays of weights that an agent uses on a scenario.

    Raises
    ------
    WeightsError
        As `load_weights`, or when they were trained for another mission or other observations. The map is not checked here:
        `AgentSource.make` does that, because the user may allow another map by ``--transfer``.
    """
    arrays, record = load_weights(path)
    check_trained(path, record, scenario, transfer=True)
    return arrays


def training_facts(scenario: Scenario) -> dict[str, Any]:
    """Return what a training record says about the scenario: its id, and what decides where the weights may be used."""
    from uavbench.simulation.observation import LAYERS, TEAM_LAYERS  # here: it loads kernels, and finding an agent needs none

    return {
        "scenario": scenario.id,
        **({} if scenario.id in scenario_paths() else {"scenario_file": str(scenario.path)}),
        "mission": scenario.mission.kind,
        "layers": len(TEAM_LAYERS if scenario.team else LAYERS) + len(scenario.mission.layers),
        **scenario.observation.model_dump(),
        _MAP: scenario.map_digest,
    }


def training_record(path: Path) -> dict[str, Any]:
    """Return the training record of weights or of an ONNX model; empty if there is none, or the file cannot be read.

    Loading the file later reports why it cannot be read.
    """
    if path.suffix == ".onnx":
        try:
            found = metadata(read_bounded(path, MODEL_BYTES))
        except (OSError, OnnxFileError):
            return {}
        return {name.removeprefix(METADATA): value for name, value in found.items() if name.startswith(METADATA)}
    try:
        from safetensors import SafetensorError, safe_open
    except ModuleNotFoundError:
        return {}
    try:
        check_plain(path, MODEL_BYTES)
        opened: Any = safe_open(path, framework="numpy")
        with opened as file:
            return _read_record(file)
    except (KeyError, OSError, TypeError, ValueError, RecursionError, SafetensorError):
        return {}


def check_trained(path: Path, record: Mapping[str, Any], scenario: Scenario, transfer: bool = False) -> None:
    """Refuse weights that were trained for another mission, other observations, or another map.

    Parameters
    ----------
    path : Path
        Their file.
    record : mapping
        The record of their training. What is missing in it is not checked: arrays may come from anywhere.
    scenario : Scenario
        Where they are to be used.
    transfer : bool
        Allow another map.

    Raises
    ------
    WeightsError
        When they are refused.
    """
    trained = record.get("scenario")
    for name, found, here in _differences(record, scenario):
        if name == "mission":
            reason = f"another mission than that of {scenario.id}"
        elif name != _MAP:
            reason = f"whose observations have {name} {found}, not {here} as those of {scenario.id}"
        elif not transfer:
            reason = f"another map than that of {scenario.id}; to use them here all the same: --transfer"
        else:
            continue
        raise WeightsError(f"{path}: trained on {trained}, {reason}")


def is_transfer(record: Mapping[str, Any], scenario: Scenario) -> bool:
    """Return whether weights with this record were trained on another map than that of ``scenario``."""
    return any(name == _MAP for name, _, _ in _differences(record, scenario))


def _differences(record: Mapping[str, Any], scenario: Scenario) -> list[tuple[str, str, str]]:
    """Return the facts in which a record and a scenario differ: the name, the record's value, and the scenario's value."""
    known, trained = dict(record), record.get("scenario")
    if _MAP not in record and trained in list(scenario_paths()):  # an old record, with the id alone
        known.update(training_facts(load_scenario(str(trained))))
    facts = {name: value for name, value in training_facts(scenario).items() if name not in ("scenario", "scenario_file")}
    return [(name, str(known[name]), str(here)) for name, here in facts.items() if str(known.get(name, here)) != str(here)]


def weights_path(agent: str, scenario: Scenario) -> Path:
    """Return the path of the weights that the suite includes for a built-in agent.

    Raises
    ------
    WeightsError
        When there are none for the scenario.
    """
    paths = shipped_weights(agent)
    if scenario.id not in paths:
        raise WeightsError(
            f"{agent} has no weights for {scenario.id}, only for {', '.join(paths) or 'no scenario'}: "
            f"uavbench train {agent} --scenario {scenario.id} makes some; then --agent FILE.safetensors"
        )
    return paths[scenario.id]
