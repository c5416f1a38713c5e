"""Whose a name is: ``owners.toml`` beside ``submissions/``, in which each build writes down the names that are new.

Times of files say nothing about who was first, and a folder holds what anybody put there. So the first build with a name keeps
its owner, and from then on only who keeps the board can change that, by editing the file.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomli_w

from uavbench.leaderboard.submission import MANIFEST, Manifest, Submission, SubmissionError
from uavbench.world.files import FileError, read_toml

FILE = "owners.toml"

#: What the manifests of a name say of its owner (`Manifest.hand`), by the name's folder, the oldest first.
Owners = dict[str, dict[str, Any]]


def load_owners(path: Path) -> Owners:
    """Read whose the names are; nothing when there is no file.

    Raises
    ------
    SubmissionError
        When the file is damaged.
    """
    if not path.exists():
        return {}
    try:
        owners: Owners = read_toml(path)
        for folder, owner in owners.items():
            if owner.keys() != {"name", "authors", "link", "track"}:
                raise ValueError(f"{folder}: expected name, authors, link and track")
    except (FileError, ValueError, AttributeError) as error:
        raise SubmissionError(f"{path}: damaged ({error}): take the file as it was before") from None
    return owners


def owners_text(owners: Owners) -> str:
    """Return the file's text."""
    return tomli_w.dumps(owners)


def with_new_names(owners: Owners, submissions: Sequence[Submission]) -> Owners:
    """Return the owners of all names: a name that nobody owned goes to whoever has most of its folders.

    Where two have as many, nobody can tell who was first, and the name goes to neither.
    """
    claims: dict[str, list[dict[str, Any]]] = {}
    for submission in submissions:
        claims.setdefault(submission.folder.parent.name, []).append(submission.manifest.hand)
    new: Owners = {}
    for folder, hands in claims.items():
        most = max(map(hands.count, hands))
        first, *others = [hand for hand in hands if hands.count(hand) == most]
        if all(other == first for other in others):
            new[folder] = first
    return {**owners, **{folder: owner for folder, owner in sorted(new.items()) if folder not in owners}}


def why_not_its_own(manifest: Manifest, folder: str, owners: Mapping[str, Mapping[str, Any]]) -> str | None:
    """Return why a submission may not stand under its name; None where it may."""
    if folder not in owners:
        return f"{MANIFEST}: authors: others hand in as much under this name: write in {FILE} whose it is"
    for field, value in manifest.hand.items():
        if value != owners[folder][field]:
            return (
                f"{MANIFEST}: {field}: another than {FILE} says of this name: choose another name, or, if it is yours, have "
                f"whoever keeps the board change {FILE}"
            )
    return None
