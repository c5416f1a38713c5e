"""Converting PyTorch networks and optimisers to named arrays and back, for a learner's checkpoints without pickles."""

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.agents.weights import WeightsError
from uavbench.world.scenario import Scenario

Arrays = dict[str, NDArray[Any]]


def moved(network: Any) -> Any:
    """Return a network after it was moved to PyTorch's default device.

    Make it ``with torch.device("cpu")``, and it begins with the same weights on every device.
    """
    torch: Any = importlib.import_module("torch")
    return network.to(torch.get_default_device())


def tensor(array: NDArray[Any]) -> Any:
    """Return an array as a tensor on PyTorch's default device; on the processor they share memory."""
    torch: Any = importlib.import_module("torch")
    return torch.from_numpy(array).to(torch.get_default_device())


def tensors(observation: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Return an observation's arrays as `tensor`; maps get the memory format that suits convolutions, channels last."""
    torch: Any = importlib.import_module("torch")
    found = {name: tensor(values) for name, values in observation.items()}
    return {
        name: values.contiguous(memory_format=torch.channels_last) if values.dim() == 4 else values
        for name, values in found.items()
    }


def arrays_of(network: Any, prefix: str = "") -> Arrays:
    """Return the state of a network as arrays by name."""
    return {f"{prefix}{name}": values.contiguous().cpu().numpy() for name, values in network.state_dict().items()}


def pack(networks: Mapping[str, Any], optimizer: Any) -> Arrays:
    """Return the state of networks and of their optimiser as named arrays.

    Parameters
    ----------
    networks : mapping of str to torch.nn.Module
        The names contain no dot, and none of them is "optimizer".
    optimizer : torch.optim.Optimizer
    """
    arrays: Arrays = {}
    for name, network in networks.items():
        arrays |= arrays_of(network, f"{name}.")
    for k, moments in optimizer.state_dict()["state"].items():
        arrays |= {f"optimizer.{k}.{part}": values.cpu().numpy() for part, values in moments.items()}
    return arrays


def unpack_network(arrays: Mapping[str, NDArray[Any]], network: Any, path: Path, scenario: Scenario) -> None:
    """Load arrays, which were read from the weights' file ``path``, into a network that was made for a scenario.

    Raises
    ------
    WeightsError
        When the arrays do not fit the network or are not finite; the message names the file and the first wrong array.
    """
    torch: Any = importlib.import_module("torch")
    wanted = {name: tuple(values.shape) for name, values in network.state_dict().items()}
    for name in sorted(wanted.keys() | arrays.keys()):
        found = arrays[name].shape if name in arrays else None
        if wanted.get(name) != found:
            differs = f"{name} has shape {found}, expected {wanted.get(name)}"
            raise WeightsError(f"{path}: does not fit {scenario.id}, or belongs to another agent: {differs}")
    try:
        network.load_state_dict(_finite(arrays, torch))
    except ValueError as error:
        raise WeightsError(f"{path}: {error}") from None


def _finite(arrays: Mapping[str, NDArray[Any]], torch: Any) -> dict[str, Any]:
    """Return arrays as tensors; raise a ValueError if a value is not finite."""
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise ValueError(f"{name}: holds numbers that are not finite")
    return {name: torch.from_numpy(np.array(array)) for name, array in arrays.items()}


def unpack(arrays: Mapping[str, NDArray[Any]], networks: Mapping[str, Any], optimizer: Any) -> None:
    """Restore networks and their optimiser from the arrays that `pack` returned.

    Raises
    ------
    KeyError, RuntimeError, ValueError
        When the arrays do not fit the networks, or are not finite.
    """
    torch: Any = importlib.import_module("torch")
    groups: dict[str, Arrays] = {}
    for name, array in arrays.items():
        group, _, part = name.partition(".")
        groups.setdefault(group, {})[part] = array
    for name, network in networks.items():
        network.load_state_dict(_finite(groups[name], torch))
    parameters = [each for group in optimizer.param_groups for each in group["params"]]
    state: dict[int, dict[str, Any]] = {}
    for name, array in groups.get("optimizer", {}).items():
        k, _, part = name.partition(".")
        like = torch.zeros_like(parameters[int(k)]) if array.shape else torch.zeros(())  # keeps its memory format
        state.setdefault(int(k), {})[part] = like.copy_(torch.from_numpy(np.array(array)))
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
