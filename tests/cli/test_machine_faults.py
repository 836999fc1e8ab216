"""Errors of the file system and of Arrow: one line, exit status 1, and the same command goes on."""

import errno
import io
import os
import re
import time
from dataclasses import replace
from pathlib import Path
from pickle import dumps, loads

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import aoabench
from aoabench.cli import crash
from aoabench.config.compose import compose_cells
from aoabench.engine import runner
from aoabench.engine.faults import explained
from aoabench.errors import RunError, WriteError
from aoabench.report import plots
from aoabench.store import compare as compare_module
from aoabench.store.files import write_atomically

WORDS = ["noise=vmf", "estimator=[ls]", "scenario.steps=2", "reps=4", "runner.n_jobs=1", "runner.chunk=1"]  # fmt: skip


@pytest.fixture(scope="module")
def cells():
    """The cells of a tiny run; `in_` moves them to a folder."""
    (cell,) = compose_cells([*WORDS, "runner.out=unused"])

    def in_(folder):
        return [replace(cell, runner=replace(cell.runner, out=str(folder)))]

    return in_


@pytest.fixture(scope="module")
def whole(cells, tmp_path_factory):
    """The folder of a finished run."""
    out = tmp_path_factory.mktemp("whole")
    runner.run(cells(out), progress=False)
    return out


@pytest.fixture
def failing(monkeypatch):
    """The function (error, name): from now on, os.replace raises it for targets with that name."""
    replace = os.replace

    def arm(error, name):
        def fails(source, target):
            if name in str(target):
                raise error
            return replace(source, target)

        monkeypatch.setattr(os, "replace", fails)

    return arm


def test_an_error_keeps_its_file_on_the_way_from_a_worker():
    error = loads(dumps(WriteError(5, "Input/output error", "x")))
    assert (error.errno, error.strerror, error.filename) == (5, "Input/output error", "x")


@pytest.mark.parametrize(("error", "words"), [
    (ConnectionResetError("peer"), "ConnectionResetError: peer"), (TimeoutError(), "TimeoutError"),
])  # fmt: skip
def test_a_lost_connection_is_not_called_a_file(error, words):
    line = f"^the connection to another process or machine failed: {words}$"
    with pytest.raises(RunError, match=line), explained(Path("here")):
        raise error


def test_any_error_of_the_file_system_is_a_line():
    """The errors that differ in kind are put into a run below."""
    for number in sorted(errno.errorcode):
        with pytest.raises(RunError) as told, explained(Path("here"), "go on"):
            raise WriteError(number, os.strerror(number), "there/x.parquet")
        line = str(told.value)
        assert line.startswith(f"there/x.parquet cannot be written: {os.strerror(number)}; ")
        assert line.endswith("; go on")
        with pytest.raises(BrokenPipeError if number == errno.EPIPE else RunError), explained():
            raise OSError(number, os.strerror(number))


A_PART = "000000002-000000003.json"
AT_WORK = ["EFBIG", "EMFILE", "ENFILE", "ESTALE", "ENOMEM", "ENOENT", "ETIMEDOUT", "ENOTCONN",
           "ELOOP", "ENAMETOOLONG", "EINTR", "EROFS", "EPIPE", "EXDEV"]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "victim"),
    [(n, A_PART) for n in AT_WORK] + [("ESTALE", "cells/"), ("EMFILE", "summary.parquet")],
)
def test_a_run_that_cannot_write_keeps_its_parts_and_goes_on(
    name, victim, cells, whole, tmp_path, failing, monkeypatch
):
    number = getattr(errno, name)
    failing(OSError(number, os.strerror(number)), victim)
    with pytest.raises(RunError) as told:
        runner.run(cells(tmp_path), progress=False)
    line = str(told.value)
    assert re.match(rf"{re.escape(str(tmp_path))}/\S+ cannot be written: ", line), line
    assert victim in line.partition(" ")[0]
    assert f": {os.strerror(number)}; " in line
    assert line.endswith("finished parts are kept, the same command continues from them")
    assert not [
        file
        for file in tmp_path.rglob(".*")
        if file.is_file() and file.name not in (".lock", ".aoabench")
    ]
    monkeypatch.undo()
    done = runner.run(cells(tmp_path), progress=False)
    assert (done.computed, done.reused) == ((2, 2) if victim == A_PART else (0, 4))
    pd.testing.assert_frame_equal(aoabench.load(tmp_path), aoabench.load(whole), check_exact=True)


@pytest.mark.filterwarnings("error::UserWarning")
def test_results_that_are_not_used_any_more_give_no_warning(cells, tmp_path, monkeypatch):
    (cell,) = cells(tmp_path)
    options = replace(cell.runner, n_jobs=2, backend="threading")

    def fails(*_arguments):
        while len(list(tmp_path.glob("parts/*/*.json"))) < 3:
            time.sleep(0.001)
        raise RunError("the end")

    monkeypatch.setattr(runner._Run, "_note", fails)
    with pytest.raises(RunError, match="the end"):
        runner.run([replace(cell, runner=options)], progress=False)


