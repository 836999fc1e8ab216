"""What the machine does to a run: killed processes, full and read-only disks, lack of memory,
altered parts, two runs.

Each time the same command goes on, nothing that was finished is computed twice, and the tables are
those of a run that nobody disturbed, bit for bit.
"""

import os
import random
import shutil
import signal
import subprocess
import time
from contextlib import contextmanager
from functools import partial

import pandas as pd
import psutil
import pytest

from aoabench.config.compose import compose_cells
from aoabench.engine import runner
from aoabench.store.parts import intact_parts
from tests.commands import PATIENCE_S, Command

REPS = 1600
WORDS = ["noise=vmf", "filter=[pf_vmf,pf_ae_nominal]", "filter.pf_vmf.particles=1000", "filter.pf_ae_nominal.particles=1000",
         f"reps={REPS}", "runner.chunk=16"]  # fmt: skip
PARTS = 200  # of two filters, in tiles of 16
KILLS = 20


def tables(out):
    """All tables of a run that do not hold times."""
    frames = {
        name: pd.read_parquet(out / f"{name}.parquet")
        for name in ("replications", "summary", "failures")
    }
    frames["replications"] = frames["replications"].sort_values(
        ["estimator", "replication"], ignore_index=True
    )
    return frames


def assert_same(out, reference):
    for name, frame in tables(out).items():
        pd.testing.assert_frame_equal(frame, reference[name], check_exact=True, obj=name)


def checksums(out):
    """The finished parts and when each was finished."""
    return {file: file.stat().st_mtime_ns for file in out.glob("parts/*/*.json")}


def assert_kept(before, out):
    now = checksums(out)
    assert before.items() <= now.items(), "a finished part was computed again, or lost"


def assert_each_once(out):
    for folder in (out / "parts").iterdir():
        parts = intact_parts(out, folder.name)
        assert sum(part.stop - part.start for part in parts) == REPS, "overlapping parts"


def wait_for(condition, command=None):
    deadline = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < deadline, "took too long"
        if command is not None and not command.running():
            return None
        time.sleep(0.005)
    return found


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """The undisturbed run, in one process."""
    out = tmp_path_factory.mktemp("undisturbed")
    runner.run(
        compose_cells([*WORDS, "runner.chunk=50", "runner.n_jobs=1", f"runner.out={out}"]),
        progress=False,
    )
    return tables(out)


@pytest.mark.slow
def test_killed_at_twenty_random_moments(reference, tmp_path):
    """Fifteen times the parent, once with workers, five times a worker, then Ctrl-C; a quarter of
    them while the run starts.
    """
    moments = random.Random(20180710)
    words = [*WORDS, f"runner.out={tmp_path}"]

    def enough(some):
        return len(checksums(tmp_path)) >= some

    for number in range(KILLS + 1):
        before = checksums(tmp_path)
        worker_dies = number % 4 == 1
        jobs = 2 if worker_dies or number == 0 else 1
        command = Command(*words, f"runner.n_jobs={jobs}")
        if number % 4 == 3:
            time.sleep(moments.uniform(0, 0.5))
        else:
            some = len(before) + moments.randint(1, 6)
            wait_for(partial(enough, some), command)
            time.sleep(moments.uniform(0, 0.05))
        assert command.running(), "there is more to do than is done in all runs that are killed"
        if worker_dies:
            moments.choice(wait_for(command.workers, command)).kill()
            status, said = command.finished()
            assert status == 1
            assert "a worker process was killed" in said
            assert len(said.strip().splitlines()) == 1
        elif number < KILLS:
            orphans = command.workers()
            os.kill(command.pid, signal.SIGKILL)
            assert command.finished()[0] == -signal.SIGKILL
            psutil.wait_procs(orphans, timeout=PATIENCE_S)
            assert not [o for o in orphans if o.is_running() and o.status() != psutil.STATUS_ZOMBIE]
        else:
            os.killpg(command.pid, signal.SIGINT)
            status, said = command.finished()
            assert status == 130, said
        assert_kept(before, tmp_path)
    before = checksums(tmp_path)
    assert len(before) < PARTS, "there was something left to do"
    assert Command(*words, "runner.n_jobs=1").finished()[0] == 0
    assert_kept(before, tmp_path)
    assert_each_once(tmp_path)
    assert_same(tmp_path, reference)


@contextmanager
def disk(path, kilobytes):
    """A disk of its own of that size at `path`."""
    path.mkdir()
    try:
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", path],
            capture_output=True,
            text=True,
        )
    except OSError as error:
        pytest.skip(f"no disk of its own can be mounted here: {error}")
    if done.returncode:
        pytest.skip(f"no disk of its own can be mounted here: {done.stderr.strip()}")
    try:
        yield path
    finally:
        subprocess.run(["umount", "--lazy", path], check=True)


def remount(path, options):
    subprocess.run(["mount", "-o", f"remount,{options}", path], check=True)


def test_a_full_disk(reference, tmp_path):
    with disk(tmp_path / "disk", 800) as out:
        words = [*WORDS, f"runner.out={out}"]
        status, said = Command(*words, "runner.n_jobs=2").finished()
        assert status == 1
        assert (
            "cannot be written: No space left on device; make room on the disk; "
            "finished parts are kept" in said
        )
        assert len(said.strip().splitlines()) == 1
        before = checksums(out)
        assert 0 < len(before) < PARTS
        remount(out, "size=30m")
        assert Command(*words, "runner.n_jobs=1").finished()[0] == 0
        assert_kept(before, out)
        assert_same(out, reference)


