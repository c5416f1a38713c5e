"""Reading files of bounded size, packing arrays into reproducible bytes, and writing files atomically.

Every file that does not ship with the package is read by `read_bounded` or a function built on it: anybody may have written
the file, and it may be a pipe that never ends.
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

#: The maximum size of each kind of file, in bytes.
TOML_BYTES = 2**16
TABLE_BYTES = 2**26  # of a CSV or JSON file: a million episodes
ARRAYS_BYTES = 2**28  # of an .npz file, packed and unpacked
MODEL_BYTES = 2**30  # of weights and ONNX models
SOURCE_BYTES = 2**24  # of an agent's Python file
_MAX_DOTS = 200  # in a line of TOML: the parser's time and memory grow with the square of their number


_LONGEST_NAME = 100
#: Names that Windows reserves for devices, with or without an extension.
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
    """A file cannot be read; the message names the file and the reason."""


class NoFileError(FileError, FileNotFoundError):
    """A file does not exist."""


def check_plain(path: Path, most: int) -> None:
    """Refuse a path that is not a plain file of at most ``most`` bytes, without blocking: for libraries that open paths.

    Raises
    ------
    FileError
        When the file does not exist, is a folder, a pipe or a device, is too large, or cannot be opened.
    """
    os.close(_open_plain(path, most))


def read_bounded(path: Path, most: int) -> bytes:
    """Return the bytes of a plain file of at most ``most`` bytes, which anybody may have written.

    Raises
    ------
    FileError
        As for `check_plain`.
    """
    with os.fdopen(_open_plain(path, most), "rb") as file:
        try:
            content = file.read(most + 1)
        except OSError as error:
            raise FileError(f"{one_line(path)}: cannot be read: {error.strerror}") from None
    if len(content) > most:  # the file has grown since, or its file system does not report sizes
        raise FileError(_too_large(path, most))
    return content


def _open_plain(path: Path, most: int) -> int:
    """Open a file for reading if it is a plain file and not too large; return its descriptor."""
    name = one_line(path)
    try:  # O_NONBLOCK: opening a pipe must not wait for a writer
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
    """Return the text of a plain UTF-8 file, with or without a byte order mark.

    Raises
    ------
    FileError
        As for `read_bounded`, and when the file is not valid UTF-8.
    """
    try:
        return read_bounded(path, most).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise FileError(
            f"{one_line(path)}: is not text in UTF-8 (byte {error.start} is {error.object[error.start]:#04x})"
        ) from None


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises
    ------
    FileError
        As for `read_text`, and when the file is not valid TOML.
    """
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

    The bytes must not depend on the version of NumPy, but the keywords and defaults of ``np.savez`` do: it is not used.

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
            member.create_system = 3  # always Unix, whatever the system
            member.compress_type = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
            with table.open(member, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, arrays[name], allow_pickle=False)
    return buffer.getvalue()


def unpack_arrays(content: bytes, most: int = ARRAYS_BYTES) -> dict[str, NDArray[Any]]:
    """Return the arrays of an untrusted ``.npz`` file: no code in it is run, and at most ``most`` bytes are unpacked.

    Raises
    ------
    ValueError
        When the bytes are not an ``.npz`` file, or the file holds objects, unpacks to more than ``most`` bytes, or has array
        names that are not unique identifiers.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as table:
            members = table.infolist()
            names = [member.filename.removesuffix(".npy") for member in members]
            if not all(name.isidentifier() for name in names) or len(set(names)) < len(names):
                raise ValueError("the names of its arrays are not unique identifiers")
            if sum(member.file_size for member in members) > most:
                raise ValueError(f"it would unpack to more than {most >> 20} MB")
            return {name: _read_array(table, member) for name, member in zip(names, members, strict=True)}
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, KeyError, RuntimeError, OverflowError) as error:
        raise ValueError(f"not an .npz file: {error}") from None


def _read_array(table: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """Read one array, after checking that the size in its header is the size of its content."""
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{member.filename}: compressed in a way that NumPy does not use")
    with table.open(member) as file:
        content = file.read(member.file_size + 1)  # without a size, zipfile decompresses up to 1 GB before it cuts the content
    header = io.BytesIO(content)
    version = np.lib.format.read_magic(header)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"{member.filename}: an array of format {version}")
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    try:
        shape, fortran_order, dtype = read(header)
    except (SyntaxError, tokenize.TokenError, MemoryError, RecursionError):  # raised by Python's parser of literals
        raise ValueError(f"{member.filename}: its header is not the header of an array") from None
    rest = content[header.tell() :]
    if dtype.hasobject or dtype.names is not None:
        raise ValueError(f"{member.filename}: holds objects instead of numbers")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(rest):
        raise ValueError(f"{member.filename}: its header says shape {shape} of {dtype}, but it holds {len(rest)} bytes")
    return np.frombuffer(rest, dtype).reshape(shape, order="F" if fortran_order else "C").copy()


def check_name(name: str) -> None:
    """Refuse a name that a file or folder cannot have on every system, or that would break the line it is printed in.

    Raises
    ------
    ValueError
        When the name is refused; the message says why.
    """
    if not name or len(name) > _LONGEST_NAME:
        raise ValueError(f"{one_line(name, repr)}: a name has 1 to {_LONGEST_NAME} characters")
    if not name.isprintable() or set(name) & set('<>:"/\\|?*'):
        raise ValueError(f"{one_line(name, repr)}: holds characters that names of files cannot have on every system")
    if name[0] in ". " or name[-1] in ". ":
        raise ValueError(f"{name!r}: begins or ends with a dot or a space, which Windows drops")
    if name.split(".")[0].rstrip().upper() in _RESERVED:
        raise ValueError(f"{name!r}: Windows reserves this name for a device; choose another")


def check_folder(folder: Path) -> None:
    """Raise a NotADirectoryError if ``folder``, or one that it lies in, is a file. Nothing is created.

    Its ``strerror`` says which one is a file: the system's own "File exists" does not say what is wrong with that.
    """
    for place in (folder, *folder.parents):
        if os.path.lexists(place) and not place.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, f"{one_line(place)} is a file, not a folder", str(folder))


def make_folder(folder: Path) -> None:
    """Create a folder, and those that it lies in, if they are missing; raise the OSError of `check_folder`, or the system's."""
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)