@pytest.mark.parametrize(("error", "words"), [
    (pa.ArrowInvalid("Parquet magic bytes not found in footer.\nSecond line"), ["torn or altered"]),
    (OSError("ZSTD decompression failed: Data corruption detected"), ["torn or altered"]),
    (OSError(errno.EMFILE, "[Errno 24] Failed to open local file 'a/b'. Detail: [errno 24] Too many open files"),
     ["Too many open files", "'a/b'", "ulimit -n"]),
    (pa.ArrowMemoryError("malloc of size 9 failed"), ["out of memory", "malloc of size 9"]),
    (PermissionError(errno.EACCES, "Permission denied", "secret"), ["secret", "Permission denied"]),
    (RuntimeError("can't start new thread"), ["no more threads", "runner.n_jobs"]),
])  # fmt: skip
def test_each_reader_says_what_it_cannot_read(error, words, call, whole, monkeypatch):
    def fails(*_arguments, **_options):
        raise error

    monkeypatch.setattr(pq, "ParquetFile", fails)
    monkeypatch.setattr(pq, "read_table", fails)
    monkeypatch.setattr(pd, "read_parquet", fails)
    (cell,) = (file.stem for file in (whole / "cells").glob("*.json"))
    commands = {
        "compare": (whole,),
        "collect": (whole,),
        "replay": (whole, "--estimator", "ls", "--replication", 1, "--cell", cell),
    }
    for name, arguments in commands.items():
        status, _, err = call(name, *arguments)
        assert (status, len(err.splitlines())) == (1, 1), err
        assert err.startswith("aoabench: ")
        for word in words:
            assert word in err
    for reader in (aoabench.load, aoabench.compare):
        with pytest.raises(RunError, match=re.escape(words[0])):
            reader(whole)


def test_a_figure_that_cannot_be_written_is_not_called_outdated(call, tmp_path, monkeypatch):
    from aoabench.studies import reproduce as reproducing

    monkeypatch.setattr(reproducing, "all_studies", lambda: ["le2021"])
    table = Path(aoabench.__file__).parents[1] / "results" / "tables" / "le2021_fig5.parquet"
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / table.name).write_bytes(table.read_bytes())

    def full(path, _write):
        raise WriteError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr(plots, "write_atomically", full)
    status, _, err = call("report", "--results", tmp_path)
    assert status == 1, err
    assert "cannot be written: No space left on device; make room on the disk" in err
    assert len(err.splitlines()) == 1


def test_a_temporary_file_that_cannot_be_deleted_hides_no_error(tmp_path, monkeypatch):
    def write(path):
        path.touch()
        raise OSError(errno.ESTALE, "Stale file handle")

    def stale(*_arguments, **_options):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(Path, "unlink", stale)
    with pytest.raises(WriteError) as told:
        write_atomically(tmp_path / "x", write)
    assert (told.value.errno, told.value.filename) == (errno.ESTALE, str(tmp_path / "x"))


def test_standard_output_on_a_full_disk(call, monkeypatch):
    class Full(io.TextIOBase):
        def write(self, text):
            return len(text)

        def flush(self):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("sys.stdout", Full())
    status, _, err = call("list", "runner")
    assert status == 1
    assert err.startswith("aoabench: a file cannot be read or written: No space left on device;")


# --- exceptions that nobody has foreseen ----------------------------------------------------------


def test_a_fault_of_ours_is_a_line_that_names_the_traceback(call, whole, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(compare_module, "compare", None)
    status, out, err = call("compare", whole)
    assert (status, out, len(err.splitlines())) == (1, "", 1)
    (file,) = tmp_path.glob("aoabench-*.txt")
    assert "TypeError: 'NoneType' object is not callable; this is a fault of aoabench" in err
    assert str(file) in err
    assert "Traceback" in file.read_text()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    assert f"{crash.DEBUG}=1" in call("compare", whole)[2]
    monkeypatch.setenv(crash.DEBUG, "1")
    with pytest.raises(TypeError, match="'NoneType'"):
        aoabench.cli.main.main(["compare", str(whole)])


PLUGIN = """
from dataclasses import dataclass
from aoabench.scenarios.square_track import SquareTrack

@dataclass(frozen=True)
class Broken(SquareTrack):
    def truth(self, rng):
        return {}["mine"]
"""


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_fault_of_a_plug_in_is_not_called_ours(jobs, call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_broken.py").write_text(PLUGIN)
    (tmp_path / "c" / "scenario").mkdir(parents=True)
    (tmp_path / "c" / "scenario" / "broken.yaml").write_text(
        "defaults: [square_track]\n_target_: my_broken.Broken\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    words = ["scenario=broken", "plugins=[my_broken]", "--config-dir", "c", f"runner.n_jobs={jobs}"]
    status, _, err = call(
        "run", "estimator=[ls]", "reps=2", "runner.out=o", "runner.chunk=1", *words
    )
    assert status == 1, err
    assert "KeyError: 'mine'" in err
    assert f"this is a fault in {tmp_path}/my_broken.py, line 8" in err
