"""Ctrl-C: out at once, whole parts only, and the same command goes on from there."""

import os
import signal
import time

import pandas as pd
import pytest

from aoabench.store.parts import intact_parts
from tests.commands import PATIENCE_S, Command

REPS = 120
RUN = [
    "noise=vmf",
    "filter=[pf_vmf,ekf_vmf]",
    "filter.pf_vmf.particles=20000",
    f"reps={REPS}",
    "runner.chunk=5",
]


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["loky", "threading", "sequential"])
def test_interrupted_runs_leave_whole_parts_and_go_on(backend, tmp_path):
    """Within a minute: it takes less than a second, and some under heavy load; nothing waits so
    long that would end by itself.
    """
    words = [*RUN, "runner.n_jobs=2", f"runner.backend={backend}", f"runner.out={tmp_path}"]
    command = Command(*words)
    deadline = time.monotonic() + PATIENCE_S
    while not list(tmp_path.glob("parts/*/*.json")) and command.running():
        assert time.monotonic() < deadline, "nothing was finished"
        time.sleep(0.005)
    os.killpg(command.pid, signal.SIGINT)  # the whole group, as from a terminal
    begin = time.monotonic()
    status, _ = command.finished()
    assert time.monotonic() - begin < 60
    assert status == 130
    found = {
        f.name: [(p.start, p.stop) for p in intact_parts(tmp_path, f.name)]
        for f in tmp_path.glob("parts/*")
    }
    assert 0 < sum(b - a for parts in found.values() for a, b in parts) < 2 * REPS
    before = {f: f.stat().st_mtime_ns for f in tmp_path.glob("parts/*/*.parquet")}
    assert Command(*words).finished()[0] == 0
    assert all(f.stat().st_mtime_ns == t for f, t in before.items() if f.exists())
    rows = pd.read_parquet(tmp_path / "replications.parquet")
    assert len(rows) == 2 * REPS
    assert not rows.duplicated(["estimator", "replication"]).any()
