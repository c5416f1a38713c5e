"""``leaderboard.csv``: the rows of the leaderboard, in per cent."""

import csv
import io
import math
from collections.abc import Sequence

from uavbench.evaluation.metrics import METRICS, Interval
from uavbench.evaluation.spreadsheet import plain_cell
from uavbench.leaderboard.ranking import Row

COLUMNS = (
    *("scenario", "track", "track_known_by", "rank", "name", "authors", "link", "method", "training", "tier", "rerun_episodes"),
    *("fresh_episodes", "fresh_difference", "fresh_difference_low", "fresh_difference_high", "note", "episodes"),
    *(f"{name}{part}" for name in METRICS for part in ("", "_low", "_high")),
    *("iqm", "steps", "decisions_per_second_claimed", "gap_to_best_known", "gap_to_bound", "compared", "bounded"),
    "flown_safely",
)


def table_text(rows: Sequence[Row]) -> str:
    """Return the text of the file, which is the same on every machine. Scores are in per cent with two digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        writer.writerow(
            [
                *(row.scenario, row.track, row.track_known_by, "" if row.rank is None else row.rank),
                *(plain_cell(part) for part in (row.name, row.authors, row.link, row.method, row.training)),
                *(row.tier, row.rerun_episodes, row.fresh_episodes),
                *(_cells(row.fresh_difference) if row.fresh_difference else ("", "", "")),
                *(row.note, row.episodes),
                *(cell for name in METRICS for cell in _cells(getattr(row, name))),
                *(_percent(row.iqm), _number(row.steps, 1), _number(row.decisions_per_second, 0)),
                *(_percent(row.gap_to_best), _percent(row.gap_to_bound), row.compared, row.bounded),
                "; ".join(f"{each.safe} of {each.flown} at {each.speed:g} m/s" for each in row.safety),
            ]
        )
    return text.getvalue()


def _cells(interval: Interval) -> list[str]:
    return [_percent(value) for value in (interval.mean, interval.low, interval.high)]


def _percent(value: float | None) -> str:
    return _number(None if value is None else 100 * value, 2)


def _number(value: float | None, digits: int) -> str:
    """Write a number without a minus before zero; an empty text for None and NaN."""
    if value is None or math.isnan(value):
        return ""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0 else text
