"""Make the pictures of the README and the docs: flights, cities, and the leaderboard's page (which needs Debian's chromium).

Usage: python docs/make_pictures.py
"""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image, ImageDraw, ImageFont

import uavbench
from uavbench.agents.agent import find_agent
from uavbench.drawing.raster import raster
from uavbench.leaderboard.submission import load_submission
from uavbench.pictures.plot import save_plot
from uavbench.pictures.watch import recorded_scenes
from uavbench.simulation.state_view import StateView
from uavbench.world.cells import COLOURS
from uavbench.world.generators import GENERATORS, draw_cities
from uavbench.world.generators.parameters import CityParameters

IMAGES = Path(__file__).parent / "images"
SUBMISSIONS = Path(__file__).parent.parent / "leaderboard" / "submissions"
FLIGHTS = (("Manhattan32-CPP-v0", 17), ("Urban50-DH-v0", 17), ("Urban50-CPP-Team-v0", 13))


def fly(name, episode):
    """Fly a test episode with greedy; return the frames before and after, and what happened."""
    env = uavbench.parallel_env(name, render_mode="rgb_array")
    agent = find_agent("greedy").make(env.scenario)
    observations, infos = env.reset(options={"split": "test", "episode": episode})
    before, state = env.render(), env.simulator.state
    while env.agents:
        told = [{**infos[name], "state": StateView(env.simulator, 0, int(name[-1]))} for name in env.agents]
        actions = agent.act_team([observations[name] for name in env.agents], told)
        observations, _, _, _, infos = env.step(dict(zip(env.agents, actions, strict=True)))
    uavs = int(state.uavs[0])
    budget, left = state.initial_budget[0, :uavs].sum(), state.budget[0, :uavs].sum()
    cr = next(iter(infos.values()))["cr"]
    team = f", {uavs} UAVs" if env.scenario.team else ""
    return before, env.render(), f"{name} #{episode}{team}: {budget - left} of {budget} actions, CR {cr:.2f}"


def photograph():
    """Photograph the leaderboard, with two flights beside each other."""
    from playwright.sync_api import sync_playwright

    page_file = Path(__file__).parent.parent / "leaderboard" / "index.html"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1240, "height": 800}, color_scheme="light")
        page.goto(page_file.as_uri())
        page.select_option("#scenario", "Manhattan32-DH-v0")
        page.click("tr[data-name=planner] .open")
        page.wait_for_selector(".pane")
        page.select_option("#second", "greedy")
        page.wait_for_selector(".pane:nth-child(2)")
        page.fill("#episode", "17")
        page.dispatch_event("#episode", "change")
        page.wait_for_timeout(500)
        page.focus("#time")
        page.keyboard.press("End")
        for _ in range(25):
            page.keyboard.press("ArrowLeft")
        page.evaluate("document.activeElement.blur(); document.querySelector('section').hidden = true; scrollTo(0, 0)")
        page.screenshot(path=IMAGES / "leaderboard.png", full_page=True)
        browser.close()
    print(f"wrote {IMAGES / 'leaderboard.png'}")


def main():
    """Draw the figure."""
    figure, axes = plt.subplots(len(FLIGHTS), 2, figsize=(8, 4.2 * len(FLIGHTS)), layout="constrained")
    for row, flight in zip(axes, FLIGHTS, strict=True):
        *frames, title = fly(*flight)
        for axis, frame, name in zip(row, frames, ("start", title), strict=True):
            axis.imshow(frame)
            axis.set_title(name, fontsize=8)
            axis.axis("off")
    path = IMAGES / "greedy.png"
    figure.savefig(path, dpi=100)
    print(f"wrote {path}")


def plot():
    """Draw a flight of planner as the documentation shows it."""
    result = load_submission(SUBMISSIONS / "planner" / "Manhattan32-DH-v0").result
    save_plot(recorded_scenes(result, 17)[-1], IMAGES / "plot.png")
    print(f"wrote {IMAGES / 'plot.png'}")


def moving(scenario="Manhattan32-CPP-v0", episode=28, agents=("planner", "ddqn")):
    """Film two agents beside each other in an episode in which they differ by about as much as in the mean of all."""
    flights = [recorded_scenes(load_submission(SUBMISSIONS / agent / scenario).result, episode) for agent in agents]
    font = ImageFont.load_default(13)
    frames = []
    for step in range(max(map(len, flights))):
        panes = []
        for agent, scenes in zip(agents, flights, strict=True):
            picture = Image.fromarray(raster(scenes[min(step, len(scenes) - 1)]))
            pane = Image.new("RGB", (picture.width + 12, picture.height + 26), "white")
            pane.paste(picture, (6, 20))
            ImageDraw.Draw(pane).text((8, 2), f"{agent}, {scenes[min(step, len(scenes) - 1)].title}", "black", font)
            panes.append(np.asarray(pane))
        frames.append(Image.fromarray(np.concatenate(panes, axis=1)))
    palette = frames[-1].quantize(64, dither=Image.Dither.NONE)
    indexed = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    path = IMAGES / "flights.gif"
    durations = [110] * (len(indexed) - 1) + [3000]
    indexed[0].save(path, save_all=True, append_images=indexed[1:], duration=durations, loop=0, optimize=True)
    print(f"wrote {path}: {path.stat().st_size / 1e6:.2f} MB")


def cities(size=32, number=5, pixels=5):
    """Draw samples of each generator of cities with its default parameters: those of the first keys, row by row."""
    for name in GENERATORS:
        codes = np.empty((number * number, size, size), dtype=np.uint8)
        draw_cities(name, np.arange(len(codes), dtype=np.uint64), CityParameters(), 40, 1, 1, codes)
        tiles = np.pad(codes, ((0, 0), (0, 1), (0, 1)), constant_values=len(COLOURS))
        rows = tiles.reshape(number, number, size + 1, size + 1).swapaxes(1, 2).reshape(number * (size + 1), -1)[:-1, :-1]
        picture = Image.fromarray(rows.repeat(pixels, 0).repeat(pixels, 1))
        picture.putpalette([part for colour in (*COLOURS, (0, 0, 0)) for part in colour])
        path = IMAGES / f"cities-{name.removesuffix('-v0')}.png"
        picture.save(path, optimize=True)
        print(f"wrote {path}: {path.stat().st_size / 1e3:.1f} kB")


if __name__ == "__main__":
    cities()
    moving()
    main()
    plot()
    photograph()
