"""`aoabench locate` on a large log, and live on a stream of packets."""

from __future__ import annotations

import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np
import pandas as pd

from aoabench.maths.geometry import to_azel
from benchmarks.process import COMMAND
from benchmarks.timing import Row

ANCHORS = np.array([[0, 3, 2.3, 0], [6, 0, 2.3, 90], [12, 3, 2.3, 180], [6, 6, 2.3, -90]])
TAGS = 10
FIXES = 25_000  # of each tag
RATE = 10_000  # packets a second of the stream
SECONDS = 10.0  # of the stream
WINDOW_S = 0.002
SIGMA_DEG = 4.0


def locate(repeats: int) -> Iterator[Row]:
    """Processor time and memory for a log of 10^6 rows; speed and latency of a stream."""
    with tempfile.TemporaryDirectory() as folder:
        anchors, log = Path(folder) / "anchors.csv", Path(folder) / "log.csv"
        names = ["x_m", "y_m", "z_m", "facing_deg"]
        table = pd.DataFrame(ANCHORS, columns=names, index=["A1", "A2", "A3", "A4"])
        table.to_csv(anchors, index_label="id")
        walk(FIXES, 0.1).to_csv(log, index=False)
        words = ["--anchors", str(anchors), f"scenario.window_s={WINDOW_S}"]
        for method, least in (("--estimator=robust_ml", 20), ("--filter=ekf_vmf", 30)):
            out = str(log.with_name("out.csv"))
            seconds, peak = cost([*COMMAND, "locate", str(log), *words, method, "-o", out])
            name, how = method.partition("=")[2], "a log of 10^6 rows with 10 tags, one process"
            yield Row("locate, processor time", name, seconds, "s", f"at most {least}", how)
            yield Row("locate, peak memory", name, peak, "MiB", "at most 1000", how)
        for method in ("--estimator=robust_ml", "--filter=ekf_vmf"):
            yield from live([*COMMAND, "locate", "-", *words, method], method.partition("=")[2])


def walk(fixes: int, every_s: float) -> pd.DataFrame:
    """The packets of tags that walk about a room, in order of time; those of a fix come within
    WINDOW_S.
    """
    rng = np.random.default_rng(1)
    tag, anchor = np.arange(TAGS), np.arange(len(ANCHORS))
    start = every_s * (np.arange(fixes)[:, None] + tag / TAGS)
    at = start[..., None] + WINDOW_S / 2 * anchor / len(ANCHORS)
    phase = start / 20 + 2 * np.pi * tag / TAGS
    place = np.stack([6 + 4 * np.cos(phase), 3 + 2 * np.sin(1.5 * phase), 1.1 + 0 * phase], axis=-1)
    azimuth, elevation = np.degrees(
        to_azel(*np.moveaxis(place[:, :, None] - ANCHORS[:, :3], -1, 0))
    )
    azimuth = azimuth - ANCHORS[:, 3] + rng.normal(0, SIGMA_DEG, at.shape)
    elevation = np.clip(elevation + rng.normal(0, SIGMA_DEG, at.shape), -90, 90)
    columns = {
        "time_s": at,
        "tag": np.broadcast_to(np.char.add("T", tag.astype(str))[:, None], at.shape),
        "anchor": np.broadcast_to(np.char.add("A", (anchor + 1).astype(str)), at.shape),
        "azimuth_deg": (azimuth + 180) % 360 - 180,
        "elevation_deg": elevation,
    }
    return pd.DataFrame({name: array.ravel() for name, array in columns.items()}).round(6)


def cost(command: list[str]) -> tuple[float, float]:
    """Processor time in s and peak resident memory in MiB of a command."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise RuntimeError(f"{command} failed")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def live(command: list[str], name: str) -> Iterator[Row]:
    """Latency beyond its window of each fix of a stream of RATE packets a second."""
    count = int(RATE * SECONDS)
    frame = walk(count // (TAGS * len(ANCHORS)), TAGS * len(ANCHORS) / RATE)
    lines = frame.to_csv(index=False).splitlines(keepends=True)
    head, rows = lines[0], lines[1:]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None
    assert process.stdout is not None
    seen: list[tuple[float, str]] = []
    reader = threading.Thread(target=_note, args=(process.stdout, seen))
    reader.start()
    warm = [f"{float(t) - 1000},{rest}" for t, rest in (row.split(",", 1) for row in rows[:400])]
    process.stdin.writelines([head, *warm])
    process.stdin.flush()
    time.sleep(10)  # it loads and compiles
    begin = time.monotonic()
    _pace(process.stdin, frame["time_s"].to_numpy(), rows, begin)
    late = time.monotonic()
    process.stdin.close()
    process.wait()
    reader.join()
    late = time.monotonic() - late
    at = np.array([moment for moment, line in seen[1:]]) - begin
    fix = np.array([float(line.split(",")[3]) for _, line in seen[1:]])
    some = (fix > 0) & (fix < SECONDS - 0.5)
    beyond = 1000 * (at[some] - fix[some] - WINDOW_S)
    how = f"{RATE} packets a second from {TAGS} tags, windows of {1000 * WINDOW_S:g} ms"
    for q in (0.5, 0.95):
        value = float(np.quantile(beyond, q))
        yield Row("locate -, latency", f"{name}, quantile {q:g}", value, "ms", "at most 50", how)
    yield Row("locate -, backlog at the end", name, late, "s", "", how)


def _note(stream: IO[str], seen: list[tuple[float, str]]) -> None:
    """Note when each line of a stream comes."""
    for line in stream:
        seen.append((time.monotonic(), line))


def _pace(stream: IO[str], at: np.ndarray, rows: list[str], begin: float) -> None:
    """Write each row when its time has come, `begin` being time 0."""
    done = 0
    while done < len(rows):
        due = int(np.searchsorted(at, time.monotonic() - begin, side="right"))
        stream.writelines(rows[done:due])
        stream.flush()
        done = max(due, done)
        time.sleep(0.001)
