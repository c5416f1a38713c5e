"""Figures are the same whatever a user has set Matplotlib to, and show names in any script."""

import io
import os
import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
from commands import renamed, uavbench_command
from fontTools.fontBuilder import FontBuilder
from fontTools.pens.ttGlyphPen import TTGlyphPen
from matplotlib import font_manager

from uavbench.pictures.figures import Figure, fixed_style

HOSTILE = """
text.usetex: True
font.size: 31
font.family: monospace
axes.facecolor: black
axes.titlesize: 40
savefig.bbox: tight
savefig.facecolor: red
savefig.transparent: True
figure.constrained_layout.use: True
lines.linewidth: 9
legend.fontsize: 30
backend: module://matplotlib_inline.backend_inline
"""
DRAW = """
import sys
from uavbench.cli.app import app
first, second, out = sys.argv[1:]
app(["plot", first, "--episode", "3", "--out", f"{out}/plot.png"], standalone_mode=False)
app(["report", first, second, "--out", out], standalone_mode=False)
"""


def drawn(folders, out, **changes):
    """The PNGs that the commands draw in a process of their own."""
    out.mkdir()
    kept = {name: value for name, value in os.environ.items() if name not in ("MATPLOTLIBRC", "MPLBACKEND")}
    told = subprocess.run(
        [sys.executable, "-c", DRAW, *map(str, folders), str(out)],
        env=kept | changes,
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stderr
    return {path.name: path.read_bytes() for path in out.glob("*.png")}


@pytest.mark.slow
def test_figures_do_not_depend_on_what_matplotlib_is_set_to(pictured, tmp_path):
    folders = [pictured[agent, "Block8-DH-v0"].folder for agent in ("greedy", "random")]
    (tmp_path / "matplotlibrc").write_text(HOSTILE, encoding="utf-8")
    plain = drawn(folders, tmp_path / "plain")
    assert len(plain) == 5
    changes = {"MATPLOTLIBRC": str(tmp_path / "matplotlibrc"), "MPLBACKEND": "module://of.a.notebook"}
    assert drawn(folders, tmp_path / "hostile", **changes) == plain


@pytest.mark.parametrize("backend", ["module://matplotlib_inline.backend_inline", "no such backend"])
def test_a_backend_that_is_not_installed_is_not_needed(backend):
    code = "import os, uavbench.pictures.plot, matplotlib.pyplot; print(os.environ['MPLBACKEND'])"
    told = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"MPLBACKEND": backend}, capture_output=True, text=True, check=False
    )
    assert (told.stdout.strip(), told.returncode) == (backend, 0), told.stderr


def test_what_a_user_has_set_stays_set(pictured, tmp_path):
    with mpl.rc_context({"font.size": 31, "lines.linewidth": 9, "text.usetex": True}):
        before = dict(mpl.rcParams)
        told = uavbench_command("plot", pictured["greedy", "Block8-CPP-v0"].folder, "--out", tmp_path / "a.png")
        assert told.exit_code == 0, told.output
        assert dict(mpl.rcParams) == before


@pytest.mark.parametrize("name", ["飛行 エージェント", "비행", "\U0001f681", "טייס"])
def test_a_name_without_a_font_is_no_error(pictured, tmp_path, name):
    first = renamed(pictured["greedy", "Block8-DH-v0"], tmp_path / "first", name)
    told = uavbench_command("report", first, pictured["random", "Block8-DH-v0"].folder, "--out", tmp_path / "r")
    assert told.exit_code == 0, told.output
    assert uavbench_command("plot", first, "--out", tmp_path / "a.png").exit_code == 0


def test_letters_are_taken_from_a_font_that_has_them(tmp_path, monkeypatch):
    """One that is made here has 飛 as a full square."""
    pen = TTGlyphPen(None)
    for k, corner in enumerate([(0, 0), (0, 800), (800, 800), (800, 0)]):
        pen.lineTo(corner) if k else pen.moveTo(corner)
    pen.closePath()
    square = pen.glyph()
    builder = FontBuilder(1000, isTTF=True)
    builder.setupGlyphOrder([".notdef", "square"])
    builder.setupCharacterMap({ord("飛"): "square"})
    builder.setupGlyf({".notdef": TTGlyphPen(None).glyph(), "square": square})
    builder.setupHorizontalMetrics({".notdef": (1000, 0), "square": (1000, 0)})
    builder.setupHorizontalHeader(ascent=800, descent=-200)
    builder.setupNameTable({"familyName": "Squares", "styleName": "Regular"})
    builder.setupOS2()
    builder.setupPost()
    builder.save(tmp_path / "squares.ttf")
    monkeypatch.setattr(font_manager.fontManager, "ttflist", [*font_manager.fontManager.ttflist])
    ink = []
    for known in (False, True):
        if known:
            font_manager.fontManager.addfont(str(tmp_path / "squares.ttf"))
        with fixed_style("飛"):
            figure = Figure(figsize=(1, 1))
            figure.text(0.2, 0.2, "飛", fontsize=40)
            buffer = io.BytesIO()
            figure.savefig(buffer, format="raw", dpi=100)
        ink.append((np.frombuffer(buffer.getvalue(), dtype=np.uint8).reshape(100, 100, 4)[:, :, 0] < 128).sum())
    assert ink[1] > 1.5 * ink[0]  # a box before
    assert ink[1] == pytest.approx((0.8 * 40 / 72 * 100) ** 2, rel=0.1)
