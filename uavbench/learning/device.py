"""Where networks compute during a training: the processor, or a graphics card."""

import importlib
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from uavbench.errors import UavbenchError

#: What a user may ask for. "auto" is the first of cuda, mps and cpu that there is.
DEVICES = ("auto", "cpu", "cuda", "mps")


class DeviceError(UavbenchError, ValueError):
    """There is no such device; the message says which there are."""


def on_device(name: str) -> AbstractContextManager[Any]:
    """Return a context in which a device is PyTorch's default: tensors that are made there are on it.

    A learner gets it by ``torch.get_default_device()``. The built-in learners make their networks on the processor, so that
    they begin with the same weights everywhere, and compute on the device.

    Parameters
    ----------
    name : str
        One of `DEVICES`.

    Raises
    ------
    DeviceError
        When the name is unknown, or PyTorch does not find the device here.
    """
    torch: Any = importlib.import_module("torch")
    found = {"cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available(), "cpu": True}
    if name == "auto":
        name = next(each for each, there in found.items() if there)
    if not found.get(name, False):
        there = ", ".join(sorted(each for each in found if found[each]))
        raise DeviceError(f"device {name}: PyTorch finds none here; there is {there}")
    return nullcontext() if name == "cpu" else torch.device(name)  # the context makes every call of PyTorch a little slower
