"""An agent that decides by an ONNX model, whatever software trained it: ``--agent model.onnx``.

The model's inputs are float32, have the batch as first dimension, and are named like parts of the observation (``local``,
``global``, ``budget``; it need not use all of them). Its only output holds six values per observation, one for each action.
"""

import importlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.agents.onnx_file import has_external_data
from uavbench.agents.weights import WeightsError
from uavbench.errors import one_line
from uavbench.simulation.observation import Observation, Observer
from uavbench.world.city import NUM_ACTIONS
from uavbench.world.files import MODEL_BYTES, FileError, read_bounded
from uavbench.world.scenario import Scenario


class Agent:
    """Takes the action that an ONNX model values highest.

    Parameters
    ----------
    scenario : Scenario
    weights : Path
        The model.

    Raises
    ------
    ImportError
        When ONNX Runtime is missing.
    WeightsError
        When some of the model's weights are in other files.
    ValueError
        When the file cannot be read, is no ONNX model, or its inputs or output are not as described above.
    """

    track = "observation"

    def __init__(self, scenario: Scenario, weights: Path) -> None:
        self._session = _session(weights)
        shown = Observer(scenario).empty(1)
        self._inputs: list[str] = []
        self._file, single = weights, False
        for each in self._session.get_inputs():
            if each.name not in shown:
                raise ValueError(f"{weights}: input {each.name!r} is none of {', '.join(shown)}")
            wanted = list(shown[each.name].shape[1:])
            fits = len(each.shape) == len(wanted) + 1 and all(
                a == b or not isinstance(a, int) for a, b in zip(each.shape[1:], wanted, strict=True)
            )
            if each.type != "tensor(float)" or not fits:
                raise ValueError(f"{weights}: input {each.name} is {each.type} {each.shape}, expected float (batch, {wanted})")
            if isinstance(each.shape[0], int) and each.shape[0] != 1:
                raise ValueError(
                    f"{weights}: input {each.name}: its batch is {each.shape[0]}: export it with any batch size, or 1"
                )
            single = single or each.shape[0] == 1
            self._inputs.append(each.name)
        if len(self._session.get_outputs()) != 1:
            raise ValueError(
                f"{weights}: it has {len(self._session.get_outputs())} outputs, expected one: the values of actions"
            )
        self._size = 1 if single else None
        values = self._values({name: np.zeros((1, *shown[name].shape[1:]), np.float32) for name in shown})
        if values.shape != (1, NUM_ACTIONS):
            raise ValueError(f"{weights}: its output has shape {values.shape} for one observation, expected (1, {NUM_ACTIONS})")

    def act_batch(self, observations: Observation, infos: list[dict[str, Any]]) -> NDArray[np.int64]:
        """Return the actions with the highest values."""
        size = self._size or len(infos)
        parts = [
            self._values({name: array[k : k + size] for name, array in observations.items()})
            for k in range(0, len(infos), size)
        ]
        return np.concatenate(parts).argmax(axis=1)

    def _values(self, observation: Observation) -> NDArray[np.float32]:
        """Return the model's values."""
        values = self._session.run(None, {name: observation[name] for name in self._inputs})[0]
        if not np.isfinite(values).all():
            raise ValueError(f"{self._file}: its values are not finite")
        return values


def _session(model: Path) -> Any:
    """Return ONNX Runtime's session of a model."""
    try:
        runtime: Any = importlib.import_module("onnxruntime")
    except ImportError as error:
        raise ImportError(f"{model}: needs ONNX Runtime: pip install 'uavbench[onnx]'") from error
    try:
        content = read_bounded(model, MODEL_BYTES)
        external = has_external_data(content)
        # Made from the bytes that were checked: the file may have changed since.
        session = None if external else runtime.InferenceSession(content, providers=["CPUExecutionProvider"])
    except FileError as error:
        raise ValueError(str(error)) from None
    except Exception as error:  # ONNX Runtime raises exceptions of many classes of its own
        raise ValueError(f"{model}: not a model that ONNX Runtime takes: {one_line(error)}") from None
    if external:
        raise WeightsError(
            f"{model}: some of its weights are in other files, which its digest does not cover: "
            f"save it as one file: onnx.save(onnx.load({model.name!r}), 'whole.onnx')"
        )
    return session
