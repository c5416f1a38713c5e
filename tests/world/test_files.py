"""Files of arrays: read back as written, and nothing else is read."""

import hashlib
import io
import re
import struct
import subprocess
import sys
import tracemalloc
import zipfile

import numpy as np
import pytest

from uavbench.world.files import (
    check_name,
    check_writable,
    finish_moves,
    pack_arrays,
    replace_folders,
    unpack_arrays,
    write_atomic,
    write_together,
)

ARRAYS = {"a": np.arange(6, dtype=np.uint8).reshape(2, 3), "b": np.array([1.5, np.inf]), "c": np.zeros((0, 4), dtype=np.int64)}


def npy(array=None, header=None, rest=b""):
    """An .npy member; with a header of one's own, if wanted."""
    buffer = io.BytesIO()
    if header is None:
        np.save(buffer, array, allow_pickle=True)
    else:
        np.lib.format.write_array_header_1_0(buffer, header)
        buffer.write(rest)
    return buffer.getvalue()


def header_of(text):
    return np.lib.format.magic(1, 0) + len(text).to_bytes(2, "little") + text


def archive(members, compression=zipfile.ZIP_DEFLATED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as table:
        for name, content in members:
            table.writestr(name, content)
    return buffer.getvalue()


def far_away():
    """An archive whose directory says that its array is 2^63 bytes from the start."""
    content = archive([("a.npy", npy(ARRAYS["a"]))])
    at, end = content.index(b"PK\x01\x02"), content.index(b"PK\x05\x06")
    entry, tail = bytearray(content[at:end]), bytearray(content[end:])
    entry += struct.pack("<HHQ", 1, 8, 2**63)
    entry[30:32], entry[42:46], tail[12:16] = struct.pack("<H", 12), b"\xff" * 4, struct.pack("<I", len(entry))
    return content[:at] + entry + tail


@pytest.mark.parametrize("compress", [True, False])
def test_arrays_come_back_as_they_were(compress):
    found = unpack_arrays(pack_arrays(ARRAYS, compress=compress))
    assert found.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert found[name].dtype == array.dtype
        assert np.array_equal(found[name], array)
        assert found[name].flags.writeable
    fortran = archive([("f.npy", npy(np.asfortranarray(ARRAYS["a"])))])
    assert np.array_equal(unpack_arrays(fortran)["f"], ARRAYS["a"])


def as_in_numpy_2_0(save):
    """NumPy 2.0 and 2.1 take the keyword ``allow_pickle`` for an array of that name, and store it."""

    def old_save(file, **arrays):
        strange = {f"{name}_": np.asarray(value) for name, value in arrays.items() if name == "allow_pickle"}
        save(file, **strange, **{name: value for name, value in arrays.items() if name != "allow_pickle"})

    return old_save


@pytest.mark.parametrize("compress", [True, False])
def test_a_file_holds_the_arrays_given_and_no_other(compress, monkeypatch):
    for name in ("savez", "savez_compressed"):
        monkeypatch.setattr(np, name, as_in_numpy_2_0(getattr(np, name)))
    with zipfile.ZipFile(io.BytesIO(pack_arrays(ARRAYS, compress=compress))) as table:
        assert table.namelist() == ["a.npy", "b.npy", "c.npy"]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "not an .npz"),
        (b"PK junk", "not an .npz"),
        (npy(ARRAYS["a"]), "not an .npz"),
        (pack_arrays(ARRAYS)[:-40], "not an .npz"),
        (far_away(), "not an .npz"),
        (archive([("a.npy", npy(np.array([{}], dtype=object)))]), "objects"),
        (archive([("a.npy", npy(np.zeros(2, dtype=[("x", "u1")])))]), "objects"),
        (archive([("a.npy", b"junk")]), "magic"),
        (archive([("../a.npy", npy(ARRAYS["a"]))]), "unique identifiers"),
        (archive([("/etc/a.npy", npy(ARRAYS["a"]))]), "unique identifiers"),
        (archive([("a.npy", npy(ARRAYS["a"]))], zipfile.ZIP_LZMA), "compressed"),
        (archive([("a.npy", npy(header={"descr": "|u1", "fortran_order": False, "shape": (-6,)}, rest=b"123456"))]), "shape"),
        (archive([("a.npy", npy(header={"descr": "|u1", "fortran_order": False, "shape": (10**15,)}, rest=b"1"))]), "shape"),
        (archive([("a.npy", npy(header={"descr": "|u1", "fortran_order": False, "shape": (2**62, 4)}, rest=b""))]), "shape"),
        (archive([("a.npy", npy(np.zeros(2**28 + 1, dtype=np.uint8)))]), "256 MB"),
        (archive([("a.npy", header_of(b"{'descr': '|u1', (((("))]), "header"),
        (archive([("a.npy", header_of(b"-" * 9000))]), "header"),
        (archive([("a.npy", header_of(b"[" * 9000))]), "header"),
    ],
    ids=range(18),
)
def test_anything_else_is_refused(content, reason):
    with pytest.raises(ValueError, match=reason):
        unpack_arrays(content)


