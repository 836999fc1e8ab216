"""The lock of a run's folder: who waits for whom, and what is said of a folder that is gone."""

import fcntl
import os
import shutil
import threading
from dataclasses import replace

import pandas as pd
import pytest

import aoabench
from aoabench import resources
from aoabench.config.compose import compose_cells
from aoabench.engine import dask, runner, tasks
from aoabench.errors import RunError, UserError
from aoabench.store.keys import RunKeys
from aoabench.store.lock import LOCK, locked
from tests.helpers import Msvcrt

WORDS = ["noise=vmf", "estimator=[ls]", "scenario.steps=2", "reps=6", "runner.chunk=1"]
WAIT_S = 60


def unused(_line):
    raise AssertionError("nobody waits here")


@pytest.fixture(scope="module")
def cells():
    """The function (folder, **options) -> the cells of a tiny run."""
    (cell,) = compose_cells([*WORDS, "runner.n_jobs=1", "runner.out=unused"])

    def in_(folder, **options):
        return [replace(cell, runner=replace(cell.runner, out=str(folder), **options))]

    return in_


@pytest.fixture(scope="module")
def whole(cells, tmp_path_factory):
    """The rows of a run that nobody disturbs."""
    out = tmp_path_factory.mktemp("whole")
    runner.run(cells(out), progress=False)
    return aoabench.load(out)


def second(out, begin):
    """A second holder in a thread: `begin` is set once it waits; it takes the lock when it can."""
    got = threading.Event()

    def take():
        with locked(out, lambda line: begin.append(line)):
            got.set()

    thread = threading.Thread(target=take, daemon=True)
    thread.start()
    return thread, got


@pytest.mark.parametrize("how", ["untouched", "deleted", "replaced"])
def test_a_second_run_waits_whatever_becomes_of_the_lock_file(how, tmp_path):
    said = []
    with locked(tmp_path, unused):
        if how != "untouched":
            (tmp_path / LOCK).unlink()
        if how == "replaced":
            (tmp_path / LOCK).write_text("")
        thread, got = second(tmp_path, said)
        while not said:
            assert thread.is_alive(), "it did not wait"
        assert not got.is_set()
    thread.join(WAIT_S)
    assert got.is_set()
    (line,) = said
    assert line.startswith("another run")
    assert line.endswith(f" is writing into {tmp_path}: waiting until it has ended ...")
    assert (f"(process {os.getpid()} on " in line) == (how == "untouched")


