"""Weights of learned agents: safetensors files (arrays and a record of the training as JSON, no pickles)."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from uavbench.errors import UavbenchError, one_line
from uavbench.files import MODEL_BYTES, FileError, check_plain, write_whole
from uavbench.resources import scenario_paths, shipped_weights
from uavbench.scenario import Scenario, load_scenario

_RECORD = "uavbench"  # the key of the record among a file's metadata


class WeightsError(UavbenchError, ValueError):
    """Weights that cannot be used; the message names the file and the reason."""


def save_weights(path: Path, arrays: Mapping[str, NDArray[Any]], record: Mapping[str, Any]) -> None:
    """Write arrays and what is said of them, whole or not at all.

    Parameters
    ----------
    path : Path
        The file.
    arrays : mapping of str to ndarray
    record : mapping
        Whatever JSON can hold: how the arrays came about.
    """
    from safetensors.numpy import save

    packed = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    write_whole(path, save(packed, metadata={_RECORD: json.dumps(record)}))


def load_weights(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return arrays by name, and what is said of them.

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
    """Return what an open file says of its training: a table, in which names are text.

    Raises
    ------
    KeyError, ValueError, RecursionError
        When it says nothing, or it is no such table.
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
    """Return the arrays of weights that are to fly on a scenario.

    Raises
    ------
    WeightsError
        As `load_weights`, or when they were trained on another map or mission.
    """
    arrays, record = load_weights(path)
    check_trained(path, record.get("scenario"), scenario)
    return arrays


def trained_on(path: Path) -> str | None:
    """Return the id of the scenario that weights were trained on; None where that is not known."""
    try:
        from safetensors import SafetensorError, safe_open
    except ModuleNotFoundError:  # the extra is missing: who loads them says so, if they are to be loaded
        return None
    try:
        check_plain(path, MODEL_BYTES)
        opened: Any = safe_open(path, framework="numpy")
        with opened as file:
            return _read_record(file)["scenario"]
    except (KeyError, OSError, TypeError, ValueError, RecursionError, SafetensorError):  # what is read of them later says why
        return None


def check_trained(path: Path, trained: str | None, scenario: Scenario) -> None:
    """Refuse weights that were trained on another map or mission.

    Raises
    ------
    WeightsError
        Then.
    """
    if trained is not None and trained != scenario.id and trained in scenario_paths():
        other = load_scenario(trained)
        for what, one, two in (
            ("map", other.rows, scenario.rows),
            ("mission", other.mission.kind, scenario.mission.kind),
        ):
            if one != two:
                raise WeightsError(
                    f"{path}: trained on {trained}, another {what} than that of {scenario.id}: --scenario {trained}"
                )


def weights_path(agent: str, scenario: Scenario) -> Path:
    """Return the weights of a built-in agent that come with the suite.

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
