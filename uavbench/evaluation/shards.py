"""Shards: an evaluation in parts, which batch systems fly on different machines, and the result that is made of all of them.

Shard K of N has the episodes K − 1, K − 1 + N, K − 1 + 2 N, …, so that each has some of the easy and some of the hard ones.
"""

import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from uavbench.evaluation.kept import FILE, Kept, check_kept, different, read_kept, write_kept
from uavbench.evaluation.results import Result, ResultError, load_result, publish, scenario_file
from uavbench.world.episode import check_split, split_size
from uavbench.world.scenario import Scenario, load_scenario

_MOST = 100_000  # shards


@dataclass(frozen=True)
class Shard:
    """One part of an evaluation.

    Attributes
    ----------
    number, count : int
        This is shard ``number``, from 1 on, of ``count``.
    episodes : int
        The number of episodes of the whole evaluation.
    """

    number: int
    count: int
    episodes: int

    @property
    def numbers(self) -> range:
        """The episodes of this shard."""
        return range(self.number - 1, self.episodes, self.count)

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def folder_name(self, agent: str) -> str:
        """Return the name of the folder that keeps an agent's shard."""
        return f"{agent}.shard-{self.number}-of-{self.count}"


def read_shard(text: str, episodes: int) -> Shard:
    """Return the shard that a text names, as ``3/16``, of an evaluation of so many episodes.

    Raises
    ------
    ResultError
        When it names none.
    """
    found = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text)
    number, count = (int(part) for part in found.groups()) if found else (0, 0)
    if not 1 <= number <= count <= _MOST:
        raise ResultError(f"--shard {text}: it must be K/N with K from 1 to N, for example 3/16")
    if count > episodes:
        raise ResultError(f"--shard {text}: there are more shards than the {episodes} episodes")
    return Shard(number, count, episodes)


def write_shard(folder: Path, scenario: Scenario, kept: Kept) -> Path:
    """Keep the episodes of a shard in its folder, which is returned.

    Raises
    ------
    OSError
        When it cannot be written.
    """
    write_kept(folder, Kept({**kept.identity, **scenario_file(scenario)}, kept.records, kept.spent))
    return folder


def merge(
    folders: Sequence[Path],
    out: Path,
    *,
    scenario: str | None = None,
    overwrite: bool = False,
    on_shard: Callable[[Path], None] = lambda folder: None,
) -> Result:
    """Make the result of all shards of an evaluation, and write it to ``out``/<scenario>/<agent>.

    Every episode is flown again from its actions. The result is the one that an evaluation in one piece gives, apart from the
    times.

    Parameters
    ----------
    folders : sequence of Path
        The folders of the shards, in any order.
    out : Path
        The folder of all results.
    scenario : str, optional
        The .toml file of a scenario of one's own, if it has moved.
    overwrite : bool
        Replace a result that is there already.
    on_shard : callable
        Called with the folder of each shard that has been checked.

    Raises
    ------
    ResultError
        When shards are missing, are there twice, are of different evaluations, or are damaged.
    """
    shards = [(folder, _read(folder)) for folder in folders]
    if not shards:
        raise ResultError("no shard is given: name the folders that evaluate --shard wrote")
    first, facts = shards[0][0], {name: value for name, value in shards[0][1].identity.items() if name != "shard"}
    for folder, kept in shards[1:]:
        for name in different(kept.identity, facts):
            if name not in ("agent_file", "scenario_file"):  # each machine may have its own folders
                found = kept.identity.get(name)
                raise ResultError(f"{folder} is of another evaluation than {first}: its {name} is {found}, not {facts[name]}")
    _check_whole(shards, facts["episodes"])
    loaded = _scenario(scenario or facts.get("scenario_file") or facts["scenario"], facts, first)
    folder = out.absolute() / loaded.id / facts["agent"]
    if folder.exists() and not overwrite:
        _check_same(folder, facts)
    for each, kept in shards:
        check_kept(each, kept, loaded, check_split(facts["split"]))
        on_shard(each)
    records = {number: record for _, kept in shards for number, record in kept.records.items()}
    seconds = sum(kept.spent for _, kept in shards)
    known = {name: value for name, value in facts.items() if name != "scenario_file"}
    try:
        return publish(folder, known, loaded, [records[number] for number in range(facts["episodes"])], seconds, len(shards))
    except OSError as error:
        raise ResultError(f"--out: cannot write {error.filename or folder}: {error.strerror}") from None


