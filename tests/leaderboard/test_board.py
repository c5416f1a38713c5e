"""The board: everything is replayed, what is refused is named and the rest is built, again to the same bytes."""

import errno
import os
import shutil
from pathlib import Path

import pytest
from boards import rows, spoil
from commands import uavbench_command as uavbench
from joblib.externals.loky import get_reusable_executor

from uavbench.leaderboard.board import build, submission_folders, verify
from uavbench.leaderboard.published import PAPER_SCENARIOS
from uavbench.leaderboard.submission import SubmissionError

PUBLISHED = {("DDQN (paper)", scenario) for scenario in ("overall", *PAPER_SCENARIOS)}


def test_a_board_is_built_beside_the_submissions_and_again_to_the_same_bytes(submissions):
    board = build(submissions, workers=2)
    folder = submissions.parent
    assert sorted(path.name for path in folder.iterdir()) == [
        *("best_known", "best_known.html", "index.html", "leaderboard.csv", "owners.toml", "submissions")
    ]
    assert board.refused == []
    found = {(row["scenario"], row["name"]): row for row in rows(folder)}
    for scenario in ("Block8-CPP-v0", "Block8-DH-v0"):
        assert found[scenario, "greedy"]["rank"] == "1"
        assert found[scenario, "greedy"]["tier"] == "replayed"
        assert found[scenario, "random"]["track"] == "observation"
    first = [(folder / name).read_bytes() for name in ("leaderboard.csv", "index.html")]
    build(submissions)
    assert [(folder / name).read_bytes() for name in ("leaderboard.csv", "index.html")] == first


def test_the_scores_are_those_that_evaluate_printed(submissions, results):
    build(submissions)
    for row in rows(submissions.parent):
        for result in results.get(row["name"], ()):
            if result.summary["scenario"] == row["scenario"]:
                for name, interval in result.metrics.items():
                    assert row[name] == f"{100 * interval.mean:.2f}"
                    assert row[f"{name}_low"] == f"{100 * interval.low:.2f}"


def test_what_is_refused_is_named_and_the_rest_is_built(submissions):
    spoil(submissions / "greedy" / "Block8-DH-v0")
    (submissions / "nobody").mkdir()
    (submissions / "nobody" / "note.txt").write_text("hello")
    told = uavbench("leaderboard", "build", submissions)
    assert told.exit_code == 1
    assert "refused: greedy/Block8-DH-v0: " in told.output
    assert "refused: nobody/note.txt: " in told.output
    found = {(row["scenario"], row["name"]) for row in rows(submissions.parent)}
    assert ("Block8-CPP-v0", "greedy") in found
    assert ("Block8-DH-v0", "greedy") not in found


def test_verify_checks_alone(submissions):
    told = uavbench("leaderboard", "verify", submissions)
    assert told.exit_code == 0
    assert told.output.count("every number") == 4
    assert not (submissions.parent / "leaderboard.csv").exists()
    spoil(submissions / "random" / "Block8-CPP-v0")
    assert uavbench("leaderboard", "verify", submissions / "greedy").exit_code == 0
    told = uavbench("leaderboard", "verify", submissions / "random" / "Block8-CPP-v0")
    assert told.exit_code == 1
    assert "refused: random/Block8-CPP-v0: " in told.output


def test_no_submissions_are_an_error_and_leave_what_was_there(tmp_path):
    (tmp_path / "leaderboard.csv").write_text("old")
    (tmp_path / "submissions").mkdir()
    for folder in ("submissions", "nowhere"):
        with pytest.raises(SubmissionError, match="holds no submissions"):
            build(tmp_path / folder)
        assert uavbench("leaderboard", "verify", tmp_path / folder).exit_code == 2
    assert (tmp_path / "leaderboard.csv").read_text() == "old"


