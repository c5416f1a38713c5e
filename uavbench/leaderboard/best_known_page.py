"""``best_known.html``: the best known flight of each episode, with who found it and when, and its gap to the upper bound."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from uavbench.evaluation.reference import load_reference, reference_path
from uavbench.leaderboard.best_known import BestKnown
from uavbench.leaderboard.page import filled, watchable
from uavbench.leaderboard.published import PAPER_SCENARIOS
from uavbench.leaderboard.ranking import Entry
from uavbench.world.scenario import Scenario

_DIGITS = 4  # of fractions: CRAL in DH differs between platforms in later ones


def best_known_text(best: Mapping[str, tuple[Scenario, BestKnown]], entries: Sequence[Entry]) -> str:
    """Return the text of the page.

    Parameters
    ----------
    best : mapping
        The scenarios and their best known flights, by the scenario's id.
    entries : sequence of Entry
        The entries of the board: a flight that is one of theirs has a link to where it can be watched.
    """
    shown = watchable(entries)
    by_scenario: dict[str, list[Entry]] = {}
    for entry in entries:
        by_scenario.setdefault(entry.submission.scenario.id, []).append(entry)
    names = [*(name for name in PAPER_SCENARIOS if name in best), *(name for name in best if name not in PAPER_SCENARIOS)]
    found = {name: _scenario(*best[name], by_scenario.get(name, []), shown) for name in names if best[name][1]}
    return filled("best_known.html", found)


def _scenario(scenario: Scenario, best: BestKnown, entries: Sequence[Entry], shown: Mapping[str, int]) -> dict[str, Any]:
    """Return a scenario for JSON: columns over its episodes, which refer to lists of what is there often."""
    reference = load_reference(reference_path(scenario), scenario)
    authors = sorted({(each.name, each.authors) for each in best.values()})
    dates = sorted({each.date for each in best.values()})
    bounds = [reference[number].upper_bound if number in reference else math.nan for number in best]
    return {
        "episodes": list(best),
        "cral": [round(each.record.cral, _DIGITS) for each in best.values()],
        "bound": [None if math.isnan(bound) else round(bound, _DIGITS) for bound in bounds],
        "proved": [number in reference and reference[number].proved_optimal for number in best],
        "steps": [each.record.steps for each in best.values()],
        "authors": authors,
        "by": [authors.index((each.name, each.authors)) for each in best.values()],
        "dates": dates,
        "date": [dates.index(each.date) for each in best.values()],
        "watch": [_watched(number, best, entries, shown) for number in best],
    }


def _watched(number: int, best: BestKnown, entries: Sequence[Entry], shown: Mapping[str, int]) -> str | None:
    """Return the folder of an entry that flew the best known flight of an episode, if the board's page shows it."""
    for entry in entries:
        label = entry.submission.label
        if number < shown.get(label, 0) and np.array_equal(entry.flown[number].actions, best[number].record.actions):
            return label.split("/")[0]
    return None
