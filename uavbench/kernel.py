"""The decorator of every compiled function, and the place where machine code is cached.

Numba looks only at the file of a function to decide whether its cached machine code is still good, but kernels call
kernels of other files. So the cache folder is named by a digest of the whole package: a change anywhere compiles anew.
"""

import contextlib
import hashlib
import importlib
import os
import shutil
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

_F = TypeVar("_F", bound=Callable[..., Any])


def _cache_folder() -> Path:
    """Return the cache folder of exactly these sources: in the package where it is writable, else in the user's cache."""
    package = Path(__file__).resolve().parent
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(path.read_bytes())
    name = f"kernels-{digest.hexdigest()[:16]}"
    inside = package / "__pycache__"
    if os.access(inside if inside.is_dir() else package, os.W_OK):
        return inside / name
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "uavbench" / name


def _fresh(folder: Path) -> Path:
    """Remove what earlier sources of this package left beside ``folder``, when it is to be made."""
    if folder.parent.name == "__pycache__" and not folder.exists():  # the user's folder may serve other installations
        for stale in folder.parent.glob("kernels-*"):
            shutil.rmtree(stale, ignore_errors=True)
    return folder


_CACHE_FOLDER = str(_fresh(_cache_folder()))


def kernel(function: _F) -> _F:
    """Compile ``function`` with Numba in nopython mode, cached on disk.

    No ``fastmath``: results must not depend on how a compiler reorders sums (ADR 3).
    """
    config = cast("Any", numba).config
    before = config.CACHE_DIR
    config.CACHE_DIR = before or _CACHE_FOLDER  # a user's NUMBA_CACHE_DIR wins
    try:
        return cast("Any", numba).njit(cache=True, error_model="numpy")(function)
    finally:
        config.CACHE_DIR = before


@contextlib.contextmanager
def compilations_told(begin: Callable[[], None], end: Callable[[], None]) -> Generator[None]:
    """Call ``begin`` and ``end`` around everything that Numba compiles, or reads from its cache, in the block."""
    event: Any = importlib.import_module("numba.core.event")
    base: Any = event.Listener

    class Listener(base):
        def on_start(self, event: object) -> None:  # noqa: ARG002  # Numba passes it
            begin()

        def on_end(self, event: object) -> None:  # noqa: ARG002
            end()

    with event.install_listener("numba:compiler_lock", Listener()):
        yield