def check_writable(folder: Path) -> None:
    """Create ``folder`` if it is missing, and raise the OSError that writing into it would raise, before any work is done."""
    make_folder(folder)
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        error.filename = str(folder)  # the user does not know the name of the temporary file
        raise


def check_file_writable(path: Path) -> None:
    """Create the folder of a file if it is missing, and raise the OSError that writing the file would raise."""
    check_writable(path.absolute().parent)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))


def write_atomic(path: Path, content: bytes) -> None:
    """Write a file atomically: if this is interrupted, the file holds either all of ``content`` or what it held before."""
    write_together({path: content})


def write_together(contents: Mapping[Path, bytes]) -> None:
    """Write files atomically; none of them takes its place before all of them are on the disk.

    The files of one folder take their places together, even if the process is killed: see `moved_together`.
    """
    folders = {path: path.parent for path in contents}
    for path, parent in folders.items():
        make_folder(parent)
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
    """Move folders to their places (the keys of ``new``), which may hold older ones: all of them, or none if one fails.

    All places are in one parent folder. Several processes may do this at the same time: in the end the places hold the
    complete folders of one of them.
    """
    (parent,) = {place.parent for place in new}
    with moved_together(parent) as staging:
        for place in new:
            if place.exists() and not os.access(place, os.W_OK):  # it could be moved away, but then not deleted
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


# New content is first collected in a staging folder beside the places that it will take. When it is complete, one rename
# turns the staging folder into a promise: if the process is killed before it has moved everything to its place, the next
# process that writes into the parent folder completes the move.
_STAGING, _PROMISE, _OLD = ".uavbench-new-", ".uavbench-ready-", ".uavbench-old-"


@contextlib.contextmanager
def moved_together(parent: Path) -> Generator[Path]:
    """Yield a staging folder in ``parent``; after the block its content is moved to ``parent``, either all of it or nothing.

    A process that is killed leaves either the old content of ``parent``, or an incomplete move that `finish_moves` completes.
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
    """Complete a move that a killed process left incomplete in ``parent``; if that fails, the old content stays in place."""
    with contextlib.suppress(OSError):
        if any(parent.glob(f"{_PROMISE}*")):
            with _alone_in(parent) as alone:
                _finish(parent, alone)


def _finish(parent: Path, alone: bool) -> None:
    """Complete the moves that killed processes have promised, and delete what they had not promised yet."""
    for promise in sorted(parent.glob(f"{_PROMISE}*")):
        _keep(promise)
    if alone:  # otherwise another process may still use these folders
        for left in [*parent.glob(f"{_STAGING}*"), *parent.glob(f"{_OLD}*")]:
            shutil.rmtree(left, ignore_errors=True)


def _keep(promise: Path) -> None:
    """Move the content of the folder ``promise`` to its place in the parent; if that fails, move everything back."""
    parent = promise.parent
    old = Path(tempfile.mkdtemp(prefix=_OLD, dir=parent))
    made = sorted(promise.iterdir())
    moved: list[Path] = []
    try:
        for each in made:
            place = parent / each.name
            if place.is_dir():
                place.replace(old / each.name)
            elif place.exists() and len(made) > 1:  # a file is copied, not moved away, so that it exists at any time
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
    """Wait until no other process moves things in ``folder``; yield whether the system could guarantee that.

    The lock is on the folder itself and ends with the process, so a killed process leaves no lock behind. Windows and some
    network drives have no such lock: there, processes that write the same names at the same time may disturb each other.
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
