"""The page in a real browser: the table, the filters, and flights that end with the CR of the table of episodes."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from browsing import watch

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.run import run
from uavbench.leaderboard.board import build, submission_folders
from uavbench.leaderboard.flown import FILE, FlownEpisode, save_flown
from uavbench.leaderboard.reruns import actions_digest
from uavbench.leaderboard.submission import load_submission
from uavbench.leaderboard.submit import submit

OFFICIAL = Path(__file__).parent.parent.parent / "leaderboard" / "submissions"


def names(page):
    return page.eval_on_selector_all("#board tbody tr", "rows => rows.map(row => row.dataset.name)")


def test_sorts_by_a_click_and_filters(board, opened):
    page = opened(board)
    page.select_option("#scenario", "Block8-CPP-v0")
    assert names(page) == ["greedy", "random"]
    page.click("th[data-column=cral] button")
    assert names(page) == ["random", "greedy"]
    assert page.get_attribute("th[data-column=cral]", "aria-sort") == "ascending"
    page.click("th[data-column=name] button")
    assert names(page) == ["greedy", "random"]
    page.fill("#search", "RAND")
    assert names(page) == ["random"]
    page.fill("#search", "a. author")
    page.select_option("#track", "state")
    assert names(page) == ["greedy"]
    page.fill("#search", "nobody of this name")
    assert names(page) == []
    assert page.is_visible("#none")
    page.reload()
    assert page.input_value("#scenario") == "Block8-CPP-v0"


def test_the_column_of_flights_with_physics_is_shown_where_there_are_some(submissions, opened):
    greedy = load_submission(submissions / "greedy" / "Block8-CPP-v0")
    line = FlownEpisode(greedy.label, actions_digest(greedy), 0, 5.0, False, False, 1.0, 1.0, 60.0, 2.0, 1.0, 4.0)
    save_flown(submissions.parent / FILE, [line, replace(line, episode=1, hit=True), replace(line, speed=8.0)])
    build(submissions)
    page = opened(submissions.parent / "index.html")
    page.select_option("#scenario", "Block8-CPP-v0")
    assert page.inner_text("tr[data-name=greedy] td.safety").split("\n") == ["50 % at 5 m/s", "100 % at 8 m/s"]
    assert page.inner_text("tr[data-name=random] td.safety") == ""
    page.click("th[data-column=safety] button")
    assert names(page) == ["greedy", "random"]
    assert page.is_visible("#flown")
    page.select_option("#scenario", "Block8-DH-v0")
    assert not page.is_visible("th[data-column=safety]")
    assert not page.is_visible("#flown")


def test_overall_shows_the_papers_figures_with_no_flights(board, opened):
    page = opened(board)
    assert page.input_value("#scenario") == "overall"
    assert names(page) == ["DDQN (paper)"]
    assert page.locator("#board .open").count() == 0
    assert "published" in page.inner_text("#board tbody")


@pytest.mark.parametrize("scenario", ["Block8-CPP-v0", "Block8-DH-v0"])
def test_plays_an_episode_to_its_end_with_the_csvs_cr(board, opened, results, scenario):
    table = {r.summary["scenario"]: r.episodes() for r in results["greedy"]}[scenario]
    page = opened(board)
    page.select_option("#scenario", scenario)
    page.click("tr[data-name=greedy] .open")
    page.fill("#episode", "17")
    page.locator("#episode").dispatch_event("change")
    page.wait_for_function("document.querySelector('.pane h3').textContent.endsWith('episode 17')")
    page.select_option("#speed", "100")
    page.click("#play")
    page.wait_for_selector(".pane[data-over=true]")
    assert float(page.get_attribute(".pane", "data-cr")) == pytest.approx(100 * table["cr"][17], abs=1e-3)
    assert page.inner_text(".pane .numbers").endswith("landed" if table["landed"][17] else "crashed")
    assert page.inner_text("#step") == f"{table['steps'][17]}/{table['steps'][17]}"


def test_chooses_worst_median_and_best(board, opened, results):
    cral = results["random"][0].episodes()["cral"].to_numpy()
    page = opened(board)
    page.select_option("#scenario", "Block8-CPP-v0")
    page.click("tr[data-name=random] .open")
    for which, value in (("worst", cral.min()), ("best", cral.max()), ("median", sorted(cral)[500])):
        page.click(f"[data-pick={which}]")
        page.wait_for_timeout(100)
        assert cral[int(page.input_value("#episode"))] == pytest.approx(value)


def test_two_side_by_side_by_keyboard_alone(board, opened):
    page = opened(board)
    page.select_option("#scenario", "Block8-DH-v0")
    page.focus("tr[data-name=greedy] .open")
    page.keyboard.press("Enter")
    page.wait_for_selector(".pane")
    page.focus("#second")
    page.keyboard.press("ArrowDown")
    page.wait_for_function("document.querySelectorAll('.pane').length === 2")
    assert (
        page.locator(".pane h3").nth(0).inner_text().split("episode")[1]
        == page.locator(".pane h3").nth(1).inner_text().split("episode")[1]
    )
    page.focus("#time")
    page.keyboard.press("End")
    assert page.eval_on_selector_all(".pane", "panes => panes.map(pane => pane.dataset.over)") == ["true", "true"]
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowLeft")
    assert page.inner_text("#step").startswith("1/")
    page.keyboard.press("Space")
    page.wait_for_function("!document.querySelector('#step').textContent.startsWith('1/')")
    page.keyboard.press("Escape")
    assert not page.is_visible("#viewer")
    assert page.evaluate("document.activeElement.closest('tr').dataset.name") == "greedy"


def test_keys_with_a_modifier_are_the_browsers(board, opened):
    page = opened(board)
    page.select_option("#scenario", "Block8-DH-v0")
    page.click("tr[data-name=greedy] .open")
    page.wait_for_selector(".pane")
    press = """altKey => {
        const event = new KeyboardEvent("keydown", { key: "ArrowRight", altKey, bubbles: true, cancelable: true });
        document.body.dispatchEvent(event);
        return event.defaultPrevented;
    }"""
    assert not page.evaluate(press, True)
    assert page.inner_text("#step").startswith("0/")
    assert page.evaluate(press, False)
    assert page.inner_text("#step").startswith("1/")


def test_a_page_without_room_for_all_flights_has_the_first_and_says_so(made, opened, tmp_path, monkeypatch):
    folder = shutil.copytree(made, tmp_path / "submissions")
    for room, said, count in ((10**6, "of 1,000", 1000), (10**3, "of the first 100 of 1,000", 100)):
        monkeypatch.setattr("uavbench.leaderboard.page._ROOM", room)
        build(folder)
        page = opened(tmp_path / "index.html")
        page.select_option("#scenario", "Block8-CPP-v0")
        page.click("tr[data-name=greedy] .open")
        page.wait_for_selector(".pane")
        assert page.inner_text("#many") == said
        assert page.get_attribute("#episode", "max") == str(count - 1)


def test_scenarios_share_what_is_drawn_alike(board):
    data = json.loads(re.search(r'id="data">(.*?)</script>', board.read_text(encoding="utf-8"), re.DOTALL)[1])
    coverage, harvesting = (data["scenarios"][name]["episodes"] for name in ("Block8-CPP-v0", "Block8-DH-v0"))
    assert coverage["key"] == harvesting["key"]
    assert len(data["columns"]) == len({*coverage.values(), *harvesting.values()}) < len(coverage) + len(harvesting)


def test_every_flight_ends_as_in_the_submission(board, opened, results):
    page = opened(board)
    for agent, flown in results.items():
        for result in flown:
            found = page.evaluate(f"Viewer.replayAll('{agent}', '{result.summary['scenario']}')")
            table = result.episodes()
            assert len(found) == 1000
            assert [cr for cr, _ in found] == pytest.approx(table["cr"].tolist(), abs=1e-6)
            assert [landed for _, landed in found] == table["landed"].astype(bool).tolist()


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["Cities32-CPP-v0", "Cities32-DH-Team-v0"])
def test_every_flight_in_many_cities_ends_as_in_the_submission(opened, tmp_path, scenario):
    result = run(Job(find_agent("random"), load_scenario(scenario), "test"), 1000, tmp_path / "results")
    submit([result], tmp_path / "submissions", name="random", authors=["A. Author"], hardware="a machine")
    build(tmp_path / "submissions")
    found = opened(tmp_path / "index.html").evaluate(f"Viewer.replayAll('random', '{scenario}')")
    assert [cr for cr, _ in found] == pytest.approx(result.episodes()["cr"].tolist()[: len(found)], abs=1e-6)
    assert len(found) == 1000


@pytest.mark.slow
def test_every_official_flight_ends_as_in_the_submission_and_the_page_is_small(opened):
    """The committed page; that it is the one which is built from the submissions is another check of CI's."""
    path = OFFICIAL.parent / "index.html"
    assert path.stat().st_size < 3e6
    page = opened(path)
    for folder in submission_folders(OFFICIAL):
        submission = load_submission(folder)
        if max(submission.scenario.shape) > 64:
            continue  # the page has no room for its maps
        found = page.evaluate("([agent, id]) => Viewer.replayAll(agent, id)", submission.label.split("/"))
        assert len(found) in (1000, 200, 100)  # all, or as many as there is room for, or all of a large map
        assert [cr for cr, _ in found] == pytest.approx(submission.result.episodes()["cr"].tolist()[: len(found)], abs=1e-5)