def test_whatever_one_submission_breaks_the_others_are_built(submissions):
    manifest = submissions / "greedy" / "Block8-DH-v0" / "manifest.toml"
    manifest.write_text("a = " + "[" * 20_000, encoding="utf-8")
    board = build(submissions)
    assert len(board.refused) == 1
    assert board.refused[0].startswith("greedy/Block8-DH-v0: ")
    assert {row["name"] for row in rows(submissions.parent)} >= {"greedy", "random"}


def test_links_to_others_submissions_are_refused(submissions):
    (submissions / "copy").symlink_to(submissions / "greedy")
    (submissions / "mine").mkdir()
    (submissions / "mine" / "Block8-CPP-v0").symlink_to(submissions / "greedy" / "Block8-CPP-v0")
    refused = build(submissions).refused
    assert [line.split(": ")[0] for line in refused] == ["submissions/copy", "mine/Block8-CPP-v0"]
    assert len([row for row in rows(submissions.parent) if row["name"] == "greedy"]) == 2


def test_whatever_else_is_there_is_refused_and_does_not_stop_the_rest(submissions):
    (submissions / "manifest.toml").write_text("")
    (submissions / "evil").mkdir()
    (submissions / "evil" / "manifest.toml").write_text("")
    (submissions / "empty").mkdir()
    (submissions / ".hidden").mkdir()
    (submissions / "nowhere").symlink_to("/nowhere")
    (submissions / "a\x1b[31mb").mkdir()
    refused = build(submissions).refused
    assert [line.split(": ")[0] for line in refused] == [
        f"submissions/{name}" for name in (".hidden", "a?[31mb", "empty", "evil", "manifest.toml", "nowhere")
    ]
    assert {row["name"] for row in rows(submissions.parent)} >= {"greedy", "random"}


