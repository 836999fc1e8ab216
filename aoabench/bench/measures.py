"""`make bench`: speed and memory, ratios and medians of one run, written to results/bench.

Nothing is asserted here: a shared machine is noisy. Each row says what was measured and how.
"""

from __future__ import annotations

import argparse
import functools
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from aoabench import montecarlo, store
from aoabench.composing import compose_cells

KALMAN = [f"{a}_{m}" for a in ("ekf", "ukf") for m in ("ae_nominal", "ae_fitted", "ae_adaptive", "vmf")]
AT_MOST = {"ekf": 5.0, "ukf": 15.0}  # microseconds per replication and step


def main() -> None:
    """Measure everything and write results/bench/bench.parquet."""
    parser = argparse.ArgumentParser(prog="python -m aoabench.bench")
    parser.add_argument("--results", default="results", type=Path)
    parser.add_argument("--repeats", default=9, type=int)
    given = parser.parse_args()
    rows: list[tuple[str, str, float, str, str, str]] = []
    for part in (kalman_steps, cold_start, command_times, scaling, memory):
        for row in part(given.repeats):
            rows.append(row)
            what, detail, value, unit, target, _ = row
            print(f"{what:42s} {detail:34s} {value:10.3f} {unit:14s} {target}", flush=True)
    import pandas as pd

    frame = pd.DataFrame(rows, columns=["what", "detail", "value", "unit", "target", "how"])
    path = given.results / "bench" / "bench.parquet"
    store.write_frame(path, frame)
    print(f"written to {path}")


def kalman_steps(repeats: int) -> list[tuple[str, str, float, str, str, str]]:
    """Microseconds per replication and step of each Kalman filter, and against a plain loop over replications."""
    cell = compose_cells([f"filter=[{','.join(KALMAN)}]", "noise=vmf"])[0]
    timed = montecarlo.time_estimators(cell.scenario, cell.noise, cell.estimators, 1, repeats)
    rows = []
    how = f"median of {repeats} serial passes over a tile of 128 replications, 64 steps, 4 anchors; BLAS at one thread"
    for name, (seconds, replications, steps) in timed.items():
        target = f"at most {AT_MOST[name[:3]]:g}"
        rows.append(("Kalman step", name, 1e6 * seconds / (replications * steps), "us", target, how))
    for name in ("ekf_vmf", "ukf_vmf"):
        seconds, replications, steps = timed[name]
        one = statistics.median(_seconds(functools.partial(_one_by_one, cell, name), 3))
        batched = seconds / (replications * steps)
        ratio = one / (8 * steps) / batched
        rows.append(
            ("batched over one at a time", name, ratio, "x", "", "the same filter on 8 tiles of one replication each")
        )
    return rows


def _one_by_one(cell: Any, name: str) -> None:
    import dataclasses

    estimator = cell.estimators[name]
    draws = montecarlo.Draws(cell.scenario, cell.noise, 1)
    for r in range(8):
        truth, batch = draws.tile(r, 1)
        streams = montecarlo.Streams(1, cell.scenario.name, (r,))
        assert dataclasses.is_dataclass(estimator(batch, cell.scenario, streams))


def cold_start(repeats: int) -> list[tuple[str, str, float, str, str, str]]:
    """Seconds to import the package and to answer `aoabench list`."""
    import_ = _command([sys.executable, "-c", "import aoabench"], repeats)
    listing = _command([sys.executable, "-m", "aoabench.cli", "list"], repeats)
    how = f"median wall time of {repeats} fresh processes"
    return [
        ("start", "import aoabench", import_, "s", "", how),
        ("start", "aoabench list", listing, "s", "at most 1.5", how),
    ]


def command_times(repeats: int) -> list[tuple[str, str, float, str, str, str]]:
    """Seconds of `aoabench run` with one replication, fresh and with nothing left to compute."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["run", "filter=[ekf_vmf]", "reps=1", "runner.n_jobs=1"]
        fresh = [
            _command([sys.executable, "-m", "aoabench.cli", *words, f"runner.out={folder}/{i}"], 1) for i in range(3)
        ]
        again = _command([sys.executable, "-m", "aoabench.cli", *words, f"runner.out={folder}/0"], 3)
    how = "median wall time of 3 processes"
    return [
        ("start", "aoabench run reps=1", statistics.median(fresh), "s", "at most 4", how),
        ("start", "aoabench run reps=1, all reused", again, "s", "at most 4", how),
    ]


def scaling(repeats: int) -> list[tuple[str, str, float, str, str, str]]:
    """One worker process against two on the same work, in turn."""
    from aoabench import runner

    names = ",".join(KALMAN)
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        for i in range(3):
            seconds = []
            for n_jobs in (1, 2):
                words = [
                    f"runner.n_jobs={n_jobs}",
                    "runner.backend=loky",
                    f"runner.out={folder}/{i}-{n_jobs}",
                    "reps=2048",
                ]
                cells = compose_cells([f"filter=[{names}]", *words])
                begin = time.perf_counter()
                runner.run(cells, progress=False)
                seconds.append(time.perf_counter() - begin)
            ratios.append(seconds[0] / seconds[1])
    how = "median of 3 pairs: 2048 replications x 8 filters, tables and timing pass included"
    return [("two workers against one", "8 Kalman filters", statistics.median(ratios), "x", "at least 1.7", how)]


def memory(repeats: int) -> list[tuple[str, str, float, str, str, str]]:
    """Peak memory of the whole run against the number of replications."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for reps in (1_000, 10_000):
            words = ["run", "filter=[ekf_vmf]", f"reps={reps}", "runner.n_jobs=1", f"runner.out={folder}/{reps}"]
            script = (
                "import resource, sys\nfrom aoabench.cli import dispatch\n"
                f"dispatch({words!r})\nprint('PEAK', resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
            )
            done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
            peak = int(done.stdout.rsplit("PEAK", 1)[1]) / (1 if sys.platform == "darwin" else 1024) / 1024
            how = f"peak resident memory of one process, {resource.getpagesize()} byte pages"
            rows.append(("peak memory", f"{reps} replications", peak, "GiB", "at most 1", how))
    return rows


def _seconds(action: Callable[[], Any], repeats: int) -> list[float]:
    found = []
    for _ in range(repeats):
        begin = time.perf_counter()
        action()
        found.append(time.perf_counter() - begin)
    return found


def _command(words: list[str], repeats: int) -> float:
    return statistics.median(_seconds(lambda: subprocess.run(words, check=True, capture_output=True), repeats))


if __name__ == "__main__":
    main()
