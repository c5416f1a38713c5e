"""Files of arrays: the same arrays give the same bytes, and a file is written whole or not at all."""

import contextlib
import errno
import io
import math
import os
import shutil
import tempfile
import tokenize
import zipfile
import zlib
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MOST_BYTES = 2**28


def pack_arrays(arrays: Mapping[str, NDArray[Any]], *, compress: bool = False) -> bytes:
    """Return the bytes of an ``.npz`` file of ``arrays``, in alphabetical order and without pickles."""
    buffer = io.BytesIO()
    save = np.savez_compressed if compress else np.savez
    save(buffer, allow_pickle=False, **{name: arrays[name] for name in sorted(arrays)})
    return buffer.getvalue()


def unpack_arrays(content: bytes, most: int = _MOST_BYTES) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz`` file, whoever wrote it: nothing is run, and no more is unpacked than is allowed.

    Raises
    ------
    ValueError
        When the bytes are not such a file, or one that holds objects, names with paths, or more than ``most`` bytes.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as table:
            members = table.infolist()
            names = [member.filename.removesuffix(".npy") for member in members]
            if not all(name.isidentifier() for name in names) or len(set(names)) < len(names):
                raise ValueError("its arrays are not named each once and plainly")
            if sum(member.file_size for member in members) > most:
                raise ValueError(f"it would unpack to more than {most >> 20} MB")
            return {name: _read_array(table, member) for name, member in zip(names, members, strict=True)}
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, KeyError, RuntimeError, OverflowError) as error:
        raise ValueError(f"not an .npz file: {error}") from None


def _read_array(table: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """Read one array; what its header promises must be what is there, before memory is taken for it."""
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{member.filename}: compressed in a way that NumPy does not use")
    with table.open(member) as file:
        content = file.read(member.file_size + 1)  # without a number, zipfile inflates up to 1 GB and then cuts it to this
    header = io.BytesIO(content)
    version = np.lib.format.read_magic(header)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"{member.filename}: an array of format {version}")
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    try:
        shape, fortran_order, dtype = read(header)
    except (SyntaxError, tokenize.TokenError, MemoryError, RecursionError):  # of the parser of Python's own literals
        raise ValueError(f"{member.filename}: its header is no array's") from None
    rest = content[header.tell() :]
    if dtype.hasobject or dtype.names is not None:
        raise ValueError(f"{member.filename}: holds objects instead of numbers")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(rest):
        raise ValueError(f"{member.filename}: says shape {shape} of {dtype}, holds {len(rest)} bytes")
    return np.frombuffer(rest, dtype).reshape(shape, order="F" if fortran_order else "C").copy()


def check_writable(folder: Path) -> None:
    """Make a folder if need be, and raise the OSError that writing into it would, before the work is done."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        error.filename = str(folder)  # not the name of a file that nobody asked for
        raise


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that it is there as a whole, or as it was before, whatever happens meanwhile."""
    write_together({path: content})


def write_together(contents: Mapping[Path, bytes]) -> None:
    """Write files, each as a whole, and none before all are on the disk and can take their places.

    Those of one folder take their places together, whatever happens meanwhile: see `moved_together`.
    """
    folders = {path: path.parent for path in contents}
    for path, parent in folders.items():
        parent.mkdir(parents=True, exist_ok=True)
        folders[path] = parent.resolve()
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    with contextlib.ExitStack() as opened:
        staging = {parent: opened.enter_context(moved_together(parent)) for parent in sorted(set(folders.values()))}
        for path, content in contents.items():
            with (staging[folders[path]] / path.name).open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())


def replace_folders(new: Mapping[Path, Path]) -> None:
    """Put folders in the places of others, by place: all, or none if one fails; all places are in one folder.

    Several processes may do so at once: the folders of one of them are there in the end, each as a whole.
    """
    (parent,) = {place.parent for place in new}
    with moved_together(parent) as staging:
        for place in new:
            if place.exists() and not os.access(place, os.W_OK):  # it could be moved away, but not deleted then
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(place))
        moved: list[Path] = []
        try:
            for place, made in new.items():
                made.replace(staging / place.name)
                moved.append(place)
        except BaseException:
            for place in moved:
                (staging / place.name).replace(new[place])
            raise


# What takes the place of something else is first put together in a folder of its own beside it. When it is all there, one
# rename makes that folder a promise: whoever comes next, and holds the lock, keeps it if the process was killed meanwhile.
_STAGING, _PROMISE, _OLD = ".uavbench-new-", ".uavbench-ready-", ".uavbench-old-"


@contextlib.contextmanager
def moved_together(parent: Path) -> Generator[Path]:
    """Give a folder in ``parent``; what is in it after the block takes its place in ``parent``: all of it or nothing.

    A process that is killed leaves all that was there before, or something that `finish_moves` makes all that is new.
    """
    with _alone_in(parent) as alone:
        _finish(parent, alone)
        staging = Path(tempfile.mkdtemp(prefix=_STAGING, dir=parent))
        promise = parent / staging.name.replace(_STAGING, _PROMISE)
        try:
            yield staging
            staging.replace(promise)
        except BaseException:
            shutil.rmtree(staging, ignore_errors=True)
            raise
        _keep(promise)


def finish_moves(parent: Path) -> None:
    """Finish what a killed process left half moved in a folder, if it did; where that cannot be done, leave all as it is."""
    with contextlib.suppress(OSError):
        if any(parent.glob(f"{_PROMISE}*")):
            with _alone_in(parent) as alone:
                _finish(parent, alone)


def _finish(parent: Path, alone: bool) -> None:
    """Keep the promises of killed processes, and delete what they had not promised yet."""
    for promise in sorted(parent.glob(f"{_PROMISE}*")):
        _keep(promise)
    if alone:  # else another process may be at work there
        for left in [*parent.glob(f"{_STAGING}*"), *parent.glob(f"{_OLD}*")]:
            shutil.rmtree(left, ignore_errors=True)


def _keep(promise: Path) -> None:
    """Move everything in a folder to its place in the parent; on failure, everything back."""
    parent = promise.parent
    old = Path(tempfile.mkdtemp(prefix=_OLD, dir=parent))
    made = sorted(promise.iterdir())
    moved: list[Path] = []
    try:
        for each in made:
            place = parent / each.name
            if place.is_dir():
                place.replace(old / each.name)
            elif place.exists() and len(made) > 1:  # a file is not moved away first: it is there at any time
                shutil.copy2(place, old / each.name)
            moved.append(each)
            each.replace(place)
    except BaseException:
        for each in moved:
            place = parent / each.name
            if not each.exists():
                place.replace(each)
            if (old / each.name).exists():
                (old / each.name).replace(place)
        shutil.rmtree(promise, ignore_errors=True)
        raise
    finally:
        shutil.rmtree(old, ignore_errors=True)
    promise.rmdir()


@contextlib.contextmanager
def _alone_in(folder: Path) -> Generator[bool]:
    """Wait until no other process moves things in a folder; say whether the system could promise that.

    The lock is on the folder itself and ends with the process: nothing is left when that is killed. Windows and some network
    drives have no such lock: there, processes that publish the same name at the same time may disturb each other.
    """
    try:
        import fcntl

        handle = os.open(folder, os.O_RDONLY)
    except (ImportError, PermissionError):
        yield False
        return
    try:
        locked = True
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
        except OSError:
            locked = False
        yield locked
    finally:
        os.close(handle)
