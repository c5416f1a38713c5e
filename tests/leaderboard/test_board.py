"""The board: everything is replayed, what is refused is named and the rest is built, again to the same bytes."""

import csv
import errno
import io
import os
import re
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
import tomli_w
from commands import uavbench_command as uavbench

from uavbench.agent import find_agent
from uavbench.leaderboard.board import _of_one_hand, build, submission_folders, verify
from uavbench.leaderboard.reruns import load_reruns
from uavbench.leaderboard.submission import SubmissionError, load_submission

OF_WEIGHTS = """
from pathlib import Path
class Agent:
    def __init__(self, scenario, weights):
        self.action = int(Path(weights).read_text())
    def act(self, observation, info):
        return self.action
"""


def rows(folder):
    return list(csv.DictReader(io.StringIO((folder / "leaderboard.csv").read_text(encoding="utf-8"))))


def spoil(folder):
    (folder / "actions.npz").write_bytes(b"junk")


def test_a_board_is_built_beside_the_submissions_and_again_to_the_same_bytes(submissions):
    board = build(submissions, workers=2)
    folder = submissions.parent
    assert sorted(path.name for path in folder.iterdir()) == ["index.html", "leaderboard.csv", "submissions"]
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
    assert board.alike == ["random/Block8-DH-v0 took the same actions as copy/Block8-DH-v0"]
    found = {row["name"]: row for row in rows(submissions.parent) if row["scenario"] == "Block8-DH-v0"}
    assert found["copy"]["rank"] == found["random"]["rank"]


@pytest.mark.parametrize(("old", "new"), [('"A. Author"', '"M. Allory"'), ('link = ""', 'link = "https://example.org"')])
def test_what_is_filed_together_is_of_one_hand(submissions, old, new):
    manifest = submissions / "random" / "Block8-DH-v0" / "manifest.toml"
    text = manifest.read_text(encoding="utf-8")
    assert old in text
    manifest.write_text(text.replace(old, new), encoding="utf-8")
    (line,) = build(submissions).refused
    assert re.match(r"random/Block8-DH-v0: manifest.toml: (authors|link): another than in random/Block8-CPP-v0", line)


def test_a_strangers_folder_drives_nobody_out(submissions):
    """Though it comes first."""
    one = load_submission(submissions / "random" / "Block8-CPP-v0")
    honest = [(replace(one, folder=submissions / "random" / name), []) for name in ("Mine-v0", "Yours-v0")]
    stranger = replace(one, manifest=one.manifest.model_copy(update={"authors": ("Mallory",)}))
    kept, (line,) = _of_one_hand([(stranger, []), *honest])
    assert kept == honest
    assert line == "random/Block8-CPP-v0: manifest.toml: authors: another than in random/Mine-v0"


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


def test_an_agent_that_takes_the_same_actions_again_raises_the_tier(submissions):
    folder = submissions / "random"
    assert uavbench("leaderboard", "rerun", folder, "--agent", "random").exit_code == 0
    build(submissions)
    tiers = {(row["scenario"], row["name"]): row["tier"] for row in rows(submissions.parent)}
    assert tiers["Block8-CPP-v0", "random"] == tiers["Block8-DH-v0", "random"] == "rerun"
    assert tiers["Block8-CPP-v0", "greedy"] == "replayed"


def test_a_part_that_was_run_again_is_counted_but_is_no_rerun(submissions):
    assert uavbench("leaderboard", "rerun", submissions / "random", "--agent", "random", "--episodes", 7).exit_code == 0
    build(submissions)
    row = next(row for row in rows(submissions.parent) if row["name"] == "random")
    assert (row["tier"], row["rerun_episodes"]) == ("replayed", "7")


def test_a_shorter_rerun_does_not_take_back_a_longer_one(submissions):
    for count in (5, 9, 3):
        told = uavbench("leaderboard", "rerun", submissions / "random", "--agent", "random", "--episodes", count)
        assert told.exit_code == 0
    assert {rerun.episodes for rerun in load_reruns(submissions.parent / "reruns.csv").values()} == {9}


@pytest.mark.parametrize(
    ("field", "old", "new"),
    [("track", 'track = "observation"', 'track = "state"'), ("agent_sha256", 'agent_sha256 = "', 'agent_sha256 = "0')],
)
def test_an_agent_other_than_the_manifest_says_is_no_rerun(submissions, field, old, new):
    manifest = submissions / "random" / "Block8-CPP-v0" / "manifest.toml"
    text = manifest.read_text(encoding="utf-8").replace(old, new)
    manifest.write_text(re.sub(r'(agent_sha256 = ".{64}).*"', r'\1"', text), encoding="utf-8")
    told = uavbench("leaderboard", "rerun", manifest.parent, "--agent", "random")
    assert (told.exit_code, f": {field}: random has" in told.output) == (1, True), told.output
    assert not (submissions.parent / "reruns.csv").exists()


def test_an_agent_is_run_again_with_the_weights_it_flew_with(tmp_path):
    (tmp_path / "mine.py").write_text(OF_WEIGHTS, encoding="utf-8")
    for name, action in (("weights", 2), ("others", 3)):
        (tmp_path / name).write_text(str(action), encoding="utf-8")
    agent, scenario = ("--agent", tmp_path / "mine.py"), ("--scenario", "Block8-CPP-v0")
    told = uavbench("evaluate", *agent, "--weights", tmp_path / "weights", *scenario, "--out", tmp_path / "results")
    assert told.exit_code == 0, told.output
    out = ("--out", tmp_path / "board" / "submissions")
    told = uavbench("submit", *(tmp_path / "results" / "Block8-CPP-v0").iterdir(), "--name", "Mine", "--authors", "A", *out)
    assert told.exit_code == 0, told.output
    again = ("leaderboard", "rerun", tmp_path / "board" / "submissions" / "mine", *agent, "--episodes", 5)
    for given, wrong in (((), "weights are given by --weights"), (("--weights", tmp_path / "others"), "agent_sha256: ")):
        told = uavbench(*again, *given)
        assert (told.exit_code, wrong in told.output) == (1, True), told.output
    told = uavbench(*again, "--weights", tmp_path / "weights", "--decision-timeout", 30)
    assert told.exit_code == 0, told.output


