"""The files of an agent: importing its module, finding the modules that it imports, and one digest of all of them.

An agent's *own* modules are those in its folder. As if the file were run as a script, they are found before installed packages,
separately for each agent. They never replace modules of Python's standard library or modules that uavbench itself has imported.
After the installed packages, the current folder and the folder of the baselines are searched.
"""

import ast
import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Iterator, Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType

from uavbench.world.files import SOURCE_BYTES, read_bounded
from uavbench.world.resources import baselines_folder

_KEPT = {name.partition(".")[0] for name in (*sys.stdlib_module_names, *sys.modules)}  # no agent's module replaces these


class _Source(SourceFileLoader):
    """Compiles a file anew at every import: Python might take cached bytecode of its last version for that of an edited one."""

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)  # pyright: ignore[reportUnknownMemberType]


class _Finder:
    """Finds modules in certain folders, for the agent that was imported last."""

    def __init__(self) -> None:
        self.folders: list[str] = []
        self.found: set[str] = set()

    def find_spec(self, name: str, path: Sequence[str] | None = None, _target: ModuleType | None = None) -> ModuleSpec | None:
        """Return the module's specification, as `importlib.abc.MetaPathFinder` does; None if the module is not the agent's."""
        if name.partition(".")[0] in _KEPT or (path is not None and name.partition(".")[0] not in self.found):
            return None
        spec = PathFinder.find_spec(name, self.folders if path is None else path)
        if spec is None or spec.loader is None or spec.origin is None:
            return None
        if isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Source(name, spec.origin)
        self.found.add(name)
        return spec


_OWN, _LAST = _Finder(), _Finder()


def import_agent(path: Path, name: str | None = None) -> ModuleType:
    """Import an agent's file and its own modules, even if they have been imported before.

    Parameters
    ----------
    path : Path
        The file.
    name : str, optional
        The module name ``package.module`` under which it is imported; by default the file is a module without a package.
    """
    if _OWN not in sys.meta_path:
        sys.meta_path.insert(0, _OWN)  # pyright: ignore[reportArgumentType]
        sys.meta_path.append(_LAST)  # pyright: ignore[reportArgumentType]
    importlib.invalidate_caches()
    folder = path.resolve().parent
    own = {each.stem for each in (*folder.glob("*.py"), *(init.parent for init in folder.glob("*/__init__.py")))} - _KEPT
    aside = {
        loaded: sys.modules.pop(loaded)
        for loaded in list(sys.modules)
        if loaded in _OWN.found | _LAST.found or loaded.partition(".")[0] in own
    }
    installed = {loaded: module for loaded, module in aside.items() if loaded not in _OWN.found | _LAST.found}
    _OWN.folders, _LAST.folders = [str(folder)], [str(Path.cwd()), str(baselines_folder())]
    _OWN.found, _LAST.found = set(), set()
    try:
        if name is not None:
            return importlib.import_module(name)
        name = f"uavbench_agent_{path.stem}_{hashlib.sha256(_content(path)).hexdigest()[:8]}"
        spec = importlib.util.spec_from_file_location(name, path, loader=_Source(name, str(path)))
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module  # dataclasses and pickles look their module up by name
        spec.loader.exec_module(module)
        return module
    finally:
        for loaded, module in installed.items():
            sys.modules.setdefault(loaded, module)


def files_digest(path: Path) -> str:
    """Return the SHA-256 of an agent's file; if it imports its own modules or baselines, that of the sorted digests of all.

    Line endings do not matter: a file has the same digest with Unix and with Windows line endings.
    """
    found = sorted(hashlib.sha256(_content(each)).hexdigest() for each in agent_files(path))
    return found[0] if len(found) == 1 else hashlib.sha256("".join(found).encode()).hexdigest()


def _content(path: Path) -> bytes:
    """Return a file's bytes, with Unix line endings."""
    return read_bounded(path, SOURCE_BYTES).replace(b"\r\n", b"\n")


def agent_files(path: Path) -> list[Path]:
    """Return an agent's file and the own modules and baselines that its ``import`` statements name, directly or indirectly."""
    path = path.resolve()
    found, waiting = {path}, [path]
    while waiting:
        for each in _imported(waiting.pop(), path.parent):
            if each not in found:
                found.add(each)
                waiting.append(each)
    return sorted(found)


def _imported(file: Path, folder: Path) -> Iterator[Path]:
    """Return the files in ``folder`` or among the baselines that a file's import statements name."""
    try:
        tree = ast.parse(read_bounded(file, SOURCE_BYTES))
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # importing the file reports it
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from _files_of(alias.name.split("."), folder)
        elif isinstance(node, ast.ImportFrom):
            parts = node.module.split(".") if node.module else []
            for alias in node.names:
                if node.level:
                    base = file.parents[node.level - 1]
                    yield from _along(base, [*parts, alias.name]) if base.is_relative_to(folder) else ()
                else:
                    yield from _files_of([*parts, alias.name], folder)


def _files_of(parts: list[str], folder: Path) -> Iterator[Path]:
    """Return the files of an absolute module name: an own module, with or without the name of its folder, or a baseline."""
    if parts[0] in _KEPT:
        return
    own = list(_along(folder, parts)) or (list(_along(folder, parts[1:])) if parts[0] == folder.name else [])
    yield from own or _along(baselines_folder(), parts)


def _along(folder: Path, parts: Sequence[str]) -> Iterator[Path]:
    """Return the files that Python executes to import the dotted name ``parts`` from ``folder``."""
    for part in parts:
        if (folder / part / "__init__.py").is_file():
            folder = folder / part
            yield folder / "__init__.py"
        elif (folder / f"{part}.py").is_file():
            yield folder / f"{part}.py"
            return
        else:
            return
