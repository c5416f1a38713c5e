"""Files and options that anybody made are taken or refused, and nothing else happens."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).parent / "fuzz.py"
NEEDS = {
    **dict.fromkeys(("geojson", "osm", "pbf"), ("osmium", "shapely", "pyproj")),
    "weights": ("safetensors",),
    "model": ("onnx", "onnxruntime"),
}
NAMES = (
    "scenario",
    "map",
    "picture",
    "geojson",
    "osm",
    "manifest",
    "actions",
    "episodes",
    "best_known",
    "best_known_actions",
    "flown",
    "records",
    "weights",
    "model",
    "options",
)


@pytest.fixture
def fed(monkeypatch):
    monkeypatch.syspath_prepend(str(FUZZ.parent))
    yield importlib.import_module("fuzz").fed
    for name in ("fuzz", "readers", "changes"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("name", NAMES)
def test_a_few_changed_inputs(name, fed):
    for library in NEEDS.get(name, ()):
        pytest.importorskip(library)
    feed = fed(name, 15)
    feed()
    assert len(feed.taken) >= 15


def test_what_is_no_refusal_is_found(fed, monkeypatch):
    readers = importlib.import_module("readers")

    def read(content, folder):
        if b"budget" not in content:
            raise KeyError("budget")

    monkeypatch.setitem(readers.READERS, "options", readers.Reader(read, lambda folder: [b"'budget'"]))
    with pytest.raises(KeyError):
        fed("options", 50)()


@pytest.mark.slow
def test_two_thousand_changed_inputs():
    for library in {library for libraries in NEEDS.values() for library in libraries}:
        pytest.importorskip(library)
    told = subprocess.run([sys.executable, FUZZ, "--inputs", "2000"], capture_output=True, text=True, timeout=1800, check=False)
    assert told.returncode == 0, told.stdout + told.stderr[-3000:]
    assert told.stdout.count(" inputs, ") == len(NAMES) + 1


@pytest.mark.slow
def test_atheris_looks_for_inputs_too():
    pytest.importorskip("atheris", reason="needs atheris: pip install 'uavbench[fuzz]'")
    words = [sys.executable, FUZZ, "--atheris", "map", "-runs=500"]
    told = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    assert told.returncode == 0, told.stderr[-3000:]
    assert "Done 500 runs" in told.stderr
