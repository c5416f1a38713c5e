"""Shared by all tests."""

import os
import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))

settings.register_profile("uavbench", deadline=None)  # the first example of a test may compile kernels
os.environ["SDL_VIDEODRIVER"] = "dummy"  # windows open nowhere

if "CI" not in os.environ:  # there Hypothesis loads a deterministic profile of its own
    settings.load_profile("uavbench")
