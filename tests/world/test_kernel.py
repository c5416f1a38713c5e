"""The cache of compiled code never stops a program: another folder, none, or compiled again, with one line that says so.

Each test runs a tiny kernel in processes of its own, with a copy of the one module that makes kernels.
"""

import os
import shutil
import subprocess
import sys

import pytest

import uavbench.world.kernel

PROGRAM = """
from uavbench.world.kernel import kernel

@kernel
def twice(x):
    return 2 * x

print(twice(21), sum(twice.stats.cache_hits.values()))
"""


@pytest.fixture
def package(tmp_path):
    """A package that is called uavbench and holds the decorator alone."""
    folder = tmp_path / "site" / "uavbench"
    (folder / "world").mkdir(parents=True)
    (folder / "__init__.py").touch()
    (folder / "world" / "__init__.py").touch()
    shutil.copy(uavbench.world.kernel.__file__, folder / "world")
    (tmp_path / "program.py").write_text(PROGRAM)
    (tmp_path / "tmp").mkdir()
    return folder


def fly(package, **environment):
    """Run the program; return what it prints and the lines of stderr."""
    where = package.parent.parent
    known = {
        "PATH": os.environ["PATH"],
        "PYTHONPATH": str(package.parent),
        "TMPDIR": str(where / "tmp"),
        "HOME": str(where / "home"),
    }
    given = {name: value for name, value in {**known, **environment}.items() if value is not None}
    done = subprocess.run(
        [sys.executable, str(where / "program.py")],
        cwd=where,
        env=given,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, (done.returncode, done.stderr)
    return done.stdout.strip(), done.stderr.splitlines()


def blocked(folder):
    """Put a file where a folder would be: not even root can write below it."""
    folder.write_text("")
    return folder


def test_code_is_cached_in_the_package(package):
    assert fly(package) == ("42 0", [])
    assert fly(package) == ("42 1", [])
    assert list((package / "__pycache__").glob("kernels-*/*/*.nbc"))


def test_else_in_the_users_cache_and_else_in_a_temporary_folder_of_his_own(package):
    blocked(package / "__pycache__")
    home = package.parent.parent / "home"
    assert fly(package) == ("42 0", [])
    assert fly(package) == ("42 1", [])
    shutil.rmtree(home)
    blocked(home)
    printed, said = fly(package)
    assert (printed, len(said), "is cached in" in said[0]) == ("42 0", 1, True)
    assert fly(package)[0] == "42 1"
    (own,) = (package.parent.parent / "tmp").iterdir()
    assert own.stat().st_mode & 0o777 == 0o700


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows gives each user a folder")
def test_a_temporary_folder_that_others_can_write_is_not_used(package):
    blocked(package / "__pycache__")
    blocked(package.parent.parent / "home")
    own = package.parent.parent / "tmp" / f"uavbench-{os.getuid()}"
    own.mkdir()
    own.chmod(0o777)
    printed, said = fly(package)
    assert (printed, len(said), "every start compiles anew" in said[0]) == ("42 0", 1, True)
    assert list(own.iterdir()) == []


def test_a_folder_that_the_user_names_and_that_cannot_be_written_is_passed_over(package):
    named = blocked(package.parent.parent / "named")
    printed, said = fly(package, NUMBA_CACHE_DIR=str(named / "below"))
    assert (printed, len(said), str(named) in said[0]) == ("42 0", 1, True)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows knows its users")
def test_an_unknown_user_without_a_home_is_no_obstacle(package):
    """As in a container that runs under some number: the system's table of users does not have it."""
    blocked(package / "__pycache__")
    unknown = "import pwd\ndef unknown(uid):\n    raise KeyError(uid)\npwd.getpwuid = unknown\n"
    (package.parent.parent / "program.py").write_text(unknown + PROGRAM)
    printed, said = fly(package, HOME=None)
    assert (printed, len(said), "is cached in" in said[0]) == ("42 0", 1, True)


def test_a_full_disk_leaves_code_uncached(package):
    program = package.parent.parent / "program.py"
    pytest.importorskip("resource")
    limit = "import resource, signal\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
    program.write_text(limit + "resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))\n" + PROGRAM)
    printed, said = fly(package)
    assert (printed, len(said), "not cached" in said[0]) == ("42 0", 1, True)


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", [lambda c: b"", lambda c: c[: len(c) // 2], lambda c: c[:-40] + b"\0" + c[-39:]])
def test_a_damaged_cache_is_compiled_again(package, ending, damage):
    fly(package)
    (path,) = (package / "__pycache__").rglob(f"*.{ending}")
    path.write_bytes(damage(path.read_bytes()))
    printed, said = fly(package)
    assert (printed, len(said), "is damaged: compiled again" in said[0]) == ("42 0", 1, True)
    assert fly(package) == ("42 1", [])
