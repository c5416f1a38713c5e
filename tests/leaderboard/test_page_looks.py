"""What the page looks like in a real browser: on a phone and a desk, in the light and the dark."""

import io
import itertools
import re

import numpy as np
import pytest
from browsing import watch
from PIL import Image
from skimage.color import rgb2lab

from uavbench import load_scenario
from uavbench.world.episode import frozen_columns

SIZES = {
    "phone": {"viewport": {"width": 390, "height": 844}, "has_touch": True},
    "desk": {"viewport": {"width": 1280, "height": 900}},
}


SHORT_OR_COVERED = """() => [...document.querySelectorAll("button, select, input, a[href]")].filter((control) => {
    if (!control.checkVisibility()) return false;
    control.scrollIntoView({ block: "center", inline: "center", behavior: "instant" });
    const { left, top, width, height } = control.getBoundingClientRect();
    const met = document.elementFromPoint(left + width / 2, top + height / 2);
    return width < 40 || height < 40 || !control.contains(met);
}).map((control) => control.outerHTML.slice(0, 200))"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", SIZES)
def test_nothing_is_wider_than_the_page_and_everything_can_be_tapped(official, opened, size, scheme):
    page = opened(official, color_scheme=scheme, **SIZES[size])
    tap = "tap" if size == "phone" else "click"
    for scenario in ("Manhattan32-CPP-v0", "Urban50-DH-v0"):
        watch(page, scenario, "planner")
        assert page.evaluate("document.documentElement.scrollWidth") <= SIZES[size]["viewport"]["width"]
        assert page.evaluate(SHORT_OR_COVERED) == []
        getattr(page.locator("[data-pick=best]"), tap)()
        getattr(page.locator("#ahead"), tap)()
        page.wait_for_function("document.querySelector('#step').textContent.startsWith('1/')")
        getattr(page.locator("#play"), tap)()
        page.wait_for_function("!document.querySelector('#step').textContent.startsWith('1/')")


@pytest.mark.parametrize("size", SIZES)
def test_the_best_known_flights_fit_the_page_and_can_be_tapped(board, opened, size):
    page = opened(board.with_name("best_known.html"), **SIZES[size])
    page.select_option("#scenario", "Block8-CPP-v0")
    assert page.evaluate("document.documentElement.scrollWidth") <= SIZES[size]["viewport"]["width"]
    page.evaluate("[...document.querySelectorAll('#best tbody tr')].slice(20).forEach((row) => row.remove())")  # it takes long
    assert page.evaluate(SHORT_OR_COVERED) == []


def test_play_and_pause_are_drawn(board, opened):
    """Their letters are missing in some fonts."""
    page = opened(board)
    watch(page, "Block8-CPP-v0", "greedy")
    seen = []
    page.select_option("#speed", "5")
    for label in ("Play", "Pause"):
        assert page.get_attribute("#play", "aria-label") == label
        assert page.inner_text("#play") == ""
        seen.append(page.eval_on_selector_all("#play path", "each => each.map(path => path.checkVisibility())"))
        page.click("#play")
    assert seen == [[True, False], [False, True]]


def colour_of(page, mark):
    """The mean colour of a mark of the legend, in CIELAB."""
    icon = page.locator("#legend > *").filter(has_text=re.compile(f"^{mark}$")).locator("i, canvas")
    picture = np.asarray(Image.open(io.BytesIO(icon.screenshot())).convert("RGB"))[2:-2, 2:-2]
    return rgb2lab(picture.mean(axis=(0, 1)) / 255)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_colours_of_the_map_are_told_apart(board, opened, scheme):
    page = opened(board, color_scheme=scheme)
    for scenario in ("Block8-CPP-v0", "Block8-DH-v0"):
        watch(page, scenario, "greedy")
        marks = ["landing zone", "no-fly zone", "building"]
        marks += ["to cover", "covered", "camera's view"] if "CPP" in scenario else []
        for one, other in itertools.combinations(marks, 2):
            assert np.linalg.norm(colour_of(page, one) - colour_of(page, other)) > 18, (one, other)


@pytest.mark.parametrize(
    ("scenario", "marks"),
    [
        ("Block8-CPP-v0", ["to cover, in a no-fly zone", "to cover, in a landing zone", "camera's view", "path"]),
        ("Block8-DH-v0", ["device, filled by the data it has left", "in no device's sight", "the device being served"]),
    ],
)
def test_the_legend_has_every_mark(board, opened, scenario, marks):
    page = opened(board)
    watch(page, scenario, "greedy")
    told = [text.strip() for text in page.locator("#legend > *").all_inner_texts()]
    assert {"start", "landed", "crashed", "hover", "UAV", "building", "no-fly zone", "landing zone", *marks} <= set(told)
    pictures = page.eval_on_selector_all("#legend canvas", "all => all.map(canvas => canvas.toDataURL())")
    assert len(set(pictures)) == len(told)  # the start is told from the end


def test_devices_on_the_edge_of_the_map_are_drawn_as_a_whole(board, opened):
    columns = frozen_columns(load_scenario("Block8-DH-v0"), "test")
    cells = [cell[:count] for cell, count in zip(columns["device_cell"], columns["device_count"], strict=True)]
    episode = next(k for k, cell in enumerate(cells) if {0, 7} <= set(cell[:, 0]) & {0, 7} and {0, 7} <= set(cell[:, 1]))
    page = opened(board)
    watch(page, "Block8-DH-v0", "greedy", episode)
    drawn = """(depth) => {
        const canvas = document.querySelector(".pane canvas"), { width, height } = canvas, g = canvas.getContext("2d");
        const [right, below] = [width - depth, height - depth];
        const sides = [[0, 0, width, depth], [0, below, width, depth], [0, 0, depth, height], [right, 0, depth, height]];
        return sides.map((side) => g.getImageData(...side).data.some((value, k) => k % 4 === 3 && value));
    }"""
    assert page.evaluate(drawn, 0.7 * 1024 / 8) == [True] * 4
    assert page.evaluate(drawn, 1) == [False] * 4


@pytest.mark.parametrize("size", SIZES)
def test_the_scatter_names_every_agent_and_names_do_not_meet(official, opened, size):
    page = opened(official, **SIZES[size])
    for scenario in page.eval_on_selector_all("#scenario option", "all => all.map(option => option.value)"):
        page.select_option("#scenario", scenario)
        flown = page.evaluate(
            f"DATA.rows.filter(row => row.scenario === '{scenario}' && row.tier !== 'published').map(row => row.name)"
        )
        measure = "all => all.map(one => { const b = one.getBBox(); return [b.x, b.y, b.x + b.width, b.y + b.height]; })"
        boxes, points = (page.eval_on_selector_all(f"#scatter {each}", measure) for each in (".name", ".point"))
        assert sorted(page.eval_on_selector_all("#scatter .name", "all => all.map(one => one.dataset.name)")) == sorted(flown)
        assert len(points) == len(flown)
        width, height = page.evaluate(
            "[document.querySelector('#scatter').clientWidth, document.querySelector('#scatter').clientHeight]"
        )
        assert all(x0 >= 0 and x1 <= width and y0 >= 0 and y1 <= height for x0, y0, x1, y1 in boxes + points)
        for k, one in enumerate(boxes):
            for other in boxes[k + 1 :] + points:
                apart = one[2] <= other[0] or other[2] <= one[0] or one[3] <= other[1] or other[3] <= one[1]
                assert apart, (scenario, one, other)


def test_a_line_joins_the_agents_that_no_other_one_beats_in_score_and_time(official, opened):
    page = opened(official)
    page.select_option("#scenario", "Manhattan32-CPP-v0")
    rows = page.evaluate("DATA.rows.filter(row => row.scenario === 'Manhattan32-CPP-v0' && row.decisions_per_second)")
    best = [
        row["name"]
        for row in rows
        if not any(
            other["decisions_per_second"] > row["decisions_per_second"] and other["cral"][0] >= row["cral"][0] for other in rows
        )
    ]
    assert 1 < len(best) < len(rows)
    corners = [float(x) for x in re.findall(r"[MH]([0-9.]+)", page.get_attribute("#scatter .front", "d"))]
    places = page.evaluate(
        """Array.from(document.querySelectorAll("#scatter .point")).map((one) => {
            const box = one.getBBox(), said = one.querySelector("title").textContent;
            return [said.split(":")[0], box.x + box.width / 2];
        })"""
    )
    assert sorted(name for name, x in places if any(abs(x - corner) < 0.01 for corner in corners[:-1])) == sorted(best)


def test_says_how_each_agent_decides(official, opened):
    page = opened(official)
    page.select_option("#scenario", "Manhattan32-CPP-v0")
    told = {row.split()[0]: row for row in page.locator("#board tr.entry td.name").all_inner_texts()}
    for name, method in {"planner": "search on the state", "ddqn": "policy", "greedy": "rules"}.items():
        assert f"· {method} ·" in told[name]


def test_says_why_flights_on_large_maps_cannot_be_watched(official, opened):
    page = opened(official)
    for scenario, watched in (("City128-CPP-v0", False), ("City64-CPP-v0", True)):
        page.select_option("#scenario", scenario)
        assert page.is_visible("#unseen") != watched
        assert page.locator("#board .open").count() == page.locator("#board tr.opens").count()
        assert (page.locator("#board .open").count() == page.locator("#board tr.entry").count()) == watched
        assert page.locator("#board tr.published").count() == 0


def test_one_agent_far_below_does_not_take_most_of_the_axis(official, opened):
    page = opened(official)
    page.select_option("#scenario", "Manhattan32-CPP-v0")
    marks = page.eval_on_selector_all("#scatter text[text-anchor=end].quiet", "all => all.map(one => Number(one.textContent))")
    assert min(mark for mark in marks if not np.isnan(mark)) >= 70
    assert page.text_content("#scatter .name[data-name=random]") == "random 1.3"
    assert page.is_visible("#below")
    page.fill("#search", "planner")
    assert not page.is_visible("#below")


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
    legend = "document.querySelector('#legend canvas').toDataURL()"
    light = page.evaluate(legend)
    page.click("#theme")
    assert page.evaluate(legend) != light
