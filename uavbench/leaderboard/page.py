"""``index.html``: one file that holds the table and as many episodes and flights as it has room for; it makes no requests."""

import base64
import json
import math
import re
import zlib
from collections.abc import Sequence
from dataclasses import asdict, replace
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.evaluation.metrics import ROUNDING, Interval
from uavbench.leaderboard.published import PAPER_SCENARIOS
from uavbench.leaderboard.ranking import Entry, Row
from uavbench.world.cities import cells_of_cities, city_keys
from uavbench.world.episode import episode_keys, frozen_columns
from uavbench.world.keyed import QUANTILE
from uavbench.world.scenario import Scenario

_ELSEWHERE = (1000, 500, 200, 100)  # flights shown on scenarios other than the paper's: the first number that fits
_ROOM = 6_000_000  # actions, of a quarter of a byte each: so the page stays under 3 MB
_LARGEST = 64 * 64  # cells of a map whose flights are shown: maps and targets of larger ones need more room than all others


def _is_shown(scenario: Scenario) -> bool:
    """Return whether the page shows the flights of a scenario, and not only their scores."""
    return math.prod(scenario.shape) <= _LARGEST and frozen_columns(scenario, "test") is not None


def page_text(rows: Sequence[Row], entries: Sequence[Entry]) -> str:
    """Return the text of the page."""
    watched = [entry for entry in entries if _is_shown(entry.submission.scenario)]
    scenarios = {entry.submission.scenario.id: entry.submission.scenario for entry in watched}
    hidden = {entry.submission.scenario.id for entry in entries} - scenarios.keys()
    folders = {entry.submission.manifest.name: entry.submission.manifest.folder for entry in watched}
    elsewhere = _shown_elsewhere(watched)
    columns: list[dict[str, Any]] = []
    data = {
        "rows": [
            _row(row, None if row.tier == "published" or row.scenario in hidden else folders.get(row.name)) for row in rows
        ],
        "names": {folder: name for name, folder in folders.items()},
        "quantile": QUANTILE,
        "scenarios": {name: _scenario(scenario, elsewhere, columns) for name, scenario in scenarios.items()},
        "columns": columns,
        "flights": {entry.submission.label: _flights(entry, elsewhere) for entry in watched},
    }
    return filled("page.html", data)


def filled(template: str, data: Any) -> str:
    """Return a page: a template in which each mark like ``/*board.js*/`` is replaced by that file, and ``/*DATA*/`` by data."""
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    return re.sub(r"/\*(DATA|[\w.]+\.(?:js|css))\*/", lambda m: text if m[1] == "DATA" else _asset(m[1]), _asset(template))


def watchable(entries: Sequence[Entry]) -> dict[str, int]:
    """Return how many of its flights, from episode 0 on, the page shows of each entry, by its label."""
    watched = [entry for entry in entries if _is_shown(entry.submission.scenario)]
    elsewhere = _shown_elsewhere(watched)
    return {entry.submission.label: _shown(entry.submission.scenario, elsewhere) for entry in watched}


def _asset(name: str) -> str:
    return (files("uavbench.leaderboard") / "page" / name).read_text(encoding="utf-8")


def _row(row: Row, folder: str | None) -> dict[str, Any]:
    """Return a row for JSON, in per cent, with the folder of its flights."""
    percent = {name: _percent(getattr(row, name)) for name in ("landed", "cr", "cral")}
    single = {name: _scaled(getattr(row, name)) for name in ("iqm", "gap_to_best", "gap_to_bound")}
    plain = asdict(replace(row, landed=None, cr=None, cral=None))  # pyright: ignore[reportArgumentType]
    fresh = row.fresh_difference and _percent(row.fresh_difference)
    return {**plain, **percent, **single, "fresh_difference": fresh, "entry": folder}


def _percent(interval: Interval) -> list[float | None]:
    return [_scaled(value) for value in (interval.mean, interval.low, interval.high)]


def _scaled(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else round(100 * value, 4)


def _scenario(scenario: Scenario, elsewhere: int, columns: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what is needed to fly a scenario's test episodes. Its columns are added to ``columns``, equal ones only once."""
    frozen = frozen_columns(scenario, "test")
    assert frozen is not None
    count = _shown(scenario, elsewhere)
    where: dict[str, int] = {}
    for name, column in frozen.items():
        packed = _packed(column[:count])
        if packed not in columns:
            columns.append(packed)
        where[name] = columns.index(packed)
    mission = scenario.mission
    return {
        "id": scenario.id,
        **({"rows": scenario.rows} if scenario.cities is None else {"cities": _packed(_test_cities(scenario, count))}),
        "uavs": scenario.max_uavs,
        "mission": mission.model_dump(mode="json"),
        "channel": mission.viewer(scenario.shape),
        "recorded": scenario.splits.test.episodes,
        "episodes": where,
    }


def _test_cities(scenario: Scenario, episodes: int) -> NDArray[np.uint8]:
    """Return the cities of the first test episodes, as codes of cells: episode n is in city n modulo their number."""
    assert scenario.cities is not None
    number = min(scenario.cities.number_of_test_cities, episodes)
    return cells_of_cities(scenario, city_keys(scenario, episode_keys("test", np.arange(number))))


def _flights(entry: Entry, elsewhere: int) -> dict[str, Any]:
    """Return the actions of an entry's episodes, and which episodes have the lowest, the median and the highest CRAL."""
    count = _shown(entry.submission.scenario, elsewhere)
    actions = [record.actions for record in entry.flown[:count]]
    order = np.argsort(np.round(entry.values("cral")[:count] / ROUNDING), kind="stable")
    return {
        "lengths": _packed(np.array([len(each) for each in actions], dtype=np.uint16)),
        "actions": _packed(np.concatenate(actions)),
        "picks": {"worst": int(order[0]), "median": int(order[count // 2]), "best": int(order[-1])},
    }


def _actions(entries: Sequence[Entry], elsewhere: int) -> int:
    """Return how many actions the shown flights have."""
    shown = (record for entry in entries for record in entry.flown[: _shown(entry.submission.scenario, elsewhere)])
    return sum(record.actions.size for record in shown)


def _shown_elsewhere(watched: Sequence[Entry]) -> int:
    """Return how many flights are shown on scenarios other than the paper's."""
    return next((count for count in _ELSEWHERE if _actions(watched, count) <= _ROOM), _ELSEWHERE[-1])


def _shown(scenario: Scenario, elsewhere: int) -> int:
    """Return how many flights of a scenario are shown: all on the paper's scenarios, the first ``elsewhere`` on others."""
    episodes = scenario.splits.test.episodes
    return episodes if scenario.id in PAPER_SCENARIOS else min(episodes, elsewhere)


def _packed(array: NDArray[Any]) -> dict[str, Any]:
    """Return an array for JSON: its bytes, compressed by zlib, in base64."""
    content = base64.b64encode(zlib.compress(np.ascontiguousarray(array).tobytes(), 9)).decode()
    return {"dtype": str(array.dtype), "shape": array.shape, "data": content}
