"""The missions that scenario files can name by their ``kind``: registered missions, and missions of a user's own files."""

import hashlib
import importlib.util
import inspect
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

from pydantic import BaseModel, ValidationInfo, field_validator

from uavbench.errors import UavbenchError
from uavbench.world.files import FileError, read_bounded
from uavbench.world.parameters import Coverage, Harvesting, MissionParameters

_MAX_BYTES = 1_000_000  # of a file that defines a mission
_REGISTERED: dict[str, type[MissionParameters]] = {}


class MissionError(UavbenchError, ValueError):
    """A mission cannot be registered; the message says why."""


def register_mission(parameters: type[MissionParameters]) -> None:
    """Register a mission, so that scenarios can name its kind.

    Parameters
    ----------
    parameters : type of MissionParameters
        The class of the mission's parameters. Its ``kind`` is a ``Literal`` of one text.

    Raises
    ------
    MissionError
        When a method is missing, ``kind`` is not a ``Literal`` of one text, or another mission has the same kind.
    """
    reason = _unusable(parameters)
    if reason:
        raise MissionError(f"{parameters.__name__}: {reason}")
    (kind,) = _kinds(parameters)
    if _REGISTERED.setdefault(kind, parameters) is not parameters:
        raise MissionError(f"{parameters.__name__}: the kind {kind!r} is taken by {_REGISTERED[kind].__qualname__}")


def read_mission(values: Any) -> Any:
    """Turn the table ``[mission]`` of a scenario into parameters of its kind; return unchanged what already are parameters.

    Raises
    ------
    pydantic.ValidationError
        When the table is wrong; the locations in the error are fields of the table.
    """
    if isinstance(values, MissionParameters):
        return values
    head = _Head.model_validate(values)
    if head.file is None:
        return _REGISTERED[head.kind].model_validate(values)
    return _classes(head.file)[head.kind].model_validate({**values, "file": head.file, "sha256": _read(head.file)[1]})


class _Head(BaseModel):
    """The fields that decide which class of parameters the other fields belong to."""

    sha256: str | None = None
    file: Path | None = None
    kind: str

    @field_validator("file")
    @classmethod
    def _importable(cls, path: Path | None, info: ValidationInfo) -> Path | None:
        if path is not None:
            expected, found = info.data.get("sha256"), _read(path)[1]
            if expected not in (None, found):
                raise ValueError(f"{path} has the SHA-256 {found}, not {expected}: it is another file, or was edited since")
            _classes(path)
        return path

    @field_validator("kind")
    @classmethod
    def _known(cls, kind: str, info: ValidationInfo) -> str:
        if "file" not in info.data:  # the file was refused
            return kind
        path = info.data["file"]
        known = _REGISTERED if path is None else _classes(path)
        if kind not in known:
            where = "" if path is None else f", which {path.name} defines"
            raise ValueError(f"{kind!r} is not {' or '.join(map(repr, known))}{where}")
        return kind


def _read(path: Path) -> tuple[bytes, str]:
    """Return the content of a mission's file with Unix line endings, and its SHA-256."""
    try:
        content = read_bounded(path, _MAX_BYTES).replace(b"\r\n", b"\n")
    except FileError as error:
        raise ValueError(str(error)) from None
    return content, hashlib.sha256(content).hexdigest()


def _classes(path: Path) -> dict[str, type[MissionParameters]]:
    """Import a mission's file, if it is new or was edited, and return the missions that it defines, by kind."""
    content, sha256 = _read(path)
    module = _module(path, content, f"uavbench_mission_{path.stem}_{sha256}")
    found: dict[str, type[MissionParameters]] = {}
    for each in vars(module).values():
        if inspect.isclass(each) and issubclass(each, MissionParameters) and each.__module__ == module.__name__:
            reason = _unusable(each)
            if reason:
                raise ValueError(f"{path}: {each.__name__}: {reason}")
            (kind,) = _kinds(each)
            if kind in _REGISTERED:
                raise ValueError(f"{path}: {each.__name__}: the kind {kind!r} is taken: choose another")
            found[kind] = each
    if not found:
        raise ValueError(f"{path} defines no subclass of MissionParameters")
    return found


def _module(path: Path, content: bytes, name: str) -> ModuleType:
    """Return the module ``name``; run ``content`` as this module if it is not loaded yet."""
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # pydantic looks up annotations there
    try:
        exec(compile(content, path, "exec"), vars(module))  # the same bytes that were hashed
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise ValueError(f"importing {path} raised {type(error).__name__}: {error}") from None
    return module


def _unusable(parameters: type[MissionParameters]) -> str | None:
    """Return why a class of parameters cannot be used; None if it can."""
    missing = sorted(getattr(parameters, "__abstractmethods__", ()))
    if missing:
        return f"it does not define {', '.join(missing)}"
    if "city" in inspect.signature(parameters.make).parameters:
        return "its make is called as make(scenario, num_envs), without the city: see docs/missions.md"
    if len(_kinds(parameters)) != 1:
        return 'its kind must be a Literal of one text, as in kind: Literal["surveillance"]'
    return None


def _kinds(parameters: type[MissionParameters]) -> tuple[Any, ...]:
    return get_args(parameters.model_fields["kind"].annotation)


register_mission(Coverage)
register_mission(Harvesting)

#: The kinds of the missions that come with the suite.
SHIPPED = tuple(_REGISTERED)
