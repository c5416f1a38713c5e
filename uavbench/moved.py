"""Old names of modules. Until version 0.3, each still imports the module with its new name, with a DeprecationWarning."""

import importlib
import importlib.abc
import importlib.machinery
import sys
import warnings
from collections.abc import Sequence
from types import ModuleType
from typing import Any

#: The new name of each module by its old name, both without ``uavbench.``.
MOVED = {
    "agent": "agents.agent",
    "agent_files": "agents.agent_files",
    "apart": "agents.apart",
    "check": "evaluation.check",
    "city": "world.city",
    "decision_clock": "evaluation.decision_clock",
    "display": "cli.display",
    "episode": "world.episode",
    "evaluate": "evaluation.evaluate",
    "export": "learning.export",
    "figures": "pictures.figures",
    "files": "world.files",
    "film": "pictures.film",
    "freeze": "simulation.freeze",
    "interrupt": "evaluation.interrupt",
    "kernel": "world.kernel",
    "keyed": "world.keyed",
    "memory": "simulation.memory",
    "metrics": "evaluation.metrics",
    "missions": "simulation.missions",
    "missions.registry": "world.registry",
    "missions.channel": "simulation.missions.channel",
    "missions.coverage": "simulation.missions.coverage",
    "missions.harvesting": "simulation.missions.harvesting",
    "missions.shapes": "simulation.missions.shapes",
    "moves": "simulation.moves",
    "observation": "simulation.observation",
    "onnx_agent": "agents.onnx_agent",
    "onnx_file": "agents.onnx_file",
    "options": "simulation.options",
    "outcomes": "simulation.outcomes",
    "parameters": "world.parameters",
    "peers": "speed.peers",
    "play": "pictures.play",
    "plot": "pictures.plot",
    "pooling": "simulation.pooling",
    "processes": "evaluation.processes",
    "progress": "cli.progress",
    "reference": "evaluation.reference",
    "render": "drawing.raster",
    "replay": "evaluation.replay",
    "report": "pictures.report",
    "resources": "world.resources",
    "results": "evaluation.results",
    "rows": "simulation.rows",
    "run": "evaluation.run",
    "scenario": "world.scenario",
    "scene": "drawing.scene",
    "simulator": "simulation.simulator",
    "slots": "simulation.slots",
    "spreadsheet": "evaluation.spreadsheet",
    "starts": "simulation.starts",
    "state": "simulation.state",
    "state_view": "simulation.state_view",
    "torch_state": "agents.torch_state",
    "trail": "drawing.trail",
    "train": "learning.train",
    "values": "world.values",
    "watch": "pictures.watch",
    "weights": "agents.weights",
    "window": "drawing.window",
}


#: Where the other names of a module are that was split in two.
SPLIT = {"simulation.memory": "learning.memory"}


class _OldName(ModuleType):
    """A module that offers all names of another module."""

    def __init__(self, name: str, new: str) -> None:
        super().__init__(name)
        vars(self)["_new"] = new

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") and name not in ("__all__", "__version__"):
            raise AttributeError(name)
        found = importlib.import_module(vars(self)["_new"])
        other = SPLIT.get(vars(self)["_new"].removeprefix("uavbench."))
        if other and not hasattr(found, name):
            found = importlib.import_module(f"uavbench.{other}")
        return getattr(found, name)

    def __dir__(self) -> list[str]:
        return dir(importlib.import_module(vars(self)["_new"]))


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds the modules of `MOVED` by their old names."""

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> Any:  # noqa: ARG002
        """Return a module specification for an old name; None for any other name."""
        package, _, name = fullname.partition(".")
        if package != "uavbench" or name not in MOVED:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, is_package=name == "missions")

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        """Return a module that offers all names of the module with the new name; warn about the old name."""
        new = f"uavbench.{MOVED[spec.name.removeprefix('uavbench.')]}"
        warnings.warn(f"{spec.name} is now {new}; the old name works until version 0.3", DeprecationWarning, stacklevel=2)
        importlib.import_module(new)  # so that an error in it is raised here
        return _OldName(spec.name, new)

    def exec_module(self, module: ModuleType) -> None:
        """Do nothing: the module has been executed under its new name."""


def install() -> None:
    """Make the old names importable."""
    sys.meta_path.append(_Finder())
