"""Submitting: makes submissions of results in ``submissions/<name>/<scenario>/``, of all of them or of none."""

import os
import platform
import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import tomli_w
from pydantic import ValidationError

from uavbench.evaluation.results import Result
from uavbench.leaderboard.best_known import FOLDER as BEST_KNOWN
from uavbench.leaderboard.best_known import best_known_files, changes, improved, load_best_known, today
from uavbench.leaderboard.owners import FILE as OWNERS
from uavbench.leaderboard.owners import Owners, load_owners, why_not_its_own
from uavbench.leaderboard.submission import (
    LARGEST,
    MANIFEST,
    Manifest,
    SubmissionError,
    check,
    first_error,
    load_submission,
    shipped,
)
from uavbench.world.files import ARRAYS_BYTES, FileError, make_folder, read_bounded, read_toml, replace_folders, write_together


def submit(
    results: Sequence[Result],
    submissions: Path,
    *,
    name: str,
    authors: Sequence[str],
    link: str = "",
    method: str = "",
    training: str = "",
    hardware: str = "",
    on_checked: Callable[[Path], None] = lambda folder: None,
    on_best: Callable[[str, int], None] = lambda scenario, count: None,
) -> list[Path]:
    """Make a submission of each result; all are replayed first, and nothing is written if one is refused.

    Flights that are better than all that were submitted before become the best known flights of their episodes:
    `uavbench.leaderboard.best_known`.

    Returns
    -------
    list of Path
        The folders, ``submissions``/<name>/<scenario>. Folders that already exist are replaced.

    Raises
    ------
    SubmissionError
        When a result, or what the arguments say about it, cannot be submitted, or when the files of the best known flights are
        damaged.
    """
    if not results:
        raise SubmissionError("no results: give folders that uavbench evaluate wrote")
    told = {"name": name, "authors": tuple(authors), "link": link, "method": method, "training": training}
    told["hardware"] = hardware or this_machine()
    try:
        make_folder(submissions)
        with tempfile.TemporaryDirectory(prefix=".new-", dir=submissions) as staging:
            made = [_write(result, told, Path(staging)) for result in results]
            loaded = [load_submission(new) for new in made]
            best = submissions.resolve().parent / BEST_KNOWN
            files: dict[Path, bytes] = {}
            counts: dict[str, int] = {}
            for submission in loaded:
                known = load_best_known(best, submission.scenario)
                better = improved(known, submission, check(submission), today())
                counts[submission.scenario.id] = changes(known, better)
                if counts[submission.scenario.id]:
                    files |= best_known_files(best, submission.scenario, better)
                on_checked(submission.folder)
            folders = [submissions / new.relative_to(staging) for new in made]
            manifests = [submission.manifest for submission in loaded]
            _check_hand(manifests, folders)
            _check_owner(manifests[0], load_owners(submissions.resolve().parent / OWNERS))
            make_folder(folders[0].parent)
            replace_folders(dict(zip(folders, made, strict=True)))
            write_together(files)
    except OSError as error:
        raise SubmissionError(f"{error.filename or submissions}: {error.strerror or error}") from None
    for scenario, count in counts.items():
        on_best(scenario, count)
    return folders


def _check_hand(made: Sequence[Manifest], folders: Sequence[Path]) -> None:
    """Refuse to add to, or to replace, what somebody else has submitted under a name with the same folder.

    Name and authors must be those of every manifest that is already there; link and track must be those of the submissions that
    are not replaced. Name and authors are read from a damaged submission too, so that its authors can replace it.
    """
    new = made[0]
    for other in made[1:]:
        if other.hand != new.hand:
            tracks = f"{new.result.agent} has {new.result.track}, {other.result.agent} {other.result.track}"
            raise SubmissionError(f"track: {tracks}: all results under one name need the same track")
    for there in sorted(folders[0].parent.glob("[!.]*")):
        said = _said(there)
        if said is None:
            continue
        if (said.get("name"), said.get("authors")) != (new.name, list(new.authors)):
            by = f"{said.get('name')} by {_names(said.get('authors'))}"
            raise SubmissionError(f"name: {there.parent} is {by}: choose another name, or delete it first")
        result = said.get("result")
        track = cast("dict[str, Any]", result).get("track") if isinstance(result, dict) else None
        if there not in folders and (said.get("link", ""), track) != (new.link, new.result.track):
            told = f"{said.get('link') or 'none'} and track {track}"
            raise SubmissionError(f"link: {there} has {told}: use the same link and track, or submit its result again too")
    for folder in folders:
        strange = sorted({path.name for path in folder.glob("*")} - set(LARGEST))
        if strange:
            raise SubmissionError(f"{folder}: holds {strange[0]!r}, which does not belong to a submission: move it away first")


def _check_owner(manifest: Manifest, owners: Owners) -> None:
    """Refuse a name that has another owner on the board: the next build would refuse it too."""
    reason = why_not_its_own(manifest, manifest.folder, owners) if manifest.folder in owners else None
    if reason:
        raise SubmissionError(reason)


def _names(authors: object) -> str:
    return ", ".join(map(str, cast("list[object]", authors))) if isinstance(authors, list) else str(authors)


def _said(folder: Path) -> dict[str, Any] | None:
    """Return what the manifest in a folder says, without checking it; None if it cannot be read."""
    try:
        return read_toml(folder / MANIFEST)
    except FileError:
        return None


def _write(result: Result, told: Mapping[str, Any], submissions: Path) -> Path:
    """Write the submission of a result, and return its folder."""
    scenario = shipped(result.summary)
    try:
        summary = {name: value for name, value in result.summary.items() if name != "agent_file"}  # a path of this machine
        manifest = Manifest.model_validate({**told, "result": summary})
    except ValidationError as error:
        raise SubmissionError(first_error(error)) from None
    folder = submissions / manifest.folder / scenario
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise SubmissionError(f"{result.folder}: two results on {folder.name}: a name has one for each scenario") from None
    for file in ("episodes.csv", "actions.npz"):
        (folder / file).write_bytes(read_bounded(result.folder / file, ARRAYS_BYTES))
    (folder / MANIFEST).write_text(tomli_w.dumps(manifest.model_dump(mode="json", exclude_none=True)), encoding="utf-8")
    return folder


def this_machine() -> str:
    """Return the number of cores and the processor's name of this machine."""
    try:
        names = re.findall(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(encoding="utf-8"), re.MULTILINE)
    except OSError:
        names = []
    return f"{os.cpu_count()} × {names[0] if names else platform.processor() or platform.machine()}"
