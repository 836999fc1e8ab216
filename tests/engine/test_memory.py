"""Freed arrays stay with the process."""

import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource
import numpy as np
from aoabench.engine.memory import keep_freed_memory

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        arrays = [np.ones(50_000) for _ in range(10)]
        del arrays
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

before = faults()
keep_freed_memory()
print(before, faults())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries do not adapt")
def test_arrays_are_made_in_memory_that_was_freed(monkeypatch):
    """In a new process, as any earlier large array has the same effect: at most one round of ten
    arrays of 98 pages is faulted in.
    """
    for name in ("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_", "GLIBC_TUNABLES"):
        monkeypatch.delenv(name, raising=False)
    done = subprocess.run([sys.executable, "-c", FAULTS], capture_output=True, text=True)
    before, after = (int(word) for word in done.stdout.split())
    assert after <= min(1500, before), done.stderr
