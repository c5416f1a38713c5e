"""Reading a leaderboard and changing its submissions, for tests."""

import csv
import io


def rows(folder):
    return list(csv.DictReader(io.StringIO((folder / "leaderboard.csv").read_text(encoding="utf-8"))))


def row_of(submissions, name, scenario="Block8-CPP-v0"):
    return next(row for row in rows(submissions.parent) if (row["name"], row["scenario"]) == (name, scenario))


def rewrite(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def spoil(folder):
    (folder / "actions.npz").write_bytes(b"junk")
