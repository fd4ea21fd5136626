"""The allocator of the process."""

import platform
import subprocess
import sys

import pytest

TWICE = """
import resource
import numpy as np
from evogs_codec.common.heap import keep_freed_memory
keep_freed_memory(share=True)
faults = []
for _ in range(2):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.ones(50_000_000)
    faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
print(*faults)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="others have no such switch")
def test_what_was_freed_is_taken_again():
    done = subprocess.run([sys.executable, "-c", TWICE], capture_output=True, text=True, check=True)
    first, second = map(int, done.stdout.split())
    assert second < first / 4
