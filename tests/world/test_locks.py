"""Only one process holds a folder, and one that was killed holds nothing."""

import subprocess
import sys

import pytest

from uavbench.world.locks import BusyError, held


def test_a_killed_process_holds_nothing(tmp_path):
    code = (
        "import os, signal\nfrom pathlib import Path\nfrom uavbench.world.locks import held\n"
        f"with held(Path({str(tmp_path / 'held')!r})):\n    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    with held(tmp_path / "held"), pytest.raises(BusyError), held(tmp_path / "held"):
        pass
    assert not (tmp_path / "held").exists()
