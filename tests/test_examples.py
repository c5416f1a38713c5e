"""The examples of docs/integrations.md train with the libraries that they are for, and what they train can be scored."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "docs" / "examples"
ALONE, TEAM = "Block8-CPP-v0", "Manhattan32-CPP-Team-v0"


@pytest.mark.integrations
@pytest.mark.parametrize(
    ("name", "library", "scenario", "steps", "episodes", "least"),
    [
        ("sb3_ppo", "stable_baselines3", ALONE, 40_000, 200, 0.2),  # random has 0.15
        ("maskable_ppo", "sb3_contrib", ALONE, 40_000, 200, 0.2),
        ("torchrl_ppo", "torchrl", TEAM, 2_000, 10, 0.0),
        ("rllib_ppo", "ray.rllib", TEAM, 2_000, 10, 0.0),
    ],
)
def test_an_example_trains_and_is_scored(name, library, scenario, steps, episodes, least, tmp_path):
    pytest.importorskip(library, reason="needs the extra: pip install -e '.[integrations]'", exc_type=ImportError)
    for path in EXAMPLES.glob("*.py"):
        shutil.copy(path, tmp_path)
    environment = {**os.environ, "RAY_AUTH_MODE": "disabled"}

    def python(*words):
        subprocess.run([sys.executable, *words], cwd=tmp_path, env=environment, check=True)

    python(f"{name}.py", "--scenario", scenario, "--steps", str(steps))
    chosen = ("--scenario", scenario, "--split", "validation", "--episodes", str(episodes))
    python("-c", "from uavbench.cli import app; app()", "evaluate", "--agent", f"{name}.py", *chosen)
    summary = json.loads((tmp_path / "results" / scenario / name / "summary.json").read_text())
    assert summary["episodes"] == episodes
    assert summary["track"] == "observation"
    assert summary["metrics"]["cral"]["mean"] >= least


def test_every_example_is_shown_and_tested():
    page = (EXAMPLES.parent / "integrations.md").read_text(encoding="utf-8")
    for path in EXAMPLES.glob("*.py"):
        assert f"examples/{path.name}" in page
        assert f'("{path.stem}", ' in Path(__file__).read_text(encoding="utf-8")