def _read(folder: Path) -> Kept:
    """Return a shard's episodes."""
    kept = read_kept(folder)
    if kept is None or "shard" not in kept.identity:
        raise ResultError(f"{folder} holds no shard: give a folder that evaluate --shard wrote, <agent>.shard-K-of-N")
    missing = {"uavbench", "scenario_digest", "agent_sha256", "track"} - kept.identity.keys()
    texts = [value for name, value in kept.identity.items() if name not in ("episodes", "transfer")]
    episodes = kept.identity["episodes"]
    agent = str(kept.identity["agent"])  # it becomes the name of a folder
    named = agent.isprintable() and not set(agent) & {"/", "\\"} and agent not in ("", ".", "..")
    if missing or not all(isinstance(value, str) for value in texts) or not isinstance(episodes, int) or not named:
        raise ResultError(f"{folder / FILE}: damaged (its identity is not complete); delete its folder to start over")
    shard = read_shard(kept.identity["shard"], episodes)
    if sorted(kept.records) != list(shard.numbers):
        raise ResultError(f"{folder / FILE}: damaged (it does not have the episodes of shard {shard}); delete its folder")
    return kept


def _check_whole(shards: Sequence[tuple[Path, Kept]], episodes: int) -> None:
    """Raise a ResultError if an episode is in two shards or in none."""
    places: dict[int, list[Path]] = defaultdict(list)
    for folder, kept in shards:
        for number in kept.records:
            places[number].append(folder)
    for number, found in sorted(places.items()):
        if len(found) > 1:
            raise ResultError(f"episode {number} is in {found[0]} and in {found[1]}: give each shard once")
    absent = sorted(set(range(episodes)) - places.keys())
    if absent:
        counts = {kept.identity["shard"].split("/")[1] for _, kept in shards}
        there = {kept.identity["shard"] for _, kept in shards}
        missing = [f"{k}/{count}" for count in counts for k in range(1, int(count) + 1) if f"{k}/{count}" not in there]
        lacking = f"; not given: shards {', '.join(missing[:8])}{'…' if len(missing) > 8 else ''}" if len(counts) == 1 else ""
        raise ResultError(f"{len(absent)} of {episodes} episodes are in no shard, the first of them {absent[0]}{lacking}")


def _scenario(name: str, facts: dict[str, object], folder: Path) -> Scenario:
    """Return the scenario of a shard, after checking that it is the one that was flown."""
    scenario = load_scenario(name, run_code=False)
    if (scenario.id, scenario.digest) != (facts["scenario"], facts["scenario_digest"]):
        raise ResultError(
            f"{folder} was flown on another version of {facts['scenario']} than {name}: give the file of that scenario with "
            "--scenario, or fly it again"
        )
    size = split_size(scenario, check_split(str(facts["split"])))
    if not 1 <= int(str(facts["episodes"])) <= size:
        raise ResultError(f"{folder / FILE}: damaged ({facts['episodes']} episodes, but the split has {size})")
    return scenario


def _check_same(folder: Path, facts: dict[str, object]) -> None:
    """Raise a ResultError if the result in a folder is not of the same evaluation."""
    finished = load_result(folder)
    names = [name for name in different(finished.summary, facts) if name not in ("agent_file", "scenario_file")]
    if names:
        raise ResultError(f"{folder} holds a result whose {names[0]} is another one: give another --out, or --overwrite")
