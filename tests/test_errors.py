"""One base for all errors, so that one ``except`` catches whatever the suite refuses."""

import ast
import importlib
from pathlib import Path

import pytest

import uavbench

PACKAGE = Path(uavbench.__file__).parent


def errors() -> list[type[Exception]]:
    """Return the exception classes that modules of the package define, found in their sources."""
    found: list[type[Exception]] = []
    for path in sorted(PACKAGE.rglob("*.py")):
        if {"templates", "scenarios", "baselines"} & set(path.relative_to(PACKAGE).parts):
            continue
        names = [node.name for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ClassDef)]
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
        found += [getattr(importlib.import_module(module), name) for name in names if name.endswith("Error")]
    return found


@pytest.mark.parametrize("kind", [kind for kind in errors() if issubclass(kind, Exception)], ids=lambda kind: kind.__name__)
def test_every_error_has_the_common_base(kind: type[Exception]) -> None:
    assert issubclass(kind, uavbench.UavbenchError)


def test_there_are_errors_to_look_at() -> None:
    assert len(errors()) >= 9
