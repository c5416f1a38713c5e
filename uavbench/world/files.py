"""Files: what is read is plain and of bounded size, the same arrays give the same bytes, and a file is written whole or not.

Whoever reads a file that the package did not bring reads it by `read_bounded` or one of the functions built on it: the file
may come from anybody, and may be a pipe that never ends.
"""

import contextlib
import errno
import io
import math
import os
import shutil
import stat
import tempfile
import tokenize
import tomllib
import zipfile
import zlib
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.errors import UavbenchError, one_line

#: The most bytes that a file of each kind may have.
TOML_BYTES = 2**16
TABLE_BYTES = 2**26  # of a CSV or JSON file: a million episodes
ARRAYS_BYTES = 2**28  # of an .npz file, packed and unpacked
MODEL_BYTES = 2**30  # of weights and ONNX models
SOURCE_BYTES = 2**24  # of an agent's Python file
_MAX_DOTS = 200  # in a line of TOML: the parser's time and memory grow with their square


_LONGEST_NAME = 100
#: Names that Windows keeps for devices, whatever stands behind a dot.
_RESERVED = {
    "CON",
    "PRN",
    "AUX",
    "NUL",
    "CONIN$",
    "CONOUT$",
    *(f"{port}{n}" for port in ("COM", "LPT") for n in "0123456789¹²³"),
}


class FileError(UavbenchError, OSError):
    """A file that cannot be read; the message names it and says why."""


class NoFileError(FileError, FileNotFoundError):
    """A file that is not there."""


def check_plain(path: Path, most: int) -> None:
    """Refuse what is not a plain file of at most ``most`` bytes, without waiting for anything: for libraries that read paths.

    Raises
    ------
    FileError
        When there is no such file, it is a folder, a pipe or a device, is too large, or may not be read.
    """
    os.close(_open_plain(path, most))


def read_bounded(path: Path, most: int) -> bytes:
    """Return the bytes of a plain file, at most ``most``; it may have been written by anybody.

    Raises
    ------
    FileError
        As `check_plain`.
    """
    with os.fdopen(_open_plain(path, most), "rb") as file:
        try:
            content = file.read(most + 1)
        except OSError as error:
            raise FileError(f"{one_line(path)}: cannot be read: {error.strerror}") from None
    if len(content) > most:  # it has grown meanwhile, or its file system does not tell sizes
        raise FileError(_too_large(path, most))
    return content


def _open_plain(path: Path, most: int) -> int:
    """Open a file for reading, if it is plain and not too large; return its descriptor."""
    name = one_line(path)
    try:  # a pipe is opened without waiting for somebody who writes into it
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (FileNotFoundError, NotADirectoryError):
        raise NoFileError(f"{name}: there is no such file") from None
    except OSError as error:
        reason = "it is a folder" if os.path.isdir(path) else error.strerror  # noqa: PTH112 - Path.is_dir() may raise itself
        raise FileError(f"{name}: cannot be opened: {reason}") from None
    except ValueError:  # a NUL in the name
        raise NoFileError(f"{name}: no file can have this name") from None
    about = os.fstat(handle)
    if stat.S_ISREG(about.st_mode) and about.st_size <= most:
        return handle
    os.close(handle)
    if stat.S_ISREG(about.st_mode):
        raise FileError(_too_large(path, most))
    raise FileError(f"{name}: is not a plain file, but a {'folder' if stat.S_ISDIR(about.st_mode) else 'pipe or a device'}")


def _too_large(path: Path, most: int) -> str:
    return f"{one_line(path)}: is larger than {most:,} bytes, the most that is read of such a file"


def read_text(path: Path, most: int) -> str:
    """Return the text of a plain file in UTF-8, with or without a byte order mark; as `read_bounded`."""
    try:
        return read_bounded(path, most).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise FileError(
            f"{one_line(path)}: is not text in UTF-8 (byte {error.start} is {error.object[error.start]:#04x})"
        ) from None


def read_toml(path: Path) -> dict[str, Any]:
    """Return what a TOML file holds; as `read_bounded`, and a FileError when it is no TOML."""
    text = read_text(path, TOML_BYTES)
    for number, line in enumerate(text.split("\n"), 1):
        if line.count(".") > _MAX_DOTS:
            raise FileError(f"{one_line(path)}: line {number} has more than {_MAX_DOTS} dots: its keys are nested too deeply")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise FileError(f"{one_line(path)}: is not TOML that can be read: its values are nested too deeply") from None
    except ValueError as error:
        raise FileError(f"{one_line(path)}: is not TOML: {one_line(error)}") from None


def pack_arrays(arrays: Mapping[str, NDArray[Any]], *, compress: bool = False) -> bytes:
    """Return the bytes of an ``.npz`` file of ``arrays``, in alphabetical order and without pickles.

    The file is built here and not by ``np.savez``: its keywords and defaults differ between the versions of NumPy that we
    support, and the bytes must not.

    Raises
    ------
    ValueError
        When an array holds objects.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as table:
        for name in sorted(arrays):
            if arrays[name].dtype.hasobject:
                raise ValueError(f"{name}: holds objects; only numbers and text can be written")
            member = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            member.create_system = 3  # Unix, on every system
            member.compress_type = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
            with table.open(member, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, arrays[name], allow_pickle=False)
    return buffer.getvalue()


def unpack_arrays(content: bytes, most: int = ARRAYS_BYTES) -> dict[str, NDArray[Any]]:
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


def check_name(name: str) -> None:
    """Refuse a name that no file or folder can have on some system, or that breaks the lines it is printed in.

    Raises
    ------
    ValueError
        Then; the message says why.
    """
    if not name or len(name) > _LONGEST_NAME:
        raise ValueError(f"{one_line(name, repr)}: a name has 1 to {_LONGEST_NAME} characters")
    if not name.isprintable() or set(name) & set('<>:"/\\|?*'):
        raise ValueError(f"{one_line(name, repr)}: holds characters that names of files cannot have on every system")
    if name[0] in ". " or name[-1] in ". ":
        raise ValueError(f"{name!r}: begins or ends with a dot or a space, which Windows drops")
    if name.split(".")[0].rstrip().upper() in _RESERVED:
        raise ValueError(f"{name!r}: Windows reserves this name for a device; choose another")


def check_writable(folder: Path) -> None:
    """Make a folder if need be, and raise the OSError that writing into it would, before the work is done."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        error.filename = str(folder)  # not the name of a file that nobody asked for
        raise


def check_file_writable(path: Path) -> None:
    """Make the folder of a file if need be, and raise the OSError that writing the file would, before the work is done."""
    check_writable(path.absolute().parent)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))


def write_atomic(path: Path, content: bytes) -> None:
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
