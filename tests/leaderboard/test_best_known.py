"""The best known flights: the best that anyone submitted, for each episode, never lost and never believed without a replay."""

import csv
import shutil

import numpy as np
import pytest
from commands import uavbench_command as uavbench

from uavbench import load_scenario
from uavbench.evaluation.actions_file import pack_actions, read_actions
from uavbench.leaderboard.best_known import best_known_files, improved, load_best_known
from uavbench.leaderboard.board import build
from uavbench.leaderboard.submission import SubmissionError, check, load_submission
from uavbench.leaderboard.submit import submit

NAME = "Block8-DH-v0"
SCENARIO = load_scenario(NAME)


def crals(results, agent):
    (result,) = [each for each in results[agent] if each.summary["scenario"] == NAME]
    return result.episodes()["cral"].to_numpy()


def hand_in(results, agent, folder, told):
    submit(results[agent], folder, name=agent, authors=["A. Author"], on_best=lambda *each: told.append(each))


@pytest.fixture
def board(results, tmp_path):
    """A board on which greedy was submitted."""
    hand_in(results, "greedy", tmp_path / "submissions", [])
    return tmp_path


@pytest.fixture
def table(board):
    return board / "best_known" / f"{NAME}.csv"


def test_each_episode_keeps_the_best_flight_and_who_submitted_it(results, tmp_path):
    told = []
    hand_in(results, "random", tmp_path / "submissions", told)
    assert told == [("Block8-CPP-v0", 1000), (NAME, 1000)]
    hand_in(results, "greedy", tmp_path / "submissions", told)
    greedy, random = crals(results, "greedy"), crals(results, "random")
    better = greedy > random
    assert told[3] == (NAME, better.sum())
    assert 0 < better.sum() < 1000
    known = load_best_known(tmp_path / "best_known", SCENARIO)
    assert [best.name for best in known.values()] == ["greedy" if each else "random" for each in better]
    assert [best.record.cral for best in known.values()] == pytest.approx(np.maximum(greedy, random).tolist(), abs=1e-12)
    again = []
    hand_in(results, "greedy", tmp_path / "submissions", again)
    assert again == [("Block8-CPP-v0", 0), (NAME, 0)]


def test_a_flight_outlives_its_submission(board, results):
    shutil.rmtree(board / "submissions" / "greedy")
    hand_in(results, "random", board / "submissions", [])
    build(board / "submissions")
    known = load_best_known(board / "best_known", SCENARIO)
    assert (known[0].name, len(known)) == ("greedy", 1000)
    assert "greedy" in (board / "best_known.html").read_text(encoding="utf-8")


def test_the_board_adds_what_is_missing_and_changes_nothing_else(board, table, results):
    build(board / "submissions")
    files = {path: path.read_bytes() for path in table.parent.iterdir()}
    before = {path: path.stat().st_mtime_ns for path in files}
    page = (board / "best_known.html").read_bytes()
    build(board / "submissions")
    assert {path: path.stat().st_mtime_ns for path in table.parent.iterdir()} == before
    table.unlink()
    table.with_suffix(".npz").unlink()
    build(board / "submissions")
    assert {path: path.read_bytes() for path in table.parent.iterdir()} == files
    assert (board / "best_known.html").read_bytes() == page


def test_an_equal_flight_changes_nothing(board):
    submission = load_submission(board / "submissions" / "greedy" / NAME)
    known = load_best_known(board / "best_known", SCENARIO)
    assert improved(known, submission, check(submission), "2030-01-01") == known


def spoil_cral(table):
    rows = list(csv.reader(table.read_text(encoding="utf-8").splitlines()))
    rows[3][1] = repr(float(rows[3][1]) / 2 + 0.25)
    table.write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")


def spoil_action(table):
    path = table.with_suffix(".npz")
    flights = read_actions(path, 1000)
    flights[2][0] = (flights[2][0] + 2) % 4
    path.write_bytes(pack_actions(list(flights), list(flights.values())))


def drop_an_episode(table):
    path = table.with_suffix(".npz")
    flights = read_actions(path, 1000)
    del flights[2]
    path.write_bytes(pack_actions(list(flights), list(flights.values())))


