"""Whole commands: their start, interruption, workers and memory, and the time of the studies."""

from __future__ import annotations

import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from aoabench.config.compose import compose_cells
from aoabench.engine import runner
from aoabench.store.files import read_provenance
from aoabench.studies import study
from benchmarks.timing import MODELS, Row, cell_of

COMMAND = [sys.executable, "-m", "aoabench.cli"]
# a shell's background jobs ignore interrupts
_INTERRUPTIBLE = [
    sys.executable,
    "-c",
    "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_DFL); "
    "os.execv(sys.executable, [sys.executable, *sys.argv[1:]])",
]


def start(repeats: int) -> Iterator[Row]:
    """Seconds to import the package, to answer `aoabench list`, and of runs of one replication."""
    how = f"median wall time of {repeats} fresh processes"
    seconds = _seconds([sys.executable, "-c", "import aoabench"], repeats)
    yield Row("start", "import aoabench", seconds, "s", "", how)
    seconds = _seconds([*COMMAND, "list"], repeats)
    yield Row("start", "aoabench list", seconds, "s", "at most 1.5", how)
    with tempfile.TemporaryDirectory() as folder:
        words = ["run", "filter=[pf_vmf,ekf_vmf]", "reps=1", "runner.n_jobs=1"]
        cache = {"NUMBA_CACHE_DIR": f"{folder}/cache"}

        def once(out: str, repeats: int = 1) -> float:
            return _seconds([*COMMAND, *words, f"runner.out={folder}/{out}"], repeats, cache)

        first = "one process, an empty cache of kernels"
        yield Row("start", "run, kernels not yet compiled", once("first"), "s", "at most 12", first)
        fresh = statistics.median(once(str(i)) for i in range(repeats))
        yield Row("start", "run reps=1", fresh, "s", "at most 4", how + ", kernels cached")
        again = once("0", repeats)
        yield Row("start", "run reps=1, all reused", again, "s", "at most 4", how)
    yield from _composing()


def _composing() -> Iterator[Row]:
    """Processor time per cell of composing and building the cells of sweeps over values."""
    sweeps = {
        "ekf_vmf, deviation x seed": ["filter=[ekf_vmf]", "noise.sigma_deg=range(1,101)"],
        "ekf_aoa in indoor_map, deviation x seed": [
            "scenario=indoor_map",
            "noise=ae_normal",
            "filter=[ekf_aoa]",
            "noise.sigma_deg=range(1,101)",
        ],
        "ukf_vmf, its kappa x seed": [
            "filter=[ukf_vmf]",
            "filter.ukf_vmf.measurement.kappa=range(1,101)",
        ],
    }
    for detail, words in sweeps.items():
        begin = time.process_time()
        cells = compose_cells([*words, "seed=range(0,100)"])
        each = (time.process_time() - begin) / len({cell.id for cell in cells})
        how = "10,000 cells, from the overrides to validated cells with their ids; processor time"
        yield Row("compose a cell", detail, 1000 * each, "ms", "at most 5", how)


def interrupt(repeats: int) -> Iterator[Row]:
    """Seconds from Ctrl-C to the end of a run of particle filters with two workers."""
    with tempfile.TemporaryDirectory() as folder:
        seconds = statistics.median(_interrupted(Path(folder, str(i))) for i in range(3))
    how = "from the signal to the end of the command; median of 3"
    yield Row("Ctrl-C", "two workers", seconds, "s", "at most 2", how)