def test_what_is_submitted_is_text_to_the_page(made, opened, tmp_path):
    folder = shutil.copytree(made, tmp_path / "submissions")
    evil = "</script><img src=x onerror=alert(1)>"
    for manifest in (folder / "greedy").glob("*/manifest.toml"):  # a name has one owner
        manifest.write_text(re.sub("A. Author", evil, manifest.read_text(encoding="utf-8")), encoding="utf-8")
    build(folder)
    page = opened(tmp_path / "index.html")
    page.select_option("#scenario", "Block8-CPP-v0")
    assert evil in page.inner_text("tr[data-name=greedy]")
    assert page.locator("#board img").count() == 0


def test_ranks_name_their_track_where_both_are_shown(board, opened):
    page = opened(board)
    page.select_option("#scenario", "Block8-CPP-v0")
    ranks = "rows => Object.fromEntries(rows.map(row => [row.dataset.name, row.querySelector('.rank').textContent]))"
    assert page.eval_on_selector_all("#board tbody tr", ranks) == {"greedy": "S1", "random": "O1"}
    assert "S1 of the state track" in page.inner_text("#ranks")
    page.click("th[data-column=rank] button")
    assert names(page) == ["random", "greedy"]
    page.select_option("#track", "state")
    assert page.eval_on_selector_all("#board tbody tr", ranks) == {"greedy": "1"}


