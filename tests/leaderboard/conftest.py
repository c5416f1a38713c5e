"""Submissions of cheap agents, made once, and a browser for the page."""

import json
import re
import shutil
from pathlib import Path

import pytest

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.evaluate import Job
from uavbench.evaluation.results import load_result
from uavbench.evaluation.run import run
from uavbench.leaderboard.board import build
from uavbench.leaderboard.page import filled
from uavbench.leaderboard.submit import submit

CHROMIUM = shutil.which("chromium")
OFFICIAL = Path(__file__).parent.parent.parent / "leaderboard"
NAMES = ("Block8-CPP-v0", "Block8-DH-v0")


@pytest.fixture(scope="session")
def results(tmp_path_factory):
    """All test episodes of Block8, by agent."""
    out = tmp_path_factory.mktemp("results")
    return {
        agent: [run(Job(find_agent(agent), load_scenario(name), "test"), 1000, out) for name in NAMES]
        for agent in ("greedy", "random")
    }


@pytest.fixture(scope="session")
def made(results, tmp_path_factory):
    folder = tmp_path_factory.mktemp("board") / "submissions"
    for agent, flown in results.items():
        submit(flown, folder, name=agent, authors=["A. Author", "B. Author"], hardware="a machine")
    return folder


@pytest.fixture
def submissions(made, tmp_path):
    """A copy of the submissions, to spoil."""
    return shutil.copytree(made, tmp_path / "board" / "submissions")


@pytest.fixture(scope="session")
def result(results):
    return load_result(results["greedy"][0].folder)


@pytest.fixture(scope="module")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api", reason="the page needs Playwright: pip install 'uavbench[dev]'")
    if CHROMIUM is None:
        pytest.skip("the page needs Debian's chromium: apt-get install chromium")
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


@pytest.fixture(scope="session")
def board(made, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    shutil.copytree(made, folder / "submissions")
    build(folder / "submissions")
    return folder / "index.html"


@pytest.fixture(scope="session")
def official(tmp_path_factory):
    """The committed board's data in the page as it is now."""
    text = (OFFICIAL / "index.html").read_text(encoding="utf-8")
    data = re.search(r'id="data">(.*?)</script>', text, re.DOTALL)
    assert data is not None
    path = tmp_path_factory.mktemp("official") / "index.html"
    path.write_text(filled("page.html", json.loads(data[1])), encoding="utf-8")
    return path
