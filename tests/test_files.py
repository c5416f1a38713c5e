"""Files of arrays: read back as written, and nothing else is read."""

import io
import zipfile

import numpy as np
import pytest

from uavbench.files import pack_arrays, unpack_arrays, write_whole

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


def archive(members, compression=zipfile.ZIP_DEFLATED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as table:
        for name, content in members:
            table.writestr(name, content)
    return buffer.getvalue()


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


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "not an .npz"),
        (b"PK junk", "not an .npz"),
        (npy(ARRAYS["a"]), "not an .npz"),
        (pack_arrays(ARRAYS)[:-40], "not an .npz"),
        (archive([("a.npy", npy(np.array([{}], dtype=object)))]), "objects"),
        (archive([("a.npy", npy(np.zeros(2, dtype=[("x", "u1")])))]), "objects"),
        (archive([("a.npy", b"junk")]), "magic"),
        (archive([("../a.npy", npy(ARRAYS["a"]))]), "plainly"),
        (archive([("/etc/a.npy", npy(ARRAYS["a"]))]), "plainly"),
        (archive([("a.npy", npy(ARRAYS["a"]))], zipfile.ZIP_LZMA), "compressed"),
        (archive([("a.npy", npy(header={"descr": "|u1", "fortran_order": False, "shape": (-6,)}, rest=b"123456"))]), "shape"),
        (archive([("a.npy", npy(header={"descr": "|u1", "fortran_order": False, "shape": (10**15,)}, rest=b"1"))]), "shape"),
        (archive([("a.npy", npy(header={"descr": "|u1", "fortran_order": False, "shape": (2**62, 4)}, rest=b""))]), "shape"),
        (archive([("a.npy", npy(np.zeros(2**28 + 1, dtype=np.uint8)))]), "256 MB"),
    ],
    ids=range(14),
)
def test_anything_else_is_refused(content, reason):
    with pytest.raises(ValueError, match=reason):
        unpack_arrays(content)


def test_a_name_twice_is_refused():
    with pytest.warns(UserWarning, match="Duplicate"):
        content = archive([("a.npy", npy(ARRAYS["a"])), ("a.npy", npy(ARRAYS["a"]))])
    with pytest.raises(ValueError, match="each once"):
        unpack_arrays(content)


def test_a_size_that_lies_unpacks_no_more_than_it_says():
    content = bytearray(archive([("a.npy", npy(np.zeros(10**6, dtype=np.uint8)))]))
    size = (10**6 + 128).to_bytes(4, "little")
    while size in content:
        at = content.index(size)
        content[at : at + 4] = (1000).to_bytes(4, "little")
    with pytest.raises(ValueError, match=r"not an \.npz|holds"):
        unpack_arrays(bytes(content))


def test_a_file_is_written_whole_or_stays_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "new" / "file"
    write_whole(path, b"old")
    monkeypatch.setattr("os.fsync", lambda handle: (_ for _ in ()).throw(OSError("the disk is full")))
    with pytest.raises(OSError, match="full"):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert [each.name for each in path.parent.iterdir()] == ["file"]
