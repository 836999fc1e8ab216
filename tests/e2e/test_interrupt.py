"""Ctrl-C: out at once, whole parts only, and the same command goes on from there."""

import os
import signal
import subprocess
import sys
import time

import pandas as pd
import pytest

from aoabench.store.parts import intact_parts

RUN = [
    "run",
    "noise=vmf",
    "filter=[pf_vmf,ekf_vmf]",
    "filter.pf_vmf.particles=20000",
    "reps=200",
    "runner.chunk=5",
]


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["loky", "threading", "sequential"])
def test_interrupted_runs_leave_whole_parts_and_go_on(backend, tmp_path):
    """The bound of 20 s is for a machine under heavy load; elsewhere it takes less than one."""
    words = [*RUN, "runner.n_jobs=2", f"runner.backend={backend}", f"runner.out={tmp_path}"]
    command = [sys.executable, "-m", "aoabench.cli", *words]
    # a group of its own, and the whole group gets the signal, as from a terminal
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(
            signal.SIGINT, signal.SIG_DFL
        ),  # where the tests run in the background
    )
    deadline = time.monotonic() + 120
    while not list(tmp_path.glob("parts/*/*.json")) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    begin = time.monotonic()
    _, said = process.communicate(timeout=20)
    assert time.monotonic() - begin < 20
    assert process.returncode == 130
    assert "Traceback" not in said
    found = {
        f.name: [(p.start, p.stop) for p in intact_parts(tmp_path, f.name)]
        for f in tmp_path.glob("parts/*")
    }
    assert 0 < sum(b - a for parts in found.values() for a, b in parts) < 400
    before = {f: f.stat().st_mtime_ns for f in tmp_path.glob("parts/*/*.parquet")}
    subprocess.run(command, check=True, capture_output=True)
    assert all(f.stat().st_mtime_ns == t for f, t in before.items() if f.exists())
    rows = pd.read_parquet(tmp_path / "replications.parquet")
    assert len(rows) == 400
    assert not rows.duplicated(["estimator", "replication"]).any()
