"""What was freed is asked for again without the system's help."""

import subprocess
import sys

import pytest

CODE = """
import resource, sys
import numpy as np
from uavbench.learning.memory import keep_freed
kept = sys.argv[1] == "keep" and keep_freed()
def use():
    return len([np.ones(3 * 2**17) for _ in range(10)])  # of 3 MB: larger ones are not made of small pages
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
use()
before = faults()
for _ in range(20):
    use()
print(int(kept), faults() - before)
"""


def faults(word):
    told = subprocess.run([sys.executable, "-c", CODE, word], capture_output=True, text=True, check=True).stdout.split()
    return bool(int(told[0])), int(told[1])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's allocator is asked")
def test_freed_memory_is_kept():
    kept, few = faults("keep")
    if not kept:
        pytest.skip("this system's allocator is not glibc's")
    assert few < 200
    assert faults("as it is")[1] > 10 * few + 1000
