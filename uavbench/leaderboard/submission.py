"""A submission: a result, with who made it and how, in ``submissions/<name>/<scenario>/``.

It consists of the result's ``episodes.csv`` and ``actions.npz`` and of ``manifest.toml``: what its authors say and, in
``[result]``, the result's ``summary.json``. Such a folder may come from anybody, so every file is checked when it is read.
"""

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, ValidationError, field_validator, model_validator

from uavbench.agents.agent import Track
from uavbench.errors import UavbenchError
from uavbench.evaluation.evaluate import EpisodeRecord
from uavbench.evaluation.metrics import CONFIDENCE
from uavbench.evaluation.replay import fly_all_recorded
from uavbench.evaluation.results import Result, ResultError, checked_result
from uavbench.world.files import TOML_BYTES, check_name, read_toml
from uavbench.world.parameters import Record
from uavbench.world.resources import scenario_paths
from uavbench.world.scenario import Scenario, load_scenario

MANIFEST = "manifest.toml"
#: The files of a submission, and the largest size of each in bytes.
LARGEST = {MANIFEST: TOML_BYTES, "episodes.csv": 2**22, "actions.npz": 2**22}


#: Invisible characters that Python calls printable: fillers, blanks and variation selectors.
_SINGLE = {0x34F, 0x115F, 0x1160, 0x17B4, 0x17B5, 0x2800, 0x3164, 0xFFA0}
_UNSEEN = _SINGLE | {*range(0x180B, 0x1810), *range(0xFE00, 0xFE10), *range(0xE0100, 0xE01F0)}


def _printable(text: str) -> str:
    if not text.isprintable() or _UNSEEN & {ord(letter) for letter in text}:
        raise ValueError("holds characters that cannot be seen, or that change how others look")
    return text


def _named(text: str) -> str:
    if not any(unicodedata.category(letter)[0] in "LN" for letter in text):
        raise ValueError(f"{text!r}: a name needs a letter or a digit")
    return text


def _plain(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._+-]*( [A-Za-z0-9._+-]+)*", text):
        raise ValueError(f"{text!r}: begin with a letter or digit, and use only those, . _ + - and single spaces between")
    check_name(text)
    return text


_Line = Annotated[str, Field(max_length=200, strict=True), AfterValidator(_printable)]
_Name = Annotated[_Line, AfterValidator(_named)]
_Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$", strict=True)]
_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Count = Annotated[int, Field(strict=True, ge=1, le=10**12)]


#: How an agent decides. What is not known is an empty text.
METHODS = ("policy", "policy + mask", "rules", "search on a belief", "search on the state")


class SubmissionError(UavbenchError, ValueError):
    """A submission that is refused; the message says which and why, in one line."""


class Scores(Record):
    """A mean with its confidence interval, as in a summary."""

    mean: _Number
    low: _Number
    high: _Number


class CityScores(Record):
    """How CRAL differs between cities: see `uavbench.evaluation.cities.Spread`."""

    cities: _Count
    mean: _Number
    deviation: _Number
    tenth: _Number
    ninetieth: _Number


class Summary(Record):
    """What ``uavbench evaluate`` wrote in ``summary.json``, of a scenario that comes with the suite."""

    uavbench: _Line
    scenario: _Line
    scenario_digest: _Digest
    agent: _Line
    agent_sha256: _Digest
    track: Track
    transfer: Literal[True] | None = None
    split: _Line
    episodes: _Count
    metrics: dict[Literal["landed", "cr", "cral"], Scores]
    cral_over_cities: CityScores | None = None
    confidence: Annotated[float, Field(strict=True, ge=CONFIDENCE, le=CONFIDENCE)]
    decisions: _Count
    decisions_per_second: Annotated[float, Field(strict=True, ge=1e-3, le=1e9)]
    wall_time: Annotated[float, Field(strict=True, ge=0, le=1e9)]
    workers: _Count
    versions: Annotated[dict[Literal["python", "numpy", "numba", "platform"], _Line], Field(min_length=4)]


