"""The page in a real browser: the table, the filters, and flights that end with the CR of the table of episodes."""

import json
import re
import shutil
from pathlib import Path

import pytest

from uavbench.leaderboard.board import build, submission_folders
from uavbench.leaderboard.submission import load_submission

sync_api = pytest.importorskip("playwright.sync_api", reason="the page needs Playwright: pip install 'uavbench[dev]'")
CHROMIUM = shutil.which("chromium")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="the page needs Debian's chromium: apt-get install chromium")

OFFICIAL = Path(__file__).parent.parent.parent / "leaderboard" / "submissions"


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        yield playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])


@pytest.fixture
def opened(browser):
    """Open a page and collect what goes wrong in it, requests to elsewhere included."""
    contexts, wrong = [], []

    def open_page(path, **options):
        context = browser.new_context(bypass_csp=True, **options)  # so that tests may wait for functions
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        page.on(
            "request",
            lambda request: None if request.url.startswith(("file:", "data:", "blob:")) else wrong.append(request.url),
        )
        page.goto(path.as_uri())
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert wrong == []


@pytest.fixture(scope="module")
def board(made, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    shutil.copytree(made, folder / "submissions")
    build(folder / "submissions")
    return folder / "index.html"


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
def test_every_official_flight_ends_as_in_the_submission_and_the_page_is_small(opened):
    """The committed page; that it is the one which is built from the submissions is another check of CI's."""
    path = OFFICIAL.parent / "index.html"
    assert path.stat().st_size < 3e6
    page = opened(path)
    for folder in submission_folders(OFFICIAL):
        submission = load_submission(folder)
        found = page.evaluate("([agent, id]) => Viewer.replayAll(agent, id)", submission.label.split("/"))
        assert len(found) == 1000
        assert [cr for cr, _ in found] == pytest.approx(submission.result.episodes()["cr"].tolist()[: len(found)], abs=1e-5)


def test_reads_well_on_a_phone_and_in_the_dark(board, opened):
    page = opened(board, viewport={"width": 375, "height": 700}, color_scheme="dark")
    assert page.evaluate("document.documentElement.scrollWidth") <= 375
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.click("#theme")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != dark
    page.select_option("#scenario", "Block8-CPP-v0")
    assert page.is_visible("tr[data-name=greedy] td.rank")
    cell, tier = (page.locator(f"tr[data-name=greedy] {each}").bounding_box() for each in ("td.name", ".tier"))
    assert tier["x"] + tier["width"] <= cell["x"] + cell["width"] <= 375
    page.click("tr[data-name=greedy] .open")
    page.wait_for_selector(".pane")
    assert page.evaluate("document.documentElement.scrollWidth") <= 375
    legend = "document.querySelector('#legend i').style.background"
    light = page.evaluate(legend)
    page.click("#theme")
    assert page.evaluate(legend) != light


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