def _interrupted(out: Path) -> float:
    """Seconds that a run takes to end after an interrupt, sent once its first part is stored."""
    words = ["run", "filter=[pf_vmf]", "reps=100000", "runner.n_jobs=2", f"runner.out={out}"]
    run = subprocess.Popen(
        [*_INTERRUPTIBLE, *COMMAND[1:], *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    while not list(out.glob("parts/*/*.json")) and run.poll() is None:
        time.sleep(0.05)
    begin = time.perf_counter()
    os.killpg(run.pid, signal.SIGINT)
    run.wait()
    return time.perf_counter() - begin


def scaling(repeats: int) -> Iterator[Row]:
    """One worker process against two on the same work, in turn."""
    filters = [f"pf_{m}" for m in MODELS]
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        for i in range(3):
            seconds = []
            for n_jobs in (1, 2):
                out = f"runner.out={folder}/{i}-{n_jobs}"
                cell = cell_of(f"runner.n_jobs={n_jobs}", out, "reps=3000", filters=filters)
                begin = time.perf_counter()
                runner.run([cell], progress=False)
                seconds.append(time.perf_counter() - begin)
            ratios.append(seconds[0] / seconds[1])
    how = (
        "median of 3 pairs: 3000 replications x 4 particle filters, "
        "start of the workers, tables and timing included"
    )
    what, times = "two workers against one", statistics.median(ratios)
    yield Row(what, "particle filters", times, "x", "at least 1.7", how)


def memory(repeats: int) -> Iterator[Row]:
    """Peak memory of a whole run against the number of replications (Linux only)."""
    if not Path("/proc/self/status").exists():
        return
    how = "peak resident memory of the process that does all the work"
    runs = [("ekf_vmf", 1_000), ("ekf_vmf", 10_000), ("pf_vmf", 100), ("pf_vmf", 1_000)]
    with tempfile.TemporaryDirectory() as folder:
        for name, reps in runs:
            words = ["run", f"filter=[{name}]", f"reps={reps}", "runner.n_jobs=1"]
            peak = _peak_mib([*words, f"runner.out={folder}/{name}{reps}"])
            detail = f"{name}, {reps} replications"
            yield Row("peak memory", detail, peak, "MiB", "at most 400", how)
        for name in ("ekf_vmf", "ukf_vmf"):
            words = ["run", "scenario=indoor_map", "noise=ofdm_crlb", f"filter=[{name}]", "reps=40"]
            peak = _peak_mib([*words, "runner.n_jobs=1", f"runner.out={folder}/map-{name}"])
            detail = f"{name}, indoor map, 40 replications"
            yield Row("peak memory", detail, peak, "MiB", "at most 400", how)


def _peak_mib(words: list[str]) -> float:
    """Peak resident memory in MiB of a process that runs an aoabench command."""
    script = (
        f"from aoabench.cli.main import dispatch\ndispatch({words!r})\n"
        "print('PEAK', *(line.split()[1] "
        "for line in open('/proc/self/status') if 'VmHWM' in line))"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return int(done.stdout.rsplit("PEAK", 1)[1]) / 1024


# minutes for all items of a study, and for items that share their replications
_MINUTES = {"lu2019": 4.0, "nurminen2018": 7.0, "leaderboard": 1.0, "together": 15.0}
_ITEMS = {"nurminen2018": {("fig4", "readings"): 3.3}}


def studies(repeats: int) -> Iterator[Row]:
    """Minutes in which the committed tables were computed, by their provenance."""
    how = "seconds of each item, as noted in the committed tables; two cores"
    every = 0.0
    for name in study.names():
        s = study.load(name)
        origins = [read_provenance(study.table_path(Path("results"), s, item)) for item in s.items]
        scales = {o.get("scale") for o in origins}
        total = sum(o.get("seconds", math.nan) for o in origins)
        if s.named_only:
            continue
        every += total
        detail = f"scale {'/'.join(sorted(map(str, scales)))}"
        yield Row(f"reproduce {name}", detail, total / 60, "min", _most(name), how)
        for names, most in _ITEMS.get(name, {}).items():
            each = [o["seconds"] for item, o in zip(s.items, origins) if item.name in names]
            row = f"reproduce {name}", " and ".join(names), sum(each) / 60
            yield Row(*row, "min", f"at most {most:g} (fig4)", how)
    what = "reproduce --scale paper"
    yield Row(what, "four studies and leaderboard", every / 60, "min", _most("together"), how)


def _most(name: str) -> str:
    return f"at most {_MINUTES[name]:g}" if name in _MINUTES else ""


def _seconds(words: list[str], repeats: int, environment: dict[str, str] | None = None) -> float:
    """Median seconds of a command, with additions to the environment."""
    given = {**os.environ, **(environment or {})}
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        subprocess.run(words, check=True, capture_output=True, env=given)
        seconds.append(time.perf_counter() - begin)
    return statistics.median(seconds)
