"""What is known about a submission besides its score, and what is only claimed: a replay proves only actions and score."""

import ast
import hashlib
from functools import lru_cache
from pathlib import Path

from uavbench.agents.agent import find_agent
from uavbench.leaderboard.submission import Manifest, Submission
from uavbench.world import resources
from uavbench.world.scenario import Scenario


def is_built_in(submission: Submission) -> bool:
    """Say whether a submission is of an agent that comes with uavbench, as far as its manifest can show it.

    The name, the agent, its digest on this scenario and its track must be those of the shipped file. Anybody can copy all of
    them, but only the owner of the name can submit under it (`uavbench.leaderboard.owners`).
    """
    manifest = submission.manifest
    said, path = manifest.result, resources.baseline_paths().get(manifest.name)
    if path is None or said.agent != manifest.name or said.track != _track(path):
        return False
    return said.agent_sha256 in _digests(manifest, submission.scenario)


def _digests(manifest: Manifest, scenario: Scenario) -> set[str]:
    """Return the digests that count as the shipped agent's: the current one, that of file and weights, earlier ones."""
    source = find_agent(manifest.name)
    weights = resources.shipped_weights(manifest.name).get(scenario.id)
    plain = hashlib.sha256(source.path.read_bytes()).hexdigest()
    if weights:
        plain = hashlib.sha256((plain + hashlib.sha256(weights.read_bytes()).hexdigest()).encode()).hexdigest()
    earlier = (digest for agents in resources.earlier_digests().values() for digest in agents.get(manifest.name, ()))
    return {source.digest(scenario), plain, *earlier}


@lru_cache
def _track(path: Path) -> str:
    """Return a shipped agent's track without importing its file, so that the board does not depend on installed packages."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.Assign(targets=[ast.Name(id="track")], value=ast.Constant(value=str(track))):
                return track
            case _:
                continue
    return "observation"