def test_a_flight_has_an_address(board, opened):
    page = opened(board)
    watch(page, "Block8-DH-v0", "greedy", 17)
    assert page.evaluate("location.hash") == "#Block8-DH-v0/greedy/17"
    assert page.get_attribute("#link", "href") == "#Block8-DH-v0/greedy/17"
    page.select_option("#where", "Block8-CPP-v0")
    page.wait_for_selector(".pane h3:has-text('Block8-CPP-v0')")
    page.fill("#episode", "5")
    page.locator("#episode").dispatch_event("change")
    page.wait_for_function("location.hash === '#Block8-CPP-v0/greedy/5'")
    page.click("#close")
    assert page.evaluate("location.hash") == "#Block8-DH-v0"
    page.evaluate("location.hash = '#Block8-CPP-v0/random/999'")
    page.wait_for_selector(".pane h3:has-text('random · Block8-CPP-v0 · episode 999')")
    assert page.input_value("#scenario") == "Block8-CPP-v0"
    page.reload()
    page.wait_for_selector(".pane h3:has-text('random · Block8-CPP-v0 · episode 999')")
    page.evaluate("location.hash = '#Block8-DH-v0'")
    page.wait_for_selector("#viewer", state="hidden")
    assert page.input_value("#scenario") == "Block8-DH-v0"


@pytest.mark.parametrize(
    ("address", "episode"),
    [
        *[(f"#Block8-CPP-v0/greedy/{said}", "999") for said in ("1e99", "1000", "99999999999")],
        *[(f"#Block8-CPP-v0/greedy/{said}", "0") for said in ("-5", "0", "-0")],
        *[
            (f"#{said}", None)
            for said in ("%E0%A4%A", "__proto__/constructor/1", "Block8-CPP-v0/nobody/1", "a/b/c/d", "/", "//", "%")
        ],
        ("#Block8-CPP-v0/<img src=x onerror=alert(1)>/1", None),
        ("#<script>alert(1)</script>/greedy/1", None),
    ],
)
def test_a_hostile_address_does_nothing(board, opened, address, episode):
    page = opened(board)
    page.goto(f"{board.as_uri()}{address}")
    page.reload()
    if episode is None:
        assert not page.is_visible("#viewer")
        assert re.fullmatch(r"#[\w-]+", page.evaluate("location.hash"))
    else:
        page.wait_for_function(f"location.hash === '#Block8-CPP-v0/greedy/{episode}'")
    assert names(page)
    assert page.locator("img, main script").count() == 0


def test_an_address_without_a_number_leads_to_the_median(board, opened):
    page = opened(board)
    page.evaluate("location.hash = '#Block8-CPP-v0/greedy/abc'")
    page.wait_for_function("/^#Block8-CPP-v0.greedy.[0-9]+$/.test(location.hash)")
    median = page.input_value("#episode")
    page.click("[data-pick=median]")
    assert page.input_value("#episode") == median