def test_a_refusal_is_a_line_that_shows_what_it_says(submissions):
    path = submissions / "greedy" / "Block8-CPP-v0" / "manifest.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text('"\\u001b[2K\\u001b[1Gall 1000 episodes reproduced' + "z" * 20_000 + '" = 1\n' + text, encoding="utf-8")
    (line,) = build(submissions).refused
    assert line.startswith("greedy/Block8-CPP-v0: ")
    assert line.isprintable()
    assert len(line) < 400


def test_numbers_are_those_of_the_replay(submissions):
    """A digit that the tolerance of DH lets through makes nobody better: ranks are those of what was flown."""
    copy = submissions / "copy" / "Block8-DH-v0"
    shutil.copytree(submissions / "random" / "Block8-DH-v0", copy)
    manifest = copy / "manifest.toml"
    manifest.write_text(manifest.read_text(encoding="utf-8").replace('name = "random"', 'name = "copy"'), encoding="utf-8")
    head, *lines = [line.split(",") for line in (copy / "episodes.csv").read_text(encoding="utf-8").splitlines()]
    at = head.index("cral")
    for line in lines:
        line[at] = repr(float(line[at]) + 9e-7)
    (copy / "episodes.csv").write_text("\n".join(",".join(line) for line in [head, *lines]) + "\n", encoding="utf-8")
    board = build(submissions)
    assert board.refused == []
    assert board.alike == ["random/Block8-DH-v0 took the same actions as copy/Block8-DH-v0"]  # both are new
    found = {row["name"]: row for row in rows(submissions.parent) if row["scenario"] == "Block8-DH-v0"}
    assert found["copy"]["cral"] == found["random"]["cral"]
    assert (found["copy"]["rank"], found["random"]["rank"]) == ("", "1")  # the first is not who it says to be


@pytest.mark.parametrize("what", ["a board", "a homepage"])
def test_what_was_there_stays_when_all_are_refused(submissions, what):
    for path in submissions.glob("*/*"):
        spoil(path)
    for name in ("leaderboard.csv", "index.html"):
        (submissions.parent / name).write_text(what)
    told = uavbench("leaderboard", "build", submissions)
    assert (told.exit_code, told.output.count("refused: "), "nothing was written" in told.output) == (1, 4, True)
    assert {(submissions.parent / name).read_text() for name in ("leaderboard.csv", "index.html")} == {what}


def test_both_files_are_written_or_none(submissions):
    (submissions.parent / "leaderboard.csv").write_text("old")
    (submissions.parent / "index.html").mkdir()
    told = uavbench("leaderboard", "build", submissions)
    assert (told.exit_code, "index.html: cannot write it" in told.output) == (2, True), told.output
    assert (submissions.parent / "leaderboard.csv").read_text() == "old"


def test_nothing_is_written_when_the_page_cannot_be(submissions, monkeypatch):
    monkeypatch.setattr("uavbench.leaderboard.board.page_text", lambda rows, entries: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        build(submissions)
    assert [path.name for path in submissions.parent.iterdir()] == ["submissions"]


def test_one_agents_folder_is_no_board(submissions):
    for folder in (submissions / "greedy", submissions / "greedy" / "Block8-CPP-v0"):
        with pytest.raises(SubmissionError, match="the folder of all"):
            build(folder)
    assert not (submissions / "leaderboard.csv").exists()


def test_a_folder_that_cannot_be_read_is_refused_and_does_not_stop_the_rest(submissions, monkeypatch):
    list_files = Path.iterdir

    def closed(self):
        if self.name == "random":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(self))
        return list_files(self)

    monkeypatch.setattr(Path, "iterdir", closed)  # root may read everything
    board = build(submissions)
    assert board.refused == ["submissions/random: Permission denied"]
    assert {row.name for row in board.rows if row.rank} == {"greedy"}


def test_a_submission_can_be_replayed_from_where_it_lies(submissions, monkeypatch):
    for start, folder in (("greedy", "Block8-CPP-v0"), ("greedy/Block8-CPP-v0", ".")):
        monkeypatch.chdir(submissions / start)
        told = uavbench("replay", folder)
        assert told.exit_code == 0, told.output


def test_workers_find_the_same(submissions):
    spoil(submissions / "greedy" / "Block8-DH-v0")
    folders = submission_folders(submissions)
    one, two = verify(folders, 1), verify(folders, 2)
    assert [each.label for each, _ in one[0]] == [each.label for each, _ in two[0]]
    assert one[1] == two[1]


@pytest.mark.slow
def test_a_submission_that_kills_the_process_that_reads_it_is_refused_and_no_other(submissions, tmp_path, monkeypatch):
    deadly = "random/Block8-CPP-v0/episodes.csv"
    hook = f"lambda event, args: event == 'open' and str(args[0]).endswith({deadly!r}) and os._exit(3)"
    (tmp_path / "sitecustomize.py").write_text(f"import os, sys\nsys.addaudithook({hook})", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    get_reusable_executor().shutdown(wait=True)  # so that the workers are new ones, which read that file at their start
    try:
        board = build(submissions, workers=2)
    finally:
        get_reusable_executor().shutdown(wait=True)
    assert board.refused == ["random/Block8-CPP-v0: the process that read it died: it may take too much memory"]
    found = {(row["name"], row["scenario"]) for row in rows(submissions.parent)}
    assert found == {("greedy", "Block8-CPP-v0"), ("greedy", "Block8-DH-v0"), ("random", "Block8-DH-v0")} | PUBLISHED


def test_submit_by_command(results, tmp_path):
    folders = [result.folder for result in results["random"]]
    told = uavbench("submit", *folders, "--name", "Any", "--authors", "A", "--authors", "B", "--out", tmp_path / "s")
    assert told.exit_code == 0
    assert (tmp_path / "s" / "any" / "Block8-DH-v0" / "manifest.toml").is_file()
    told = uavbench("submit", *folders, "--name", "../x", "--authors", "A", "--out", tmp_path / "s")
    assert told.exit_code == 2
    assert "name" in told.output