def test_objects_are_not_written():
    with pytest.raises(ValueError, match="things: holds objects"):
        pack_arrays({"things": np.array([{}], dtype=object)})


def test_bytes_do_not_depend_on_the_version_of_numpy():
    """The digests of frozen files are over these bytes."""
    digest = hashlib.sha256(pack_arrays(ARRAYS)).hexdigest()
    assert digest == "2023ee93fa38254a55430e641a8cae48e791ca7227cd807f044c24a3954a4f7a"


def test_a_name_twice_is_refused():
    with pytest.warns(UserWarning, match="Duplicate"):
        content = archive([("a.npy", npy(ARRAYS["a"])), ("a.npy", npy(ARRAYS["a"]))])
    with pytest.raises(ValueError, match="unique identifiers"):
        unpack_arrays(content)


def test_a_size_that_lies_unpacks_no_more_than_it_says():
    content = bytearray(archive([("a.npy", npy(np.zeros(2**26, dtype=np.uint8)))]))
    size = (2**26 + 128).to_bytes(4, "little")
    while size in content:
        at = content.index(size)
        content[at : at + 4] = (1000).to_bytes(4, "little")
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"not an \.npz|holds"):
        unpack_arrays(bytes(content))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 2**21


def test_a_file_is_written_whole_or_stays_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "new" / "file"
    write_atomic(path, b"old")
    monkeypatch.setattr("os.fsync", lambda handle: (_ for _ in ()).throw(OSError("the disk is full")))
    with pytest.raises(OSError, match="full"):
        write_atomic(path, b"new")
    assert path.read_bytes() == b"old"
    assert [each.name for each in path.parent.iterdir()] == ["file"]


