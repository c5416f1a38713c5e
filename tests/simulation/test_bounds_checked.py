"""No kernel reads or writes beside its arrays: the rules again, compiled with checks of every index.

Without them, a read out of bounds can give the right numbers for as long as what lies there happens to be harmless.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = (
    "test_pooling",
    "test_rows",
    "test_observation",
    "test_simulator",
    "test_teams",
    "test_many_cities",
    "missions/test_channel",
)


@pytest.mark.slow
def test_no_index_is_out_of_bounds(tmp_path):
    here = Path(__file__).parent
    checked = {**os.environ, "NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path), "CI": "1"}
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *(str(here / f"{name}.py") for name in TESTS)]
    done = subprocess.run(command, capture_output=True, text=True, env=checked, cwd=here.parent, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-2000:]
