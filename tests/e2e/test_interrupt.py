"""Ctrl-C, SIGTERM and SIGHUP: out at once with a line, whole parts only, and the same command goes
on from there.
"""

import os
import signal
import subprocess
import sys
import time

import pandas as pd
import psutil
import pytest

from aoabench.engine.faults import KEPT
from aoabench.store.parts import intact_parts
from tests.commands import PATIENCE_S, Command

REPS = 120
FEWER = 20  # when it goes on, to be quick
RUN = [
    "noise=vmf",
    "filter=[pf_vmf,ekf_vmf]",
    "filter.pf_vmf.particles=20000",
    f"reps={REPS}",
    "runner.chunk=5",
]


class Real:
    """The installed command as a process of its own, with the warnings of its end."""

    def __init__(self, *words):
        command = [sys.executable, "-m", "aoabench.cli", "run", *words]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)  # fmt: skip
        self.pid = self.process.pid

    def running(self):
        return self.process.poll() is None

    def finished(self):
        said = self.process.communicate(timeout=PATIENCE_S)[1]
        return self.process.returncode, said


@pytest.mark.slow
@pytest.mark.parametrize(("backend", "command", "sent", "status", "word"), [
    ("loky", Real, signal.SIGTERM, 143, "terminated"),
    ("threading", Command, signal.SIGINT, 130, "interrupted"),
    ("sequential", Command, signal.SIGTERM, 143, "terminated"),
])  # fmt: skip
def test_interrupted_runs_leave_whole_parts_and_go_on(
    backend, command, sent, status, word, tmp_path
):
    """Within a minute: it takes less than a second, and some under heavy load; nothing waits so
    long that would end by itself. The run is interrupted twice; from a terminal, with its workers.
    """
    words = [*RUN, "runner.n_jobs=2", f"runner.backend={backend}", f"runner.out={tmp_path}"]
    run = command(*words)
    deadline = time.monotonic() + PATIENCE_S
    while not list(tmp_path.glob("parts/*/*.json")) and run.running():
        assert time.monotonic() < deadline, "nothing was finished"
        time.sleep(0.005)
    workers = psutil.Process(run.pid).children(recursive=True)
    for _ in range(2):
        (os.killpg if sent == signal.SIGINT else os.kill)(run.pid, sent)
    begin = time.monotonic()
    found, said = run.finished()
    assert time.monotonic() - begin < 60
    assert (found, said) == (status, f"aoabench: {word}; {KEPT}\n")
    assert len(workers) >= 2 * (backend == "loky")
    assert not psutil.wait_procs(workers, timeout=PATIENCE_S)[1], "workers outlive the run"
    found = {
        f.name: [(p.start, p.stop) for p in intact_parts(tmp_path, f.name)]
        for f in tmp_path.glob("parts/*")
    }
    assert 0 < sum(b - a for parts in found.values() for a, b in parts) < 2 * REPS
    before = {f: f.stat().st_mtime_ns for f in tmp_path.glob("parts/*/*.parquet")}
    assert Command(*words, f"reps={FEWER}").finished()[0] == 0
    assert all(f.stat().st_mtime_ns == t for f, t in before.items() if f.exists())
    rows = pd.read_parquet(tmp_path / "replications.parquet")
    assert len(rows) == 2 * FEWER
    assert not rows.duplicated(["estimator", "replication"]).any()
