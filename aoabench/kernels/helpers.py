"""Processes that compile kernels for the disk cache while this one does something else."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

_MOST = 3  # processes; more would each import numba for a kernel or two
_running: list[subprocess.Popen[str]] = []
_SCRIPT = """
import importlib, json, os, sys, threading

def end_with_parent():
    sys.stdin.read()
    os._exit(1)

path, kernels = json.loads(sys.stdin.readline())
sys.path[:] = path
threading.Thread(target=end_with_parent, daemon=True).start()
for module, name in kernels:
    getattr(importlib.import_module(module), name).ready()
"""


@contextmanager
def helping(kernels: Sequence[tuple[str, str]]) -> Iterator[None]:
    """Let other processes compile kernels (module, name) in this context, each beginning
    elsewhere in the list; end these processes with the context. No processes are started while
    those of an outer context run.
    """
    global _running
    count = min(len(kernels), _MOST, _processors() - 1) if kernels and not _running else 0
    processes = [_started([*kernels[i:], *kernels[:i]]) for i in range(count)]
    before, _running = _running, _running or processes
    try:
        yield
    finally:
        _running = before
        for process in processes:
            process.kill()
        for process in processes:
            process.communicate()


def _processors() -> int:
    from joblib import cpu_count

    return int(cpu_count())


def _started(kernels: Sequence[tuple[str, str]]) -> subprocess.Popen[str]:
    """A process that compiles kernels one after the other; it ends when its input is closed."""
    process = subprocess.Popen(
        [sys.executable, "-c", _SCRIPT],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdin is not None
    process.stdin.write(json.dumps([sys.path, kernels]) + "\n")
    process.stdin.flush()
    return process
