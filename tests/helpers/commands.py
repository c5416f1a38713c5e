"""Running commands in tests, and making results for them."""

import json
import shutil

from typer.testing import CliRunner

from uavbench.cli.app import app


def uavbench_command(*arguments):
    return CliRunner().invoke(app, [str(each) for each in arguments])


def renamed(result, folder, agent):
    """Copy a result to ``folder``, and name its agent ``agent``."""
    shutil.copytree(result.folder, folder)
    (folder / "summary.json").write_text(json.dumps({**result.summary, "agent": agent}), encoding="utf-8")
    return folder


def damaged(result, folder, **changes):
    """Copy a result to ``folder``, and change files: ``summary_json=f`` replaces the text of summary.json by f(text)."""
    shutil.copytree(result.folder, folder)
    for name, change in changes.items():
        path = folder / name.replace("_", ".", 1)
        path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    return folder
