"""Flights of submissions with physics: each is flown once, counts for the actions that were flown, and is never lost."""

import math
from dataclasses import replace

import pytest
from boards import row_of
from commands import uavbench_command as uavbench

from uavbench.flight.flown import Conditions, fly
from uavbench.flight.route import recorded_flight
from uavbench.leaderboard import flown as flights
from uavbench.leaderboard.board import build
from uavbench.leaderboard.flown import FILE, FlownEpisode, Safety, fly_missing, load_flown, missing_flights, safety, save_flown
from uavbench.leaderboard.reruns import actions_digest
from uavbench.leaderboard.submission import SubmissionError, load_submission

LINE = FlownEpisode("greedy/Block8-CPP-v0", "0" * 64, 3, 5.0, False, True, 0.5, 0.25, 60.5, 2.5, 1.25, math.inf)


@pytest.fixture
def greedy(submissions):
    return load_submission(submissions / "greedy" / "Block8-CPP-v0")


def of(submission, **changed):
    return replace(LINE, submission=submission.label, actions_sha256=actions_digest(submission), **changed)


def test_a_flight_is_flown_once_as_fly_flies_it_and_shown_on_the_board(submissions, greedy):
    pytest.importorskip("PyFlyt", reason="flights need PyFlyt: pip install 'uavbench[flight]'")
    build(submissions)
    before = row_of(submissions, "greedy")
    told = ("leaderboard", "fly", greedy.folder, "--episodes", 1, "--speed", 4, "--speed", 8)
    first = uavbench(*told)
    assert (first.exit_code, "1 of 1 flights at 4 m/s were safe" in first.output) == (0, True), first.output
    kept = submissions.parent / FILE
    flown = fly(recorded_flight(greedy.result, 0), Conditions(speed=4.0))
    row = next(row for row in load_flown(kept) if row.speed == 4.0)
    assert (row.cr_flown, row.seconds, row.energy) == (flown.cr, flown.uavs[0].seconds, flown.uavs[0].energy)
    assert missing_flights([greedy], 1, (4.0, 8.0), load_flown(kept)) == []
    written = kept.read_bytes()
    assert (uavbench(*told).exit_code, kept.read_bytes()) == (0, written)
    build(submissions)
    after = row_of(submissions, "greedy")
    assert after.pop("flown_safely") == "1 of 1 at 4 m/s; 1 of 1 at 8 m/s"
    assert before.pop("flown_safely") == ""
    assert after == before


def test_what_is_read_is_what_was_written(tmp_path):
    rows = [LINE, replace(LINE, episode=4, hit=True, zone=False, clearance=3.5)]
    save_flown(tmp_path / FILE, reversed(rows))
    assert load_flown(tmp_path / FILE) == rows
    assert load_flown(tmp_path / "none.csv") == []


def test_flights_count_by_speed_and_for_their_own_actions_alone(greedy):
    rows = [of(greedy, zone=False), of(greedy, episode=4), of(greedy, speed=2.0, hit=True, zone=False), LINE]
    assert safety(rows, greedy) == (Safety(2.0, 0, 1), Safety(5.0, 1, 2))
    missing = missing_flights([greedy], 5, (5.0,), rows)
    assert [number for _, number, _ in missing] == [0, 1, 2]


def test_flown_flights_are_kept_when_the_next_one_fails(greedy, tmp_path, monkeypatch):
    def flown(folder, episode, speed):
        if episode == 2:
            raise KeyboardInterrupt
        return of(greedy, episode=episode, speed=speed)

    monkeypatch.setattr(flights, "_flown", flown)
    path = tmp_path / FILE
    older = of(greedy, episode=1)
    save_flown(path, [LINE, replace(older, actions_sha256="1" * 64)])  # the agent has been submitted again since
    with pytest.raises(KeyboardInterrupt):
        fly_missing(missing_flights([greedy], 4, (5.0,), []), path)
    assert load_flown(path) == [of(greedy, episode=0), older, LINE]


@pytest.mark.parametrize(
    ("old", "new"),
    [(",60.5,", ",nan,"), (",60.5,", ",inf,"), (",60.5,", ",,"), ("False,True", "no,True"), (",3,", ",3.5,"), (",inf", "")],
)
def test_a_damaged_file_is_named_with_its_line_and_nothing_changes(submissions, greedy, old, new):
    kept = submissions.parent / FILE
    save_flown(kept, [LINE])
    kept.write_text(kept.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    written = kept.read_bytes()
    with pytest.raises(SubmissionError, match=r"flown\.csv: damaged in line 2 .*: restore an earlier version"):
        build(submissions)
    told = uavbench("leaderboard", "fly", greedy.folder)
    assert (told.exit_code, "flown.csv: damaged in line 2" in told.output) == (2, True), told.output
    assert kept.read_bytes() == written


@pytest.mark.parametrize("speed", ["0", "nan", "1000"])
def test_an_impossible_speed_is_refused(greedy, speed):
    told = uavbench("leaderboard", "fly", greedy.folder, "--episodes", 1, "--speed", speed)
    assert (told.exit_code, f"--speed {speed}: it must be from 0.2 to 20 m/s" in told.output) == (2, True), told.output
    assert not (greedy.folder.parent.parent.parent / FILE).exists()


def test_submissions_of_two_boards_are_not_flown_together(submissions, made, greedy):
    told = uavbench("leaderboard", "fly", greedy.folder, made / "random")
    assert (told.exit_code, "are two boards: give the submissions of one" in told.output) == (2, True), told.output
