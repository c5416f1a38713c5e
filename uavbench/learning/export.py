"""Exporting a learned agent's network as an ONNX model, which can be evaluated without the agent's code."""

import importlib
import logging
import warnings
from pathlib import Path
from typing import Any

from uavbench.agents.agent import AgentSource
from uavbench.agents.weights import METADATA, training_facts
from uavbench.errors import UavbenchError
from uavbench.simulation.observation import Observer
from uavbench.world.files import write_atomic
from uavbench.world.scenario import Scenario


class ExportError(UavbenchError, ValueError):
    """A network cannot be exported; the message says why."""


def export(source: AgentSource, scenario: Scenario, path: Path) -> None:
    """Export an agent's attribute ``network``, a PyTorch module that takes observations, as an ONNX model.

    Parameters
    ----------
    source : AgentSource
        The agent.
    scenario : Scenario
        The scenario whose observations the model takes.
    path : Path
        The file to write, ``.onnx``.

    Raises
    ------
    ExportError
        When the agent has no network or is an ONNX model itself, ``path`` does not end in ``.onnx``, or a library is missing.
    """
    if path.suffix != ".onnx":
        raise ExportError(f"{path}: the name of an ONNX model ends in .onnx")
    if source.weights and source.weights.suffix == ".onnx":
        raise ExportError(f"{source.weights}: is an ONNX model already")
    try:
        torch: Any = importlib.import_module("torch")
        importlib.import_module("onnxscript")
    except ImportError as error:
        raise ExportError(f"{error.name} is missing: pip install 'uavbench[ddqn,onnx]'") from None
    network: Any = getattr(source.make(scenario), "network", None)
    if not isinstance(network, torch.nn.Module):
        raise ExportError(f"{source.name} has no network to export")
    names = list(Observer(scenario).empty(1))
    example = tuple(torch.zeros(2, *array.shape[1:]) for array in Observer(scenario).empty(1).values())

    class Positional(torch.nn.Module):
        """The network with the parts of the observation as positional arguments, which become the inputs of the ONNX model."""

        def __init__(self) -> None:
            super().__init__()  # pyright: ignore[reportUnknownMemberType]
            self.network = network

        def forward(self, *parts: Any) -> Any:
            return self.network(dict(zip(names, parts, strict=True)))

    batch = torch.export.Dim("batch")
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings(action="ignore"):  # they are about the exporter's own code
        program = torch.onnx.export(
            Positional().eval(),
            example,
            input_names=names,
            output_names=["values"],
            dynamic_shapes=(tuple({0: batch} for _ in names),),
            dynamo=True,
            verbose=False,
        )
    model = program.model_proto
    for name, value in training_facts(scenario).items():
        model.metadata_props.add(key=METADATA + name, value=str(value))
    write_atomic(path, model.SerializeToString())
