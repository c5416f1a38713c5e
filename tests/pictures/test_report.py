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

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.results import COLUMNS, load_result
from uavbench.evaluation.run import run
from uavbench.pictures import report
from uavbench.pictures.report import write_report


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
    assert "-" not in latex.split("toprule", 1)[1].replace("$-$", "")
    rules = [line for line in latex.splitlines() if line in (r"\toprule", r"\midrule", r"\bottomrule")]
    assert rules == [r"\toprule", r"\midrule", r"\bottomrule"]
    assert r"% Needs \usepackage{booktabs}." in latex
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
    compared = report._compare([load_result(folder)], None, {})
    (legend,) = report._cral_against_budget(compared).legends
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
        (
            {"summary_json": lambda text: text.replace('"scenario_digest": "', '"scenario_digest": "f')},
            "another version of Block8-DH-v0",
        ),
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


def test_legends_hide_nothing(pictured, tmp_path):
    names = ["greedy", "a name of forty letters, or nearly so many", "c", "d"]
    folders = [renamed(pictured["greedy", "Block8-DH-v0"], tmp_path / str(k), name) for k, name in enumerate(names)]
    compared = report._compare([load_result(folder) for folder in folders], None, {})
    for draw in report._FIGURES.values():
        figure = draw(compared)
        figure.draw_without_rendering()
        (legend,), (axes,) = figure.legends, figure.axes
        assert axes.get_legend() is None
        box = legend.get_window_extent()
        assert not box.overlaps(axes.get_tightbbox())
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.x1


def test_failures_that_never_happened_are_no_slab(pictured, tmp_path):
    """Where all landed the figure says so; where only some did, the others have a line without a band."""
    landed, crashed = pictured["greedy", "Block8-DH-v0"], pictured["random", "Block8-DH-v0"]
    assert landed.metrics["landed"].mean == 1 > crashed.metrics["landed"].mean
    for results, texts, bands in (([landed], ["All agents landed in every episode."], 0), ([landed, crashed], [], 1)):
        (axes,) = report._failures_against_budget(report._compare(results, None, {})).axes
        assert [text.get_text() for text in axes.texts] == texts
        assert len(axes.collections) == bands
        assert len(axes.lines) == len(results)


# Groups of seeds.


@pytest.fixture
def seeds(pictured, tmp_path):
    """Results that pass for those of three seeds of one method, and a folder to write."""
    kinds = [pictured["greedy", "Block8-DH-v0"], pictured["random", "Block8-DH-v0"]]
    return [kinds[0].folder, kinds[1].folder, renamed(kinds[1], tmp_path / "third", "third")], tmp_path / "r"


def test_seeds_of_a_method_are_one_entry(seeds, pictured, tmp_path):
    folders, out = seeds
    plain = renamed(pictured["greedy", "Block8-DH-v0"], tmp_path / "plain", "plain")
    told = uavbench_command("report", plain, "--group", f"mine={','.join(map(str, folders))}", "--out", out)
    assert told.exit_code == 0, told.output
    table = pd.read_csv(out / "comparison.csv").set_index("agent")
    assert table["seeds"].to_dict() == {"plain": 1, "mine": 3}
    scores = [load_result(folder).episodes() for folder in folders]
    for name in ("landed", "cr", "cral"):
        means = [each[name].mean() for each in scores]
        assert table.loc["mine", name] == pytest.approx(np.mean(means))
        assert table.loc["mine", f"{name}_low"] < table.loc["mine", name] < table.loc["mine", f"{name}_high"]
        assert table.loc["mine", f"{name}_high"] - table.loc["mine", f"{name}_low"] > 0.1  # the seeds differ much
    assert table.loc["mine", "steps"] == pytest.approx(np.mean([each["steps"].mean() for each in scores]))
    assert table.loc["mine", "cral_difference"] == pytest.approx(table.loc["mine", "cral"] - table.loc["plain", "cral"])
    assert "| mine (3 seeds) | " in (out / "comparison.md").read_text(encoding="utf-8")


def test_a_group_of_one_seed_is_the_plain_result(pictured, tmp_path):
    greedy, random = (pictured[agent, "Block8-DH-v0"].folder for agent in ("greedy", "random"))
    for out, arguments in (
        ("plain", [greedy, random]),
        ("grouped", ["--group", f"greedy={greedy}", "--group", f"random={random}"]),
    ):
        assert uavbench_command("report", *arguments, "--out", tmp_path / out).exit_code == 0
    for path in (tmp_path / "plain").iterdir():
        if path.suffix != ".pdf":  # which tells the time
            assert path.read_bytes() == (tmp_path / "grouped" / path.name).read_bytes(), path.name


@pytest.mark.parametrize(
    ("group", "message"),
    [
        ("{0},{1}", "write NAME=RESULT,RESULT,…"),
        ("={0}", "write NAME=RESULT,RESULT,…"),
        ("mine=", "write NAME=RESULT,RESULT,…"),
        ("mine={0},", "write NAME=RESULT,RESULT,…"),
        ("mi\nne={0}", "write NAME=RESULT,RESULT,…"),
        ("mine={0},nowhere", "--group mine: nowhere/summary.json: there is no such file"),
        ("mine={0},{0}", "given twice"),
        ("third={0}", "--group third: a result has this name"),
        ("mine={0} --group mine={1}", "--group mine: given twice"),
    ],
)
def test_a_group_that_is_none_is_refused(seeds, group, message):
    folders, out = seeds
    words = [word for part in group.format(*folders).split(" --group ") for word in ("--group", part)]
    told = uavbench_command("report", folders[2], *words, "--out", out)
    assert (told.exit_code, "--group" in told.output or "given twice" in told.output, message in told.output) == (
        2,
        True,
        True,
    ), told.output
    assert not out.exists()


@pytest.mark.slow
def test_results_of_different_lengths_are_compared_on_what_all_have(pictured, tmp_path):
    greedy, random = pictured["greedy", "Block8-DH-v0"], pictured["random", "Block8-DH-v0"]
    short = run(Job(find_agent("random"), load_scenario("Block8-DH-v0"), "test"), 20, tmp_path / "short")
    write_report([greedy, short], tmp_path / "mixed")
    text = (tmp_path / "mixed" / "comparison.md").read_text()
    assert "20 episodes (of 60, those that all flew)" in text
    again = run(Job(find_agent("greedy"), load_scenario("Block8-DH-v0"), "test"), 20, tmp_path / "short")
    write_report([again, short], tmp_path / "short-report")
    rows = [(tmp_path / name / "comparison.csv").read_text() for name in ("mixed", "short-report")]
    assert rows[0] == rows[1]
    write_report([greedy, random], tmp_path / "whole")
    assert "those that all flew" not in (tmp_path / "whole" / "comparison.md").read_text()


def test_the_user_names_whom_the_others_are_compared_with(pictured, tmp_path):
    folders = [pictured[name, "Block8-DH-v0"].folder for name in ("random", "greedy")]
    told = uavbench_command("report", *folders, "--against", "greedy", "--out", tmp_path / "report")
    assert told.exit_code == 0, told.output
    table = pd.read_csv(tmp_path / "report" / "comparison.csv")
    assert table["agent"].tolist() == ["greedy", "random"]
    assert (table["cral_difference"].isna().tolist(), table["cral_difference"][1] < 0) == ([True, False], True)
    told = uavbench_command("report", *folders, "--against", "planner", "--out", tmp_path / "none")
    assert (told.exit_code, "--against planner: no entry has this name; there are random, greedy" in told.stderr) == (2, True)
    assert not (tmp_path / "none").exists()