def test_what_does_not_hold_is_not_run_again(submissions):
    spoil(submissions / "random" / "Block8-CPP-v0")
    told = uavbench("leaderboard", "rerun", submissions / "random" / "Block8-CPP-v0", "--agent", "random")
    assert (told.exit_code, "damaged" in told.output) == (1, True), told.output


def test_another_agent_is_found_out_at_its_first_other_action(submissions):
    told = uavbench("leaderboard", "rerun", submissions / "random", "--agent", "greedy")
    assert told.exit_code == 1
    assert "random/Block8-CPP-v0: track: greedy has state" in told.output
    path = submissions / "random" / "Block8-CPP-v0" / "manifest.toml"  # and when it claims to be that agent
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    table["result"] |= {"track": "state", "agent_sha256": find_agent("greedy").sha256}
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    told = uavbench("leaderboard", "rerun", path.parent, "--agent", "greedy")
    assert told.exit_code == 1
    assert re.search(r"random/Block8-CPP-v0: episode \d+: greedy acts otherwise from step \d+ on", told.output)
    assert load_reruns(submissions.parent / "reruns.csv") == {}


def test_a_rerun_of_other_actions_does_not_count(submissions):
    assert uavbench("leaderboard", "rerun", submissions / "random", "--agent", "random").exit_code == 0
    for name in ("actions.npz", "episodes.csv", "manifest.toml"):
        content = (submissions / "greedy" / "Block8-CPP-v0" / name).read_bytes()
        (submissions / "random" / "Block8-CPP-v0" / name).write_bytes(content.replace(b'name = "greedy"', b'name = "random"'))
    build(submissions)
    row = next(row for row in rows(submissions.parent) if (row["name"], row["scenario"]) == ("random", "Block8-CPP-v0"))
    assert row["tier"] == "replayed"


@pytest.mark.parametrize("scenario", ["Block8-CPP-v0", "Block8-DH-v0"])
def test_a_rerun_on_another_track_does_not_count(submissions, scenario):
    """What was executed saw the observation: an edited manifest cannot say otherwise and keep the tier."""
    assert uavbench("leaderboard", "rerun", submissions / "random", "--agent", "random").exit_code == 0
    for path in (submissions / "random").glob("*/manifest.toml"):
        text = path.read_text(encoding="utf-8")
        path.write_text(text.replace('track = "observation"', 'track = "state"'), encoding="utf-8")
    build(submissions)
    row = next(row for row in rows(submissions.parent) if (row["name"], row["scenario"]) == ("random", scenario))
    assert (row["track"], row["tier"], row["rerun_episodes"]) == ("state", "replayed", "0")


def test_a_damaged_table_of_reruns_is_an_error(submissions):
    (submissions.parent / "reruns.csv").write_text("submission,episodes\na,b\n")
    with pytest.raises(SubmissionError, match=r"reruns\.csv: damaged"):
        build(submissions)


def test_a_table_of_reruns_that_cannot_be_kept_is_found_before_the_flight(submissions, monkeypatch):
    path, words = submissions.parent / "reruns.csv", ("leaderboard", "rerun", submissions / "random", "--agent", "random")
    assert uavbench(*words, "--episodes", 2).exit_code == 0
    good = path.read_text(encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.setattr("uavbench.leaderboard.reruns.evaluate", lambda *job: pytest.fail("it flies"))
        path.write_text(good.rstrip("\n")[:-1] + "x\n", encoding="utf-8")
        told = uavbench(*words)
        assert (told.exit_code, "reruns.csv: damaged in line 3" in told.output) == (1, True), told.output
        path.unlink()
        path.mkdir()
        told = uavbench(*words)
        assert (told.exit_code, "reruns.csv: is not a plain file" in told.output) == (1, True), told.output
    path.rmdir()
    with monkeypatch.context() as patch:
        patch.setattr("uavbench.leaderboard.reruns.evaluate", lambda *job: pytest.fail("it flies"))
        patch.setattr("uavbench.files.tempfile.TemporaryFile", lambda **where: _full())
        told = uavbench(*words)
        assert (told.exit_code, "reruns.csv: No space left" in told.output) == (1, True), told.output
    monkeypatch.setattr("uavbench.leaderboard.reruns.write_whole", _full)
    told = uavbench(*words, "--episodes", 2)
    assert (told.exit_code, "reruns.csv: No space left" in told.output) == (1, True), told.output


def _full(*to):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_submit_by_command(results, tmp_path):
    folders = [result.folder for result in results["random"]]
    told = uavbench("submit", *folders, "--name", "Any", "--authors", "A", "--authors", "B", "--out", tmp_path / "s")
    assert told.exit_code == 0
    assert (tmp_path / "s" / "any" / "Block8-DH-v0" / "manifest.toml").is_file()
    told = uavbench("submit", *folders, "--name", "../x", "--authors", "A", "--out", tmp_path / "s")
    assert told.exit_code == 2
    assert "name" in told.output
