"""The decorator of all compiled functions, and the cache of their machine code.

To decide whether cached machine code is still valid, Numba looks only at the file of the function, but kernels call kernels
of other files. The name of the cache folder therefore contains a digest of the whole package, so that everything is compiled
again after any change. Only a folder that the user names in NUMBA_CACHE_DIR is used as it is.

The cache must never stop a program: if a folder cannot be written, the next one is used, and if there is none, nothing is
cached. Damaged files of the cache are recognised and compiled again; Numba itself would run truncated machine code.
"""

import contextlib
import functools
import hashlib
import importlib
import io
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import caching

_F = TypeVar("_F", bound=Callable[..., Any])
_R = TypeVar("_R")
_DIGEST_BYTES = hashlib.sha256().digest_size
_SAID = "UAVBENCH_CACHE_WARNED"  # in the environment, so that worker processes do not repeat the warning


def _warn(line: str) -> None:
    """Print a warning of one line, unless this process or its parent has printed one already."""
    if _SAID not in os.environ:
        os.environ[_SAID] = "1"
        print(f"uavbench: {line}", file=sys.stderr)  # noqa: T201


def _folders() -> Iterator[Path]:
    """Yield the folders where machine code may be cached, the best first."""
    wished = cast("Any", numba).config.CACHE_DIR  # NUMBA_CACHE_DIR takes precedence
    if wished:
        yield Path(wished)
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(path.read_bytes())
    name = f"kernels-{digest.hexdigest()[:16]}"
    inside = package / "__pycache__" / name
    if not inside.exists():  # only this folder is ours alone: other installations may use the folders below
        for stale in inside.parent.glob("kernels-*"):
            shutil.rmtree(stale, ignore_errors=True)
    yield inside
    with contextlib.suppress(RuntimeError):  # no home directory: HOME is not set, and the system does not know the user
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "uavbench" / name
    own = _own_temporary_folder()
    if own:
        yield own / name


def _own_temporary_folder() -> Path | None:
    """Return this user's temporary folder; None if others could write there, because cached code is executed."""
    user = os.getuid() if hasattr(os, "getuid") else "cache"
    try:
        folder = Path(tempfile.gettempdir()) / f"uavbench-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        about = folder.lstat()
    except OSError:
        return None
    ours = stat.S_ISDIR(about.st_mode) and (os.name == "nt" or (about.st_uid == user and not about.st_mode & 0o077))
    return folder if ours else None


def _usable(folder: Path) -> bool:
    """Return whether files can be written in ``folder``, which is created if it is missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(4096))  # empty files can be created even on a full disk
    except (OSError, ValueError):
        return False
    return True


def _cache_folder() -> str | None:
    """Return the first folder that can be written; None if there is none."""
    refused: list[Path] = []
    for folder in _folders():
        if _usable(folder):
            if refused and (cast("Any", numba).config.CACHE_DIR or folder.parent == _own_temporary_folder()):
                _warn(f"{refused[0]} cannot be written: compiled code is cached in {folder}")
            return str(folder)
        refused.append(folder)
    _warn(f"{refused[0]} cannot be written, nor any other folder for compiled code: every start compiles anew")
    return None


_IndexDataCacheFile: Any = caching.IndexDataCacheFile  # which has no types


def _base(file: Any) -> Any:
    """Return ``super()`` of a `_CheckedFile` as Any, because Numba has no types."""
    return cast("Any", super(_CheckedFile, file))


class _CheckedFile(_IndexDataCacheFile):
    """Numba's cache files of one function, each followed by its SHA-256; a damaged file counts as missing."""

    def save(self, key: Any, data: Any) -> None:
        """Save machine code; if it cannot be written, it is not cached."""
        try:
            _base(self).save(key, data)
        except OSError as error:
            _warn(f"compiled code is not cached: {self._cache_path}: {error.strerror}")

    @contextlib.contextmanager
    def _open_for_write(self, filepath: str) -> Generator[io.BytesIO]:
        with _base(self)._open_for_write(filepath) as file:
            buffer = io.BytesIO()
            yield buffer
            file.write(buffer.getvalue() + hashlib.sha256(buffer.getvalue()).digest())

    def _load_index(self) -> Any:
        try:
            _check_digest(self._index_path)
            return _base(self)._load_index()
        except FileNotFoundError:
            return {}
        except Exception:
            _warn(f"{self._index_path} is damaged: compiled again")
            return {}

    def _load_data(self, name: str) -> Any:
        try:
            _check_digest(self._data_path(name))
            return _base(self)._load_data(name)
        except FileNotFoundError:
            raise
        except Exception:
            _warn(f"{self._data_path(name)} is damaged: compiled again")
            raise OSError("damaged") from None  # Numba catches it and compiles again


def _check_digest(path: str) -> None:
    """Raise a ValueError if a file does not end with the SHA-256 of the rest. Pickle ignores the bytes after its data."""
    content = Path(path).read_bytes()
    if hashlib.sha256(content[:-_DIGEST_BYTES]).digest() != content[-_DIGEST_BYTES:]:
        raise ValueError(path)


_CACHE_FOLDER = _cache_folder()


def kernel(function: _F) -> _F:
    """Compile ``function`` with Numba in nopython mode, cached on disk.

    No ``fastmath``: results must not depend on how a compiler reorders sums (ADR 3).
    """
    return _cached(cast("Any", numba).njit(error_model="numpy")(function))


def parallel_kernel(function: Callable[..., _R]) -> Callable[..., _R]:
    """Compile ``function``, whose first parameter is a number of threads, as a `kernel` with loops over ``numba.prange``.

    Such a kernel only divides the slots of a batch among calls of another kernel. Slots are independent of each other, so the
    results are the same to the last bit for any number of threads. It is compiled at its first call, so that it costs nothing
    where threads are never used.
    """
    compiled = _cached(cast("Any", numba).njit(error_model="numpy", parallel=True)(function))

    @functools.wraps(function)
    def run(threads: int, *rest: Any) -> _R:
        numba_threads = cast("Any", numba)
        before = numba_threads.get_num_threads()
        numba_threads.set_num_threads(min(threads, numba_threads.config.NUMBA_NUM_THREADS))
        try:
            return compiled(threads, *rest)
        finally:
            numba_threads.set_num_threads(before)

    return run


def _cached(compiled: Any) -> Any:
    """Make a compiled function store its machine code in the cache folder."""
    if _CACHE_FOLDER is None:
        return compiled
    config = cast("Any", numba).config
    before, config.CACHE_DIR = config.CACHE_DIR, _CACHE_FOLDER
    try:
        compiled.enable_caching()
    except (OSError, RuntimeError):  # Numba cannot use the folder: it has been removed since
        return compiled
    finally:
        config.CACHE_DIR = before
    compiled._cache._cache_file.__class__ = _CheckedFile
    return compiled


@kernel
def share(size: int, part: int, parts: int) -> tuple[int, int]:
    """Divide ``size`` slots into ``parts`` almost equal parts; return where part ``part`` and the next one begin."""
    return size * part // parts, size * (part + 1) // parts


@contextlib.contextmanager
def compilations_told(begin: Callable[[], None], end: Callable[[], None]) -> Generator[None]:
    """Within the block, call ``begin`` before and ``end`` after each compilation by Numba or read from its cache."""
    event: Any = importlib.import_module("numba.core.event")
    base: Any = event.Listener

    class Listener(base):
        def on_start(self, event: object) -> None:  # noqa: ARG002  # Numba passes it
            begin()

        def on_end(self, event: object) -> None:  # noqa: ARG002
            end()

    with event.install_listener("numba:compiler_lock", Listener()):
        yield
