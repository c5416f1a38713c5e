"""A page for each scenario, generated from its definition when the documentation is built: a Sphinx extension."""

import csv
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uavbench import list_scenarios, load_scenario
from uavbench.drawing.scene import city_colours
from uavbench.pictures.plot import city_legend
from uavbench.world.cells import CELL_NAMES, LOW_BUILDING
from uavbench.world.shown_map import shown_city

DOCS = Path(__file__).parent
FOLDER = DOCS / "scenario"
BOARD = DOCS.parent / "leaderboard" / "leaderboard.csv"
#: What each version of an id changed; the first one is the same for all.
HISTORY: dict[str, str] = {}
FIRST = "The rules of the paper and of the authors' code, branch `icar`, [corrected](../errata.md)"


def write_pages(_app=None):
    """Write all pages and maps, and the page that lists them."""
    FOLDER.mkdir(exist_ok=True)
    names = list_scenarios()
    for name in names:
        scenario = load_scenario(name)
        draw_map(scenario, FOLDER / f"{name}.png")
        write(FOLDER / f"{name}.md", page(scenario))
    heads = ("id", "map", "test cities", "mission", "UAVs", "budget", "targets")
    lines = ["# All scenarios", "", f"| {' | '.join(heads)} |", f"|{' --- |' * len(heads)}"]
    for name in names:
        s = load_scenario(name)
        uavs = "{}–{}".format(*s.uavs) if s.uavs else "1"
        lines.append(
            f"| [{name}]({name}.md) | {s.shape[0]}×{s.shape[1]} | {test_cities(s)} | {s.mission.kind} | {uavs} | "
            f"{s.budget[0]}–{s.budget[1]} | {s.mission.targets} |"
        )
    write(FOLDER / "index.md", "\n".join([*lines, "", "```{toctree}", ":hidden:", "", *names, "```", ""]))


def test_cities(scenario):
    """Return how many cities the test split of a scenario has."""
    return scenario.cities.number_of_test_cities if scenario.cities else 1


def write(path, text):
    """Write a file if it has changed, so that Sphinx need not read it again."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def page(scenario):
    """Return the page of a scenario."""
    mission, rewards, sizes = scenario.mission, scenario.rewards, scenario.observation
    what = "Cities" if scenario.cities else "The map"
    parameters = {
        "movement budget": "{}–{}".format(*scenario.budget),
        "UAVs": "{}–{}".format(*scenario.uavs) if scenario.uavs else "1",
        "targets": mission.targets,
        "reward of a movement, of staying unwillingly, of a crash, of a unit": (
            f"{rewards.movement:g}, {rewards.safety:g}, {rewards.crash:g}, {rewards.collect:g}"
        ),
        "observation": f"l = {sizes.local_size}, g = {sizes.global_scale}",
        **{f"`{name}`": f"`{value}`" for name, value in mission.model_dump(mode="json", exclude_none=True).items()},
        **source(scenario),
        "validation and test episodes": f"{scenario.splits.validation.episodes}, {scenario.splits.test.episodes}",
        **({"map data": scenario.provenance.licence} if scenario.provenance else {}),
        "digest": f"`{scenario.digest[:16]}…`",
    }
    return "\n".join(
        [
            f"# {scenario.id}",
            "",
            f"{scenario.title}. [The rules](../rules.md) are those of all scenarios.",
            "",
            f"```{{image}} {scenario.id}.png\n:alt: {what} of {scenario.id}\n:width: 420px\n```",
            "",
            "| parameter | value |",
            "| --- | --- |",
            *(f"| {name} | {value} |" for name, value in parameters.items()),
            "",
            "```console",
            f"uavbench evaluate --agent my_agent.py --scenario {scenario.id}",
            "```",
            "",
            "## Results",
            "",
            *results(scenario.id),
            "",
            "## Version history",
            "",
            *history(scenario),
            "",
        ]
    )


def source(scenario):
    """Return what a page says about the map, or about the cities."""
    if scenario.cities is None:
        counts = np.bincount(shown_city(scenario, "test", 0).ravel(), minlength=len(CELL_NAMES)).tolist()
        listed = ", ".join(f"{count:,} {name}" for name, count in zip(CELL_NAMES, counts, strict=True) if count)
        return {"cells": f"{np.prod(scenario.shape):,}: {listed}"}
    cities = scenario.cities.model_dump(mode="json", exclude_none=True, exclude={"frozen", "files", "maps"})
    return {f"`cities.{name}`": f"`{value}`" for name, value in cities.items()}


def history(scenario):
    """Return a line for each version of an id up to this one."""
    name, _, version = scenario.id.rpartition("-v")
    papers = scenario.team is False and name.startswith(("Manhattan32", "Urban50"))
    own = "" if papers else "; the map, the cities or the team are this suite's own"
    lines = [f"- **v0**: {FIRST}{own}."]
    for k in range(1, int(version) + 1):
        if f"{name}-v{k}" not in HISTORY:
            raise KeyError(f"docs/scenario_pages.py: HISTORY: say what {name}-v{k} changed")
        lines.append(f"- **v{k}**: {HISTORY[f'{name}-v{k}']}")
    return lines


def results(name):
    """Return the tables of a scenario's rows of the leaderboard, one a track, in %."""
    rows = [row for row in csv.DictReader(BOARD.read_text(encoding="utf-8").splitlines()) if row["scenario"] == name]
    if not rows:
        return ["None on the leaderboard."]
    lines = ["In %, with the 95 % interval of CRAL."]
    for track in dict.fromkeys(row["track"] for row in rows):
        lines += [
            "",
            f"Agents that see the {'observation only' if track == 'observation' else 'whole state'}:",
            "",
            "| rank | agent | Landed | CR | CRAL | | tier |",
            "| ---: | --- | ---: | ---: | ---: | ---: | --- |",
        ]
        for row in sorted((row for row in rows if row["track"] == track), key=lambda row: -float(row["cral"])):
            interval = f"[{row['cral_low']}, {row['cral_high']}]" if row["cral_low"] else ""
            cells = [row["rank"], row["name"], row["landed"], row["cr"], row["cral"], interval, row["tier"]]
            lines.append("| " + " | ".join(cells) + " |")
    return lines


def draw_map(scenario, path):
    """Draw a map with its legend; of many cities, the first nine test cities."""
    count = min(9, test_cities(scenario))
    side = round(count**0.5)
    figure = Figure(figsize=(4.2, 4.7), layout="constrained")
    low = False
    for number, axes in enumerate(np.ravel(figure.subplots(side, side))):
        cells = shown_city(scenario, "test", number)
        low |= bool((cells == LOW_BUILDING).any())
        axes.imshow(city_colours(cells), interpolation="nearest")
        axes.tick_params(labelsize=6)
        if count > 1:
            axes.set_axis_off()
    figure.legend(handles=city_legend(low), loc="outside lower center", ncols=3, fontsize=7, frameon=False)
    figure.savefig(path, dpi=150, metadata={"Software": None})


def setup(app):
    """Be a Sphinx extension."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True}
