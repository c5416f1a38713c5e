"""What is in the wheel: everything that an installation needs, and nothing else."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("build", reason="the wheel is built with build: pip install 'uavbench[dev]'")
pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
#: Folders of the repository, and what they are called in a wheel.
FOLDERS = {"uavbench": "uavbench", "scenarios": "uavbench/scenarios", "baselines": "uavbench/baselines"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The names of the files in a wheel that is built now, with their sizes."""
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--wheel", "--outdir", out, ROOT]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert done.returncode == 0, done.stdout
    (path,) = out.glob("*.whl")
    with zipfile.ZipFile(path) as file:
        names = file.namelist()
        assert len(names) == len(set(names))
        return {member.filename: member.file_size for member in file.infolist()}


def files(folder, pattern="**/*"):
    """Return the names in a wheel, with their sizes, of files in a folder of the repository; compiled code is not meant."""
    found = [path for path in (ROOT / folder).glob(pattern) if path.is_file() and "__pycache__" not in path.parts]
    return {f"{FOLDERS[folder]}/{path.relative_to(ROOT / folder).as_posix()}": path.stat().st_size for path in found}


@pytest.mark.parametrize(
    ("folder", "pattern", "least"),
    [
        ("uavbench", "**/*.py", 60),
        ("uavbench", "py.typed", 1),
        ("uavbench", "agents/templates/*.py", 1),
        ("uavbench", "leaderboard/page/*.html", 1),
        ("uavbench", "leaderboard/page/*.css", 1),
        ("uavbench", "leaderboard/page/*.js", 4),
        ("scenarios", "*.toml", 18),
        ("scenarios", "maps/*.txt", 5),
        ("scenarios", "maps/NOTICE-OpenStreetMap.md", 1),
        ("scenarios", "episodes/*.npz", 36),
        ("scenarios", "reference/*.csv", 4),
        ("baselines", "*.py", 8),
        ("baselines", "earlier.toml", 1),
        ("baselines", "weights/*.safetensors", 6),
    ],
)
def test_it_holds(wheel, folder, pattern, least):
    expected = files(folder, pattern)
    assert len(expected) >= least
    assert expected.items() <= wheel.items()


def test_it_holds_nothing_else(wheel):
    own = {name for folder in FOLDERS for name in files(folder)}
    about = {name for name in wheel if name.split("/")[0].endswith(".dist-info")}
    assert wheel.keys() - about == own
    assert {name.split("/", 1)[1] for name in about} >= {"METADATA", "RECORD", "entry_points.txt", "licenses/LICENSE"}
    assert not [name for name in wheel if "test" in Path(name).name.split(".")[0].split("_") or "tests" in Path(name).parts]