def test_a_read_only_disk(tmp_path):
    with disk(tmp_path / "disk", 30_000) as out:
        remount(out, "ro")
        status, said = Command(*WORDS, "runner.n_jobs=1", f"runner.out={out}").finished()
        assert status == 2
        assert f"runner.out='{out}' cannot be written: Read-only file system" in said
        assert len(said.strip().splitlines()) == 1


def test_a_folder_without_permission(tmp_path):
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    tmp_path.chmod(0o555)
    status, said = Command(*WORDS, f"runner.out={tmp_path}").finished()
    assert status == 2
    assert "Permission denied" in said


HUNGRY = '''
import os
import signal
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from aoabench import Estimates


@dataclass(frozen=True)
class Hungry:
    """Needs more memory than there is while a file says so, and may be killed for it."""

    def __call__(self, batch, scenario, streams):
        if Path("hungry").exists() and 150 in streams.replications:
            np.ones(2**58)
        if Path("killed").exists() and 150 in streams.replications:
            os.kill(os.getpid(), signal.SIGKILL)  # as Linux does
        position = batch.azimuth[..., :3].copy()
        return Estimates(position, None, None, np.zeros(position.shape[:2], dtype=np.int8))
'''


def test_a_worker_without_memory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_hungry.py").write_text(HUNGRY)
    (tmp_path / "conf" / "estimator").mkdir(parents=True)
    (tmp_path / "conf" / "estimator" / "hungry.yaml").write_text(
        "hungry: {_target_: my_hungry.Hungry}\n"
    )
    words = ["estimator=[hungry]", "filter=[ekf_vmf]", "reps=260", "runner.chunk=128",
             "--config-dir", "conf", "plugins=[my_hungry]"]  # fmt: skip
    assert Command(*words, "runner.n_jobs=1", "runner.out=undisturbed").finished()[0] == 0
    for how, jobs, match in (
        ("hungry", 1, "out of memory (Unable to allocate"),
        ("killed", 2, "a worker process was killed"),
    ):
        (tmp_path / how).touch()
        status, said = Command(*words, f"runner.n_jobs={jobs}", "runner.out=out").finished()
        assert status == 1
        assert match in said
        assert "finished parts are kept" in said
        assert len(said.strip().splitlines()) == 1
        (tmp_path / how).unlink()
    before = checksums(tmp_path / "out")
    assert Command(*words, "runner.n_jobs=1", "runner.out=out").finished()[0] == 0
    assert_kept(before, tmp_path / "out")
    assert_same(tmp_path / "out", tables(tmp_path / "undisturbed"))


# --- altered parts --------------------------------------------------------------------------------


def small(out, reps=64):
    words = [
        "noise=vmf",
        "filter=[pf_vmf]",
        "filter.pf_vmf.particles=50",
        f"reps={reps}",
        "runner.chunk=16",
        "runner.n_jobs=1",
    ]
    return runner.run(compose_cells([*words, f"runner.out={out}"]), progress=False)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A small run that nobody touches, and its tables."""
    out = tmp_path_factory.mktemp("whole")
    small(out)
    return out, tables(out)


@pytest.mark.parametrize(("file", "how"), [
    *[("parquet", how) for how in ("first byte", "middle byte", "last byte", "truncated", "deleted")],
    *[("json", how) for how in ("middle byte", "truncated", "emptied", "deleted")],
])  # fmt: skip
def test_an_altered_part_is_found_computed_again_and_reported(file, how, whole, tmp_path, capsys):
    shutil.copytree(whole[0], tmp_path, dirs_exist_ok=True)
    before = whole[1]
    victim = sorted((tmp_path / "parts").glob(f"*/000000016-*.{file}"))[0]
    data = bytearray(victim.read_bytes())
    place = {"first byte": 0, "middle byte": len(data) // 2, "last byte": -1}.get(how)
    if place is not None:
        data[place] ^= 1
    victim.write_bytes(data[:-1] if how == "truncated" else b"" if how == "emptied" else data)
    if how == "deleted":
        victim.unlink()
    untouched = {
        file: t for file, t in checksums(tmp_path).items() if "000000016-" not in file.name
    }
    capsys.readouterr()
    done = small(tmp_path)
    assert (done.computed, done.reused) == (16, 48)
    said = capsys.readouterr().err
    if (file, how) == ("json", "deleted"):  # then nothing says that it was ever finished
        assert not done.damaged
    else:
        assert len(done.damaged) == 1
        assert "000000016-000000032: altered or torn; computed again" in said
    assert_kept(untouched, tmp_path)
    assert_same(tmp_path, before)
    done = small(tmp_path)
    assert (done.computed, done.damaged) == (0, ())
    assert "altered" not in capsys.readouterr().err


# --- two runs at once -----------------------------------------------------------------------------


def test_a_second_run_says_that_it_waits_and_computes_nothing_twice(reference, tmp_path):
    """The lock goes with its holder, however that ends."""
    words = [*WORDS, "runner.n_jobs=1", f"runner.out={tmp_path}"]
    first = Command(*words)
    wait_for(lambda: len(checksums(tmp_path)) > 3, first)
    os.kill(first.pid, signal.SIGSTOP)  # so that it does not end before the second one has begun
    second = Command(*words)
    try:
        line = wait_for(second.said.read_text, second) or ""
    finally:
        os.kill(first.pid, signal.SIGKILL)
    assert line.startswith(f"aoabench: another run (process {first.pid} on ")
    assert f"is writing into {tmp_path}: waiting until it has ended" in line
    first.finished()
    before = checksums(tmp_path)
    assert 3 < len(before) < PARTS
    assert second.finished()[0] == 0
    assert_kept(before, tmp_path)
    assert_each_once(tmp_path)
    assert_same(tmp_path, reference)
