"""Cells that nobody's spreadsheet runs."""

import pytest

from uavbench.evaluation.spreadsheet import plain_cell


@pytest.mark.parametrize("sign", ["=", "+", "-", "@", "＝", "＋", "－", "＠"])
@pytest.mark.parametrize("before", ["", " ", '"', "x;", "x; ", "x\t", "x,", "x|"])
def test_no_cell_begins_a_formula(before, sign):
    assert plain_cell(f"{before}{sign}cmd()") == f"{before}'{sign}cmd()"


@pytest.mark.parametrize("text", ["", "A. Author", "山田 太郎; B", "lr 1e-3, 2 × 10", "https://x.org/?a=b", "a-b+c"])
def test_plain_text_stays_as_it_is(text):
    assert plain_cell(text) == text
