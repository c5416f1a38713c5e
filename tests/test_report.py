"""Reports: tables and figures of results that belong together, and none of damaged ones."""

import json
import os
import shutil
from dataclasses import asdict

import numpy as np
import pandas as pd
import pytest
from commands import damaged, renamed, uavbench_command
from PIL import Image

from uavbench import report
from uavbench.results import COLUMNS, load_result


def test_reports_hold_the_scores_and_the_figures(pictured, tmp_path):
    pair = [pictured[agent, "Block8-DH-v0"] for agent in ("greedy", "random")]
    told = uavbench_command("report", *(result.folder for result in pair), "--out", tmp_path / "r")
    assert told.exit_code == 0, told.output
    table = pd.read_csv(tmp_path / "r" / "comparison.csv")
    for (_, row), result in zip(table.iterrows(), pair, strict=True):
        assert row["agent"] == result.summary["agent"]
        assert (row["cral"], row["cral_low"], row["cral_high"]) == pytest.approx(tuple(asdict(result.metrics["cral"]).values()))
        assert row["steps"] == pytest.approx(result.episodes()["steps"].mean())
    difference = pair[1].metrics["cral"].mean - pair[0].metrics["cral"].mean
    assert table["cral_difference"][1] == pytest.approx(difference)
    text = (tmp_path / "r" / "comparison.md").read_text(encoding="utf-8")
    assert text.startswith("Block8-DH-v0, test split, 60 episodes; in %")
    assert text.count("|") == 4 * 7
    assert f"| {100 * difference:+.1f} [".replace("-", "−") in text
    latex = (tmp_path / "r" / "comparison.tex").read_text(encoding="utf-8")
    assert r"\begin{tabular}{lrrrrr}" in latex
    assert f"& {100 * abs(pair[0].metrics['cral'].mean):.1f} [" in latex
    assert "-" not in latex.split("hline", 1)[1].replace("$-$", "")
    figures = ("cral_against_budget", "cr_against_targets", "failures_against_budget", "performance_profiles")
    for name in figures:
        with Image.open(tmp_path / "r" / f"{name}.png") as picture:
            assert len(np.unique(np.asarray(picture.convert("L")))) > 20
        assert (tmp_path / "r" / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_results_of_different_episodes_are_not_reported_together(pictured, tmp_path):
    told = uavbench_command(
        "report", pictured["greedy", "Block8-CPP-v0"].folder, pictured["random", "Block8-DH-v0"].folder, "--out", tmp_path / "r"
    )
    assert told.exit_code == 2
    assert "cannot compare: scenario" in told.output
    assert not (tmp_path / "r").exists()


def test_names_are_shown_as_they_are(pictured, tmp_path):
    """Though TeX, Matplotlib and the terminal would read something else in them."""
    first = renamed(pictured["greedy", "Block8-DH-v0"], tmp_path / "first", "_my$foo$ {x}~^[b]")
    other = pictured["random", "Block8-DH-v0"].folder
    told = uavbench_command("report", first, other, "--out", tmp_path / "r")
    assert told.exit_code == 0, told.output
    expected = r"\_my\$foo\$ \{x\}\textasciitilde{}\textasciicircum{}[b] & "
    assert expected in (tmp_path / "r" / "comparison.tex").read_text(encoding="utf-8")
    told = uavbench_command("compare", first, other)
    assert (told.exit_code, "_my$foo$ {x}~^[b]" in told.output) == (0, True), told.output


def test_an_agent_whose_name_begins_with_an_underscore_is_in_the_legend(pictured, tmp_path):
    folder = renamed(pictured["greedy", "Block8-DH-v0"], tmp_path / "first", "_mine")
    compared = report._compare([load_result(folder)], None)
    (legend,) = [axes.get_legend() for axes in report._cral_against_budget(compared).axes]
    assert [text.get_text().strip() for text in legend.get_texts()] == ["_mine"]


def test_a_file_that_never_ends_is_not_waited_for(pictured, tmp_path):
    folder = shutil.copytree(pictured["greedy", "Block8-DH-v0"].folder, tmp_path / "greedy")
    for name in ("summary.json", "episodes.csv", "actions.npz"):
        content = (folder / name).read_bytes()
        (folder / name).unlink()
        os.mkfifo(folder / name)
        told = uavbench_command("report", folder, "--out", tmp_path / "r")
        assert (told.exit_code, f"{name}: is not a plain file" in told.output) == (2, True), told.output
        (folder / name).unlink()
        (folder / name).write_bytes(content)


def first_cr(value):
    """Return a change of the first episode's CR."""

    def change(text):
        head, first, *lines = text.splitlines()
        cells = first.split(",")
        cells[list(COLUMNS).index("cr")] = value
        return "\n".join([head, ",".join(cells), *lines])

    return change


def mean_cral(text):
    """Change the mean CRAL that a summary says."""
    summary = json.loads(text)
    summary["metrics"]["cral"]["mean"] = 0.99
    return json.dumps(summary)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"summary_json": lambda text: text.replace('"test"', '"exam"')}, "exam"),
        ({"summary_json": lambda text: text.replace('"scenario_digest": "', '"scenario_digest": "f')}, "another Block8-DH-v0"),
        ({"episodes_csv": lambda text: "\n".join(text.splitlines()[:20])}, "does not hold the 60 episodes"),
        ({"episodes_csv": lambda text: text[:2000] + "x" + text[2000:]}, "damaged"),
        ({"episodes_csv": first_cr("nan")}, "episode 0: cr is nan, which is not in [0, 1]"),
        ({"episodes_csv": first_cr("7.0")}, "episode 0: cr is 7, which is not in [0, 1]"),
        ({"episodes_csv": lambda text: text.splitlines()[0]}, "does not hold the 60 episodes"),
    ],
)
def test_nothing_is_reported_of_a_damaged_result(pictured, tmp_path, changes, message):
    folder = damaged(pictured["greedy", "Block8-DH-v0"], tmp_path / "greedy", **changes)
    told = uavbench_command("report", folder, "--out", tmp_path / "r")
    assert (told.exit_code, message in told.output) == (2, True), told.output
    assert not (tmp_path / "r").exists()
    if "summary_json" in changes:
        for command in ("plot", "film"):
            told = uavbench_command(command, folder, "--out", tmp_path / ("a.png" if command == "plot" else "a.gif"))
            assert (told.exit_code, message in told.output) == (2, True), told.output
    assert [path.name for path in tmp_path.iterdir()] == ["greedy"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (mean_cral, "summary.json: metrics.cral: mean is 0.99, in episodes.csv 0."),
        (lambda text: text.replace('"episodes": 60', '"episodes": 0'), "episodes: there are none"),
        (lambda text: '{"a": ' + "[" * 100_000, "not a summary"),
    ],
)
def test_a_summary_that_cannot_be_is_not_reported(pictured, tmp_path, change, message):
    folder = damaged(pictured["greedy", "Block8-DH-v0"], tmp_path / "greedy", summary_json=change)
    told = uavbench_command("report", folder, "--out", tmp_path / "r")
    assert (told.exit_code, message in told.output) == (2, True), told.output
    assert not (tmp_path / "r").exists()


def test_agents_of_one_name_are_told_apart(pictured, tmp_path):
    folder, random = pictured["greedy", "Block8-DH-v0"].folder, pictured["random", "Block8-DH-v0"].folder
    shutil.copytree(folder, tmp_path / "a" / "greedy")
    shutil.copytree(folder, tmp_path / "b" / "greedy")
    told = uavbench_command("report", tmp_path / "a" / "greedy", random, tmp_path / "b" / "greedy", "--out", tmp_path / "r")
    assert told.exit_code == 0, told.output
    assert pd.read_csv(tmp_path / "r" / "comparison.csv")["agent"].tolist() == ["a/greedy", "random", "b/greedy"]
    told = uavbench_command("report", folder, folder, "--out", tmp_path / "r")
    assert (told.exit_code, "given twice" in told.output) == (2, True)
