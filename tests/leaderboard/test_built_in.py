"""The board's entries of built-in agents are what the shipped files fly."""

from pathlib import Path

import pytest

from uavbench.leaderboard.claims import is_built_in
from uavbench.leaderboard.submission import load_submission
from uavbench.world.resources import baseline_paths, earlier_digests

OFFICIAL = Path(__file__).parents[2] / "leaderboard" / "submissions"
ENTRIES = sorted(path for name in baseline_paths() for path in (OFFICIAL / name).glob("*"))


def test_the_names_of_earlier_versions_are_those_of_built_in_agents():
    known = [digest for agents in earlier_digests().values() for digests in agents.values() for digest in digests]
    assert all(set(agents) <= set(baseline_paths()) for agents in earlier_digests().values())
    assert len(set(known)) == len(known)


@pytest.mark.parametrize("folder", ENTRIES, ids=lambda folder: f"{folder.parent.name}-{folder.name}")
def test_every_entry_of_a_built_in_agent_counts_as_one(folder):
    """That today's file takes its actions, unless an earlier version took others, is what test_readme.py flies."""
    assert is_built_in(load_submission(folder))
