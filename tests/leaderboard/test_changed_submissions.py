"""The check of pull requests that hand in submissions: .ci/changed_submissions.py."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / ".ci" / "changed_submissions.py"
GOOD = Path("leaderboard", "submissions", "random", "Block8-CPP-v0")


def git(folder, *arguments):
    said = ["-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false"]
    subprocess.run(["git", "-C", folder, *said, *arguments], check=True, capture_output=True)


def commit(folder):
    git(folder, "add", "--all")
    git(folder, "commit", "--allow-empty", "-m", "A commit")


@pytest.fixture
def checkout(tmp_path):
    """A repository with one submission, whose second commit a test makes."""
    git(tmp_path, "init")
    shutil.copytree(ROOT / GOOD, tmp_path / GOOD)
    commit(tmp_path)
    return tmp_path


def check(checkout):
    commit(checkout)
    return subprocess.run([sys.executable, SCRIPT, checkout], capture_output=True, text=True)


def test_a_new_submission_is_replayed_and_no_other(checkout):
    (checkout / GOOD / "episodes.csv").write_text("damaged, but not by this pull request")
    commit(checkout)
    new = GOOD.with_name("Block8-DH-v0")
    shutil.copytree(ROOT / new, checkout / new)
    done = check(checkout)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "random/Block8-DH-v0: all 1000 episodes reproduced" in done.stdout
    assert "Block8-CPP-v0" not in done.stdout


def test_a_changed_number_is_refused_and_what_the_summary_shows_is_escaped(checkout):
    manifest = checkout / GOOD / "manifest.toml"
    manifest.write_text(manifest.read_text(encoding="utf-8") + '"</pre><img>" = 1\n', encoding="utf-8")
    done = check(checkout)
    assert done.returncode == 1
    assert "Not accepted" in done.stdout
    assert "refused: random/Block8-CPP-v0" in done.stdout
    assert "<img>" not in done.stdout


@pytest.mark.parametrize("name", ["$(touch ran)", "-x", "A", "..", "<img>"])
def test_names_that_no_submission_has_are_refused(checkout, name):
    folder = checkout / "leaderboard" / "submissions" / name / "Block8-CPP-v0" if name != ".." else checkout / GOOD / "deeper"
    shutil.copytree(ROOT / GOOD, folder)
    done = check(checkout)
    assert done.returncode == 1
    assert done.stdout.count("refused: ") == 3
    assert "<img>" not in done.stdout
    assert not list(checkout.rglob("ran"))


def test_links_are_refused(checkout):
    (checkout / "leaderboard" / "submissions" / "other").symlink_to("random")
    (checkout / GOOD / "episodes.csv").unlink()
    (checkout / GOOD / "episodes.csv").symlink_to("/etc/passwd")
    done = check(checkout)
    assert done.returncode == 1
    assert done.stdout.count("refused: ") == 2
    assert "root:" not in done.stdout


def test_what_is_removed_is_named(checkout):
    shutil.rmtree(checkout / GOOD)
    done = check(checkout)
    assert done.returncode == 0
    assert "removed: random/Block8-CPP-v0" in done.stdout