def replace(old, new):
    return lambda table: table.write_text(table.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (spoil_cral, "episode 2: its actions do not give its cral"),
        (spoil_action, "episode 2: its actions do not give its cral"),
        (drop_an_episode, "does not hold 1000 episodes"),
        (replace(SCENARIO.digest[:12], "0" * 12), "it is of another version of Block8-DH-v0"),
        (replace("episode,cral", "episode,score"), "its columns are not"),
        (replace("\n3,", "\n4,"), "episode 4 is there twice"),
        (replace("\n999,", "\n1000,"), "episode 1000 is there twice, or is no test episode"),
        (lambda table: table.with_suffix(".npz").unlink(), "Block8-DH-v0.npz: there is no such file"),
        (replace("\n3,", "\n3,x"), "could not convert string to float"),
        (replace("greedy,A. Author,", "greedy,"), "line 2 has too few or too many cells"),
        (replace("greedy,A. Author,", "greedy,A. Author,tomorrow,"), "line 2 has too few or too many cells"),
        (replace("A. Author,20", "A. Author,x20"), "Invalid isoformat string"),
        (lambda table: table.unlink(), "Block8-DH-v0.csv: there is no such file"),
        (lambda table: table.with_suffix(".npz").write_bytes(b"junk"), "Block8-DH-v0.npz: damaged"),
        (lambda table: (table.parent / "Nowhere-v0.csv").touch(), "no scenario that comes with uavbench is called Nowhere-v0"),
    ],
)
def test_damaged_files_are_named_and_nothing_changes(board, table, results, spoil, reason):
    spoil(table)
    files = {path: path.read_bytes() for path in board.rglob("*") if path.is_file()}
    with pytest.raises(SubmissionError, match=reason):
        build(board / "submissions")
    if "Nowhere" not in reason:
        with pytest.raises(SubmissionError, match=reason):
            hand_in(results, "random", board / "submissions", [])
    assert {path: path.read_bytes() for path in board.rglob("*") if path.is_file()} == files


def test_what_is_read_is_what_was_written(board, tmp_path):
    known = load_best_known(board / "best_known", SCENARIO)
    some = {number: known[number] for number in (2, 5, 7)}
    for path, content in best_known_files(tmp_path / "other", SCENARIO, some).items():
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    again = load_best_known(tmp_path / "other", SCENARIO)
    assert [(n, each.name, each.date, each.record.actions.tobytes()) for n, each in again.items()] == [
        (n, each.name, each.date, each.record.actions.tobytes()) for n, each in some.items()
    ]


def test_submit_says_how_many_flights_are_the_best_known_ones(results, tmp_path):
    told = uavbench("submit", results["greedy"][1].folder, "--name", "g", "--authors", "A", "--out", tmp_path / "submissions")
    assert (told.exit_code, f"{NAME}: 1,000 flights are now the best known ones" in told.output) == (0, True), told.output
    told = uavbench("submit", results["greedy"][1].folder, "--name", "h", "--authors", "A", "--out", tmp_path / "submissions")
    assert "best known" not in told.output


def test_the_page_lists_sorts_and_filters_them_and_leads_to_the_flights(board, results, opened):
    hand_in(results, "random", board / "submissions", [])
    build(board / "submissions")
    known = load_best_known(board / "best_known", SCENARIO)
    page = opened(board / "best_known.html")
    page.select_option("#scenario", NAME)
    rows = page.eval_on_selector_all("#best tbody tr", "rows => rows.map(row => [...row.cells].map(cell => cell.innerText))")
    assert len(rows) == 1000
    for number in (0, 17, 999):
        best = known[number]
        assert rows[number] == [
            str(number),
            f"{100 * best.record.cral:.2f}",
            "",
            "",
            str(best.record.steps),
            best.name,
            best.date,
        ]
    mean = np.mean([best.record.cral for best in known.values()])
    assert page.inner_text("#summary") == f"1,000 episodes, mean CRAL {100 * mean:.2f} %."
    page.click("th[data-column=cral] button")
    first = int(page.get_attribute("#best tbody tr", "data-episode"))
    assert known[first].record.cral == max(best.record.cral for best in known.values())
    page.select_option("#agent", "random")
    count = sum(best.name == "random" for best in known.values())
    assert page.locator("#best tbody tr").count() == count
    page.click("#best tbody tr a")
    page.wait_for_selector("#viewer:not([hidden])")
    assert page.input_value("#first") == "random"