class Manifest(Record):
    """What a submission says about itself.

    Attributes
    ----------
    name : str
        The agent's name, as the leaderboard shows it.
    authors : tuple of str
        Who made it.
    link : str
        Where it is described: an http or https address, or empty.
    method : str
        How it decides: one of `METHODS`, or empty.
    training : str
        What it was trained on, with which seeds; empty for an agent that was not trained.
    hardware : str
        The machine on which it was flown.
    result : Summary
        What ``uavbench evaluate`` wrote.
    """

    name: Annotated[str, Field(max_length=40, strict=True), AfterValidator(_plain)]
    authors: Annotated[tuple[_Name, ...], Field(min_length=1, max_length=30)]
    link: _Line = ""
    method: _Line = ""
    training: _Line = ""
    hardware: _Line = ""
    result: Summary

    @field_validator("link")
    @classmethod
    def _web(cls, link: str) -> str:
        if link and not re.fullmatch(r"https?://[^\s\"'<>]+", link):
            raise ValueError("write an address that begins with http:// or https://, or nothing")
        return link

    @field_validator("method")
    @classmethod
    def _known(cls, method: str) -> str:
        if method and method not in METHODS:
            raise ValueError(f"write one of {', '.join(METHODS)}, or nothing")
        return method

    @model_validator(mode="after")
    def _sees_what_it_uses(self) -> Self:
        if self.method == METHODS[-1] and self.result.track != "state":
            raise ValueError(f"method: {self.method!r} does not go with the track {self.result.track!r}")
        return self

    @property
    def folder(self) -> str:
        """The name of the agent's folder."""
        return self.name.lower().replace(" ", "-")

    @property
    def hand(self) -> dict[str, Any]:
        """What must be the same in all submissions under one name."""
        return {"name": self.name, "authors": list(self.authors), "link": self.link, "track": self.result.track}


@dataclass(frozen=True)
class Submission:
    """A submission that was read, but not yet replayed."""

    folder: Path
    manifest: Manifest
    result: Result
    scenario: Scenario

    @property
    def label(self) -> str:
        """The submission's name in messages."""
        return _label(self.folder)


def load_submission(folder: Path) -> Submission:
    """Read the submission in ``folder``.

    Raises
    ------
    SubmissionError
        When a file is missing, too large, a link or not valid, or when the folder, the scenario or its digest, the split or the
        number of episodes is wrong.
    """
    label = _label(folder)
    try:
        _check_files(folder)
        manifest = Manifest.model_validate(read_toml(folder / MANIFEST))
        result = checked_result(folder, manifest.result.model_dump(exclude_none=True))
        scenario = load_scenario(shipped(result.summary))
    except ValidationError as error:
        raise SubmissionError(f"{label}: {MANIFEST}: {first_error(error)}") from None
    except (KeyError, TypeError) as error:
        raise SubmissionError(f"{label}: {MANIFEST}: result: {error}: missing or of a wrong type") from None
    except (OSError, SubmissionError) as error:
        raise SubmissionError(f"{label}: {getattr(error, 'strerror', None) or error}") from None
    except (ValueError, RecursionError) as error:
        raise SubmissionError(f"{label}: {MANIFEST}: {error}") from None
    said = {
        "folders": (label, f"{manifest.folder}/{scenario.id}"),
        "result.scenario_digest": (manifest.result.scenario_digest, scenario.digest),
        "result.split": (manifest.result.split, "test"),
        "result.episodes": (manifest.result.episodes, scenario.splits.test.episodes),
    }
    for field, (found, expected) in said.items():
        if found != expected:
            raise SubmissionError(f"{label}: {MANIFEST}: {field}: {found}, expected {expected}")
    return Submission(folder, manifest, result, scenario)


def check(submission: Submission) -> list[EpisodeRecord]:
    """Replay every action of a submission, and return the records.

    Raises
    ------
    SubmissionError
        When a number is not reproduced.
    """
    try:
        flown, wrong = fly_all_recorded(submission.result)
    except (ResultError, ValueError) as error:
        raise SubmissionError(f"{submission.label}: {error}") from None
    if wrong:
        more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
        raise SubmissionError(f"{submission.label}: not reproduced: {wrong[0]}{more}")
    return flown


def _check_files(folder: Path) -> None:
    """Refuse a folder that has other files than a submission, or files that are missing, not plain files, or too large."""
    if folder.name.startswith("."):
        raise SubmissionError("is a hidden folder, as a killed submit leaves: submit again, and delete it if it stays")
    if folder.is_symlink() or not folder.is_dir():
        raise SubmissionError("is not a folder, or is a link")
    if not any(folder.iterdir()):
        raise SubmissionError("is empty")
    for path in folder.iterdir():
        if path.name not in LARGEST:
            raise SubmissionError(f"{path.name!r} does not belong to a submission")
    for name, largest in LARGEST.items():
        path = folder / name
        if path.is_symlink() or not path.is_file():
            raise SubmissionError(f"{name}: missing, or not a plain file")
        if path.stat().st_size > largest:
            raise SubmissionError(f"{name}: larger than {largest:,} bytes")


def shipped(summary: Mapping[str, Any]) -> str:
    """Return the id of a summary's scenario, if it comes with the suite.

    Raises
    ------
    SubmissionError
        When it does not.
    """
    name = summary["scenario"]
    if name not in scenario_paths() or "scenario_file" in summary:
        raise SubmissionError(f"result.scenario: {name!r} does not come with uavbench: others cannot replay it")
    return name


def _label(folder: Path) -> str:
    return f"{folder.parent.name}/{folder.name}"


def first_error(error: ValidationError) -> str:
    """Return the first thing that is wrong, with its field."""
    first = error.errors()[0]
    return f"{'.'.join(map(str, first['loc']))}: {first['msg'].removeprefix('Value error, ')}"
