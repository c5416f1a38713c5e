"""The id and the mission of an imported city, which must agree: from the options, or from the name of the file to write."""

import re
import unicodedata
from pathlib import Path
from typing import Literal

from uavbench.errors import one_line
from uavbench.geodata.libraries import GeodataError

MissionName = Literal["cpp", "dh"]

_MISSIONS: tuple[MissionName, ...] = ("cpp", "dh")
_ID = re.compile(r"[A-Za-z0-9]+(-[A-Za-z0-9]+)*-v[0-9]+")
_LONGEST_ID = 100
#: Letters that Unicode does not take apart into an ASCII letter and a mark.
_LETTERS = {
    **str.maketrans("øØłŁđĐðÐħĦŧŦı", "oOlLdDdDhHtTi"),
    **str.maketrans({"ß": "ss", "ẞ": "SS", "æ": "ae", "Æ": "Ae", "œ": "oe", "Œ": "Oe", "þ": "th", "Þ": "Th"}),
}


def name_city(out: Path, wanted: str | None, mission: MissionName | None) -> tuple[str, MissionName]:
    """Return the id and the mission of a scenario that is written to ``out``.

    Parameters
    ----------
    out : Path
        ``my_city.toml`` becomes ``MyCity-CPP-v0``; a name that is an id stays as it is.
    wanted : str or None
        The id, if the user gives one.
    mission : {"cpp", "dh"} or None
        The mission, if the user gives one. Otherwise it is the one that the id names, and coverage if the id names none.

    Raises
    ------
    GeodataError
        When the id is not valid, or names another mission than the one that is given.
    """
    text = out.stem if wanted is None else wanted
    if wanted is not None:
        _check_id(wanted)
    named = _mission_of(text)
    if mission and named and mission != named:
        what, fix = ("name of the file", "--out") if wanted is None else ("id", "--id")
        raise GeodataError(
            f"mission: {mission} contradicts the {what} {one_line(text)}, which names {named.upper()}: "
            f"leave out --mission, or choose another {fix}"
        )
    chosen: MissionName = mission or named or "cpp"
    if _ID.fullmatch(text):
        return text, chosen
    ending = f"-{chosen.upper()}-v0"
    place = "".join(word[0].upper() + word[1:] for word in _without_mission(_words(text)))
    return f"{place[: _LONGEST_ID - len(ending)] or 'City'}{ending}", chosen


def place_of(name: str) -> str:
    """Return an id without the word that names its mission, and without its version: the name of the place."""
    words = name.rpartition("-v")[0].split("-")
    return "-".join(_without_mission(words) or words)


def _check_id(name: str) -> None:
    """Refuse an id that no scenario can have."""
    if len(name) > _LONGEST_ID:
        raise GeodataError(f"id: {one_line(name[:40], repr)}… has {len(name):,} characters: at most {_LONGEST_ID} are allowed")
    if not _ID.fullmatch(name):
        raise GeodataError(f"id: {one_line(name, repr)} is not of the form expected, as in MyCity-CPP-v0")


def _words(text: str) -> list[str]:
    """Return the words of a text in ASCII letters and digits: ``Städt 城`` has the word ``Stadt``.

    Letters without an ASCII form are left out, but do not part a word.
    """
    flat = unicodedata.normalize("NFKD", text.translate(_LETTERS))
    kept = "".join(letter for letter in flat if letter.isascii() or unicodedata.category(letter)[0] not in "LMN")
    return re.findall(r"[A-Za-z0-9]+", kept)


def _mission_of(text: str) -> MissionName | None:
    """Return the mission that a text names by its last word CPP or DH; None if it names none."""
    found: list[MissionName] = [mission for word in _words(text) for mission in _MISSIONS if word.lower() == mission]
    return found[-1] if found else None


def _without_mission(words: list[str]) -> list[str]:
    """Return words without the last one that names a mission."""
    last = max((n for n, word in enumerate(words) if word.lower() in _MISSIONS), default=None)
    return [word for n, word in enumerate(words) if n != last]