def test_files_are_written_together_or_none_is(tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    first.write_bytes(b"old")
    second.mkdir()
    with pytest.raises(IsADirectoryError, match=re.escape(str(second))):
        write_together({first: b"new", second: b"new"})
    assert first.read_bytes() == b"old"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a", "b"]


@pytest.mark.parametrize("use", [write_atomic, lambda path, _: check_writable(path.parent)])
@pytest.mark.parametrize("name", ["file/new", "file/folder/new"])
def test_a_file_in_the_place_of_a_folder_is_named(tmp_path, use, name):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(NotADirectoryError) as told:
        use(tmp_path / name, b"new")
    assert told.value.strerror == f"{tmp_path / 'file'} is a file, not a folder"
    assert (tmp_path / "file").read_text() == "mine"


def folder_of(path, text):
    path.mkdir()
    (path / "file").write_text(text)
    return path


def test_a_folder_takes_the_place_of_another(tmp_path):
    new, folder = folder_of(tmp_path / "new", "new"), folder_of(tmp_path / "folder", "old")
    folder_of(tmp_path / ".uavbench-old-x", "of a process that was killed after both moves")
    folder_of(tmp_path / ".uavbench-new-x", "of a process that was killed before all was there")
    replace_folders({folder: new})
    assert (folder / "file").read_text() == "new"
    assert [each.name for each in tmp_path.iterdir()] == ["folder"]


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_folders_are_replaced_together_or_none_is(tmp_path, monkeypatch, error):
    (tmp_path / "new").mkdir()
    places = {tmp_path / name: folder_of(tmp_path / "new" / name, "new") for name in ("first", "fresh", "last")}
    first, fresh, last = (folder_of(place, "old") if place.name != "fresh" else place for place in places)
    move = type(first).replace

    def interrupted(self, target):
        if self == places[last]:
            raise error
        return move(self, target)

    monkeypatch.setattr(type(first), "replace", interrupted)
    with pytest.raises(error):
        replace_folders(places)
    assert [(place / "file").read_text() for place in (first, last)] == ["old", "old"]
    assert not fresh.exists()
    assert [(made / "file").read_text() for made in places.values()] == ["new"] * 3
    assert sorted(each.name for each in tmp_path.iterdir()) == ["first", "last", "new"]


def test_a_folder_that_could_not_be_deleted_is_not_moved(tmp_path, monkeypatch):
    places = {tmp_path / name: folder_of(tmp_path / f"new {name}", "new") for name in ("first", "last")}
    first, last = (folder_of(place, "old") for place in places)
    monkeypatch.setattr("uavbench.world.files.os.access", lambda path, mode: path != last)  # root may do everything
    with pytest.raises(PermissionError, match=str(last)):
        replace_folders(places)
    assert [(place / "file").read_text() for place in (first, last)] == ["old", "old"]


KILLED = """
import os, sys
from pathlib import Path
from uavbench.world.files import replace_folders, write_together

moves, real, folder = int(sys.argv[2]), os.replace, Path(sys.argv[1])

def replace(*given):
    global moves
    moves -= 1
    if moves < 0:
        os._exit(9)
    return real(*given)

os.replace = os.rename = replace
if sys.argv[3] == "files":
    write_together({folder / name: b"new" for name in ("a", "b")})
else:
    replace_folders({folder / name: folder / "made" / name for name in ("a", "b", "c")})
"""


@pytest.mark.parametrize(("kind", "old", "new"), [("files", "ab", "ab"), ("folders", "ab", "abc")])
def test_a_kill_between_any_two_moves_leaves_all_old_or_what_becomes_all_new(tmp_path, kind, old, new):
    ends = []
    for moves in range(20):
        folder = tmp_path / str(moves)
        (folder / "made").mkdir(parents=True)
        for name in new:
            folder_of(folder / "made" / name, "new")
            if name in old and kind == "folders":
                folder_of(folder / name, "old")
            elif name in old:
                (folder / name).write_text("old")
        ends.append(subprocess.run([sys.executable, "-c", KILLED, folder, str(moves), kind], check=False).returncode)
        finish_moves(folder)
        texts = {
            name: (path / "file" if path.is_dir() else path).read_text() for name in "abc" if (path := folder / name).exists()
        }
        assert texts in (dict.fromkeys(old, "old"), dict.fromkeys(new, "new")), (moves, texts)
        if ends[-1] == 0:
            break
    assert (set(ends[:-1]), ends[-1], texts) == ({9}, 0, dict.fromkeys(new, "new"))
    write_atomic(tmp_path / "0" / "d", b"")  # the next one tidies up
    assert not list((tmp_path / "0").glob(".uavbench*"))


PUBLISHING = """
import sys, tempfile
from pathlib import Path
from uavbench.world.files import replace_folders, write_together

folder, mark = Path(sys.argv[1]), sys.argv[2]
for _ in range(40):
    with tempfile.TemporaryDirectory(dir=folder) as staging:
        for place in ("x", "y"):
            (Path(staging) / place).mkdir()
            (Path(staging) / place / "file").write_text(mark)
        replace_folders({folder / place: Path(staging) / place for place in ("x", "y")})
    write_together({folder / name: mark.encode() for name in ("a", "b")})
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no locks on folders")
def test_of_three_processes_that_publish_one_name_at_once_one_is_there_as_a_whole(tmp_path):
    processes = [subprocess.Popen([sys.executable, "-c", PUBLISHING, tmp_path, str(k)]) for k in range(3)]
    assert [process.wait() for process in processes] == [0, 0, 0]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "x", "y"]
    assert (tmp_path / "x" / "file").read_text() == (tmp_path / "y" / "file").read_text()
    assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text()


@pytest.mark.parametrize(
    "name",
    [
        *(
            "",
            "CON",
            "aux",
            "nul.txt",
            "Lpt1.agent.py",
            "com¹",
            "agent.",
            "agent ",
            " agent",
            ".agent",
            "a/b",
            "a:b",
            "a" * 101,
        ),
        "a\\b",
        "a\nb",
        "a\0b",
        "\u202ea",
    ],
)
def test_names_that_some_system_cannot_file_are_refused(name):
    with pytest.raises(ValueError, match=r"name|dot|characters") as caught:
        check_name(name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["agent", "my agent-2.1", "Console", "comb", "agents.One", "ünï", "飛行", "a" * 100])
def test_other_names_may_be_filed(name):
    check_name(name)
