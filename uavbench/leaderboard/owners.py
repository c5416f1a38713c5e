"""Who owns a name: ``owners.toml`` beside ``submissions/``, to which each build adds the owners of new names.

File times do not prove who was first, and anybody can add files to a folder. So the first build that finds a name records its
owner. From then on only the board's maintainer can change the owner, by editing the file.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomli_w

from uavbench.leaderboard.submission import MANIFEST, Manifest, Submission, SubmissionError
from uavbench.world.files import FileError, read_toml

FILE = "owners.toml"

#: For the folder of each name, what its manifests say about the owner (`Manifest.hand`); the oldest name first.
Owners = dict[str, dict[str, Any]]


def load_owners(path: Path) -> Owners:
    """Read the owners of the names; empty when there is no file.

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
        raise SubmissionError(f"{path}: damaged ({error}): restore an earlier version of the file") from None
    return owners


def owners_text(owners: Owners) -> str:
    """Return the text of ``owners.toml``."""
    return tomli_w.dumps(owners)


def with_new_names(owners: Owners, submissions: Sequence[Submission]) -> Owners:
    """Return the owners of all names. A name without an owner goes to those who submitted most of its folders.

    If two submitted equally many, it is unknown who was first, and the name goes to neither.
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
    """Return why a submission may not use its name; None if it may."""
    if folder not in owners:
        return f"{MANIFEST}: authors: others submitted equally many folders under this name: write its owner in {FILE}"
    for field, value in manifest.hand.items():
        if value != owners[folder][field]:
            return (
                f"{MANIFEST}: {field}: not what {FILE} says of this name: choose another name, or, if it is yours, ask "
                f"the board's maintainer to change {FILE}"
            )
    return None