def test_who_waited_for_a_lock_file_that_was_replaced_takes_the_new_one(tmp_path, monkeypatch):
    """As on a file system that locks files only."""
    flock, said = fcntl.flock, []

    def files_only(descriptor, how):
        if os.path.isdir(f"/proc/self/fd/{descriptor}"):
            raise OSError(9, "Bad file descriptor")
        return flock(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", files_only)
    with (tmp_path / LOCK).open("a+") as old:
        flock(old, fcntl.LOCK_EX)
        thread, got = second(tmp_path, said)
        while not said:
            assert thread.is_alive()
        (tmp_path / LOCK).unlink()
        new = (tmp_path / LOCK).open("a+")
        flock(new, fcntl.LOCK_EX)
    thread.join(0.3)
    assert not got.is_set(), "it holds the lock of a file that is gone"
    new.close()
    thread.join(WAIT_S)
    assert got.is_set()


def test_a_lock_that_is_a_folder_is_a_line(cells, tmp_path):
    (tmp_path / LOCK).mkdir()
    with pytest.raises(UserError, match=r"/\.lock is a folder; allowed: the lock file of a run"):
        runner.run(cells(tmp_path), progress=False)


@pytest.mark.parametrize(("name", "folder"), [("parts", False), ("cells", False), ("cells.parquet", True)])  # fmt: skip
def test_a_name_that_is_taken_is_a_line(name, folder, cells, tmp_path):
    runner.run(cells(tmp_path), progress=False)
    if folder:
        (tmp_path / name).unlink()
        (tmp_path / name).mkdir()
    else:
        shutil.rmtree(tmp_path / name)
        (tmp_path / name).write_text("mine")
    with pytest.raises((RunError, UserError)) as told:
        runner.run(cells(tmp_path), progress=False)
    assert f"{tmp_path}/{name}" in str(told.value)
    assert len(str(told.value).splitlines()) == 1
    assert (tmp_path / name).is_dir() == folder


# --- a folder that is moved, deleted or replaced during the run -----------------------------------


def moved(out):
    out.rename(out.with_name("elsewhere"))


def deleted(out):
    shutil.rmtree(out)


def replaced(out):
    moved(out)
    out.mkdir()


def made_anew(out):
    deleted(out)
    out.mkdir()


def unlocked(out):
    (out / LOCK).unlink()
    (out / LOCK).touch()


WHERE = "was moved or replaced during the run; the run's folder is now {}/elsewhere; "
GONE = "was deleted or replaced by another folder during the run; run the same command again"


@pytest.mark.parametrize(("how", "words"), [
    (moved, WHERE), (replaced, WHERE), (deleted, GONE), (made_anew, GONE),
    (unlocked, "/.lock was deleted or replaced during the run, so that another run could start"),
])  # fmt: skip
@pytest.mark.parametrize("moment", ["before a block", "after a block", "before the tables"])
def test_a_folder_that_is_gone_is_reported(how, words, moment, cells, whole, tmp_path, monkeypatch):
    out, count, block = tmp_path / "out", [], tasks.run_block

    def disturb(when):
        if when == moment and not count[3:]:
            count.append(1)
            if len(count) == 3 or when == "before the tables":
                how(out)

    def run_block(*args):
        disturb("before a block")
        found = block(*args)
        disturb("after a block")
        return found

    record = runner.record_cell

    def record_cell(*args):
        disturb("before the tables")
        return record(*args)

    monkeypatch.setattr(tasks, "run_block", run_block)
    monkeypatch.setattr(runner, "record_cell", record_cell)
    with pytest.raises(RunError) as told:
        runner.run(cells(out), progress=False)
    assert str(told.value).startswith(f"{out}{words.format(tmp_path)}" if how is unlocked else f"{out} {words.format(tmp_path)}")  # fmt: skip
    assert out.exists() == (how in (replaced, made_anew, unlocked))
    if how in (replaced, made_anew) and moment != "before the tables":
        assert not list(out.iterdir()), "nothing is written into a folder that is not the run's"
    if how is made_anew and moment == "before the tables":
        return  # within milliseconds, a record was written before the folder was looked at
    monkeypatch.undo()
    there = out.with_name("elsewhere") if how in (moved, replaced) else out
    done = runner.run(cells(there), progress=False)
    parts = 6 if moment == "before the tables" else 3 if how is unlocked else 2
    assert done.reused == (0 if how in (deleted, made_anew) else parts)
    pd.testing.assert_frame_equal(aoabench.load(there), whole, check_exact=True)


def a_task(cell):
    return tasks.Task(cell, {"ls": "key"}, RunKeys.of([cell]).origins[cell.id], 0, 1)


def test_a_worker_makes_no_folder_of_its_own(cells, tmp_path):
    (cell,) = cells(tmp_path / "gone")
    with pytest.raises(RunError, match="gone was moved, deleted or replaced during the run"):
        tasks.compute(a_task(cell), tmp_path / "gone")
    assert not (tmp_path / "gone").exists()


def test_nobody_waits_for_parts_in_a_folder_that_is_gone(cells, tmp_path):
    (cell,) = cells(tmp_path / "gone")
    with pytest.raises(RunError, match="gone was moved, deleted or replaced during the run"):
        dask.wait_until_seen(a_task(cell), tmp_path / "gone")


def test_workers_of_a_moved_folder_stop(cells, tmp_path, monkeypatch):
    """They know nothing of the move, and have blocks in hand."""
    out, note = tmp_path / "out", runner._Run._note

    def first(self, task, losses):
        note(self, task, losses)
        moved(out)

    monkeypatch.setattr(runner._Run, "_note", first)
    with pytest.raises(RunError, match=r"the run's folder is now .*/elsewhere; "):
        runner.run(cells(out, n_jobs=2, backend="threading"), progress=False)
    assert not out.exists()


# --- Windows, and systems without locks -----------------------------------------------------------


@pytest.fixture
def windows(monkeypatch):
    """Locks as Windows has them, which opens no folders."""
    system = Msvcrt()
    monkeypatch.setattr(resources, "fcntl", None)
    monkeypatch.setattr(resources, "msvcrt", system)
    monkeypatch.setattr("aoabench.store.lock._opened", lambda folder: None)
    return system


def test_a_second_run_waits_on_windows(windows, tmp_path):
    said = []
    with locked(tmp_path, unused):
        assert min(windows.places) > (tmp_path / LOCK).stat().st_size, "others could not read it"
        thread, got = second(tmp_path, said)
        while not said:
            assert thread.is_alive(), "it did not wait"
        thread.join(0.3)
        assert not got.is_set()
    thread.join(WAIT_S)
    assert got.is_set()
    assert said[0].startswith(f"another run (process {os.getpid()} on ")


def test_a_run_on_windows(cells, windows, whole, tmp_path):
    assert runner.run(cells(tmp_path), progress=False).computed == 6
    pd.testing.assert_frame_equal(aoabench.load(tmp_path), whole, check_exact=True)
    assert runner.run(cells(tmp_path), progress=False).reused == 6


def test_without_locks_the_run_says_so_and_goes_on(cells, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(resources, "fcntl", None)
    assert resources.msvcrt is None
    assert runner.run(cells(tmp_path), progress=False).computed == 6
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "locks" in line]
    assert line.startswith(f"aoabench: {tmp_path}: the file system has no locks (")
    assert line.endswith("do not start two runs into this folder at once")


def test_a_folder_that_is_gone_where_its_new_place_is_not_known(cells, tmp_path, monkeypatch):
    """As on macOS, which has no /proc, and on Windows."""
    monkeypatch.setattr("aoabench.store.lock._place", lambda opened: None)
    out = tmp_path / "out"
    out.mkdir()
    with locked(out, unused) as lock:
        moved(out)
        with pytest.raises(RunError) as told:
            lock.check()
    assert str(told.value) == (
        f"{out} was moved, deleted or replaced by another folder during the run; "
        "move it back, or run the same command again"
    )
