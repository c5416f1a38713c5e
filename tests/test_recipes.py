"""The recipes of the documentation run as they stand."""

import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[1] / "docs" / "recipes.md").read_text(encoding="utf-8")
BLOCKS = dict(re.findall(r"^## … (.*?)\?\n.*?^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL))


def test_every_block_is_run():
    assert len(BLOCKS) == PAGE.count("```python\n") == 8


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.integrations if "stable_baselines3" in code else ())
        for name, code in BLOCKS.items()
    ],
)
def test_a_recipe_runs(name, tmp_path, monkeypatch):
    if "stable_baselines3" in BLOCKS[name]:
        pytest.importorskip("stable_baselines3", reason="needs the extra: pip install -e '.[integrations]'")
    monkeypatch.chdir(tmp_path)
    exec(compile(BLOCKS[name], f"recipe: {name}", "exec"), {"__name__": "recipe"})
