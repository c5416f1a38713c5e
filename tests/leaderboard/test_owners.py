"""Whose a name is: the first build with it decides, and no stranger changes that."""

import re
import shutil
import tomllib
from dataclasses import replace

import pytest
from boards import rewrite, rows

from uavbench.leaderboard.board import build
from uavbench.leaderboard.owners import with_new_names
from uavbench.leaderboard.submission import SubmissionError, load_submission
from uavbench.leaderboard.submit import submit

NAMES = ("Block8-CPP-v0", "Block8-DH-v0")


def test_of_two_that_fly_alike_the_later_one_is_named(submissions):
    """Not the one whose name comes later in the alphabet."""
    build(submissions)
    for name in ("copy", "another"):
        shutil.copytree(submissions / "random" / "Block8-DH-v0", submissions / name / "Block8-DH-v0")
        rewrite(submissions / name / "Block8-DH-v0" / "manifest.toml", 'name = "random"', f'name = "{name}"')
        alike = build(submissions).alike
    assert alike == [f"{name}/Block8-DH-v0 took the same actions as random/Block8-DH-v0" for name in ("copy", "another")]


@pytest.mark.parametrize(("old", "new"), [('"A. Author"', '"M. Allory"'), ('link = ""', 'link = "https://example.org"')])
def test_what_is_filed_together_is_of_one_hand(submissions, old, new):
    build(submissions)
    rewrite(submissions / "random" / "Block8-DH-v0" / "manifest.toml", old, new)
    (line,) = build(submissions).refused
    assert re.match(r"random/Block8-DH-v0: manifest.toml: (authors|link): not what owners.toml says of this name", line)


def test_a_stranger_with_as_many_folders_does_not_drive_the_owner_out(submissions, results):
    """Nor one with more, who comes first in the alphabet, or who deletes the owner's folders first."""
    board = submissions.parent
    shutil.move(submissions / "greedy" / "Block8-DH-v0", board / "spare")
    build(submissions)
    assert tomllib.loads((board / "owners.toml").read_text(encoding="utf-8"))["greedy"]["authors"] == ["A. Author", "B. Author"]
    stranger = submissions / "greedy" / "Block8-DH-v0"
    shutil.move(board / "spare", stranger)
    rewrite(stranger / "manifest.toml", '"A. Author"', '"M. Allory"')
    for strangers in (1, 2):
        if strangers == 2:
            rewrite(submissions / "greedy" / "Block8-CPP-v0" / "manifest.toml", '"A. Author"', '"M. Allory"')
        refused = build(submissions).refused
        assert [line.split(": ")[0] for line in refused] == [f"greedy/{name}" for name in NAMES[-strangers:]]
        assert all("not what owners.toml says" in line for line in refused)
        authors = {row["authors"] for row in rows(board) if row["name"] == "greedy"}
        assert authors == ({"A. Author, B. Author"} if strangers == 1 else set())
    shutil.rmtree(submissions / "greedy")
    with pytest.raises(SubmissionError, match=r"authors: not what owners\.toml says of this name: choose another name"):
        submit(results["greedy"], submissions, name="greedy", authors=["M. Allory"])
    submit(results["greedy"], submissions, name="greedy", authors=["A. Author", "B. Author"])
    assert build(submissions).refused == []


def test_a_name_of_nobody_yet_goes_to_whoever_has_most_of_it_or_to_nobody(submissions):
    one = load_submission(submissions / "random" / "Block8-CPP-v0")
    honest = [replace(one, folder=submissions / "random" / name) for name in ("Mine-v0", "Yours-v0")]
    stranger = replace(one, manifest=one.manifest.model_copy(update={"authors": ("Mallory",)}))
    assert with_new_names({}, [stranger, *honest]) == {"random": one.manifest.hand}
    assert with_new_names({"random": stranger.manifest.hand}, honest) == {"random": stranger.manifest.hand}
    rewrite(submissions / "random" / "Block8-CPP-v0" / "manifest.toml", '"A. Author"', '"M. Allory"')
    refused = build(submissions).refused
    assert [line.split(": ", 1)[1] for line in refused] == [
        "manifest.toml: authors: others submitted equally many folders under this name: write its owner in owners.toml"
    ] * 2
    assert "random" not in (submissions.parent / "owners.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize("content", ["[greedy", "greedy = 1", "[greedy]\nname = 1", b"\xff"])
def test_a_damaged_table_of_owners_is_an_error_and_stays(submissions, content):
    path = submissions.parent / "owners.toml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(SubmissionError, match=r"owners\.toml: damaged"):
        build(submissions)
    assert [each.name for each in submissions.parent.iterdir() if each.name != "submissions"] == ["owners.toml"]
