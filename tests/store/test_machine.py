"""The kind of processor that parts were computed on: what counts as one, and what is said of two."""

import ast
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from aoabench.config.compose import compose_cells
from aoabench.engine import dask, machines, runner, tasks
from aoabench.errors import RunError, UserError
from aoabench.store.machine import difference, machine
from aoabench.store.parts import examined

WORDS = ["noise=vmf", "estimator=[ls]", "scenario.steps=2", "reps=4", "runner.n_jobs=1", "runner.chunk=1"]  # fmt: skip
OTHER = {**machine(), "numpy_blas": "openblas 0.3.31 Haswell"}


def cells(out, reps=4, **options):
    (cell,) = compose_cells([*WORDS, "runner.out=unused"])
    runner = replace(cell.runner, out=str(out), **options)
    return [replace(cell, reps=reps, runner=runner)]


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """The folder of two replications, computed on a processor whose BLAS is Haswell's."""
    with monkeypatch.context() as patch:
        patch.setattr(tasks, "machine", lambda: OTHER)
        runner.run(cells(tmp_path, reps=2), progress=False)
    return tmp_path


def in_another_process(**variables):
    code = "from aoabench.store.machine import machine; print(machine())"
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **variables}, capture_output=True, text=True, check=True
    )  # fmt: skip
    return ast.literal_eval(done.stdout)


def test_the_processor_is_what_the_libraries_take_it_for():
    found = machine()
    assert {"numpy_features", "numpy_blas", "scipy_blas", "llvm_cpu", "llvm_features"} == set(found)
    simd = np.show_config(mode="dicts")["SIMD Extensions"]
    assert found["numpy_features"].split() == sorted([*simd["baseline"], *simd.get("found", [])])
    from numba.core import codegen

    target = codegen.JITCPUCodegen("test")
    assert found["llvm_cpu"] == target._get_host_cpu_name()
    features = target._get_host_cpu_features().split(",")
    assert found["llvm_features"].split() == sorted(f[1:] for f in features if f[:1] == "+")


def test_processes_agree_whatever_they_have_imported_and_told_otherwise_they_differ():
    assert in_another_process() == machine()
    told = in_another_process(
        OPENBLAS_CORETYPE="Nehalem", NUMBA_CPU_NAME="generic", NPY_DISABLE_CPU_FEATURES=_disabled()
    )
    for name in ("numpy_blas", "scipy_blas"):
        assert told[name].endswith(" Nehalem")
    assert (told["llvm_cpu"], told["llvm_features"]) == ("generic", "")
    assert len(told["numpy_features"].split()) <= len(machine()["numpy_features"].split())
    said = difference(told, machine())
    assert "NumPy's BLAS openblas" in said
    assert f"LLVM's cpu generic, here {machine()['llvm_cpu']}" in said


def _disabled():
    return " ".join(np.show_config(mode="dicts")["SIMD Extensions"].get("found", []))


@pytest.mark.parametrize(("variables", "expected"), [
    ({"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+fma,+avx2,-sse4a"}, ("haswell", "avx2 fma")),
    ({"NUMBA_CPU_NAME": "generic"}, ("generic", "")),
    ({"NUMBA_DISABLE_JIT": "1"}, ("off", None)),
])  # fmt: skip
def test_numbas_variables_count(variables, expected, monkeypatch):
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    machine.cache_clear()
    try:
        found = machine()
    finally:
        machine.cache_clear()
    assert (found["llvm_cpu"], found.get("llvm_features")) == expected


def test_what_differs_is_named():
    assert difference({"a": "1"}, {"a": "1"}) == ""
    there = {"numpy_features": "A B", "llvm_cpu": "x"}
    here = {"numpy_features": "A C D", "llvm_cpu": "x", "numpy_blas": "mkl"}
    assert difference(there, here) == (
        "NumPy's BLAS none, here mkl; NumPy's features has B, here has C D"
    )


def test_each_part_names_its_machine(elsewhere):
    runner.run(cells(elsewhere), progress=False)
    (key,) = (folder.name for folder in (elsewhere / "parts").iterdir())
    parts, _ = examined(elsewhere, key)
    assert [part.machine for part in parts] == [OTHER, OTHER, machine(), machine()]


@pytest.mark.parametrize("reps", [2, 4])
def test_parts_of_another_machine_are_reported_once(reps, elsewhere, capsys):
    capsys.readouterr()
    done = runner.run(cells(elsewhere, reps), progress=False)
    assert (done.computed, done.reused) == (reps - 2, 2)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(
        "aoabench: 2 of 2 stored parts were computed on another kind of processor "
        f"(NumPy's BLAS openblas 0.3.31 Haswell, here {machine()['numpy_blas']}): "
        "last digits may differ; "
    )


def test_parts_of_this_machine_and_of_an_unknown_one_are_not(tmp_path, capsys, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(tasks, "machine", lambda: None)
        runner.run(cells(tmp_path, reps=2), progress=False)
    runner.run(cells(tmp_path, reps=3), progress=False)
    runner.run(cells(tmp_path, other_machines="refuse"), progress=False)
    assert capsys.readouterr().err == ""


def test_they_can_be_refused_before_anything_is_computed(elsewhere):
    before = sorted(elsewhere.rglob("*"))
    with pytest.raises(UserError) as told:
        runner.run(cells(elsewhere, other_machines="refuse"), progress=False)
    assert str(told.value).startswith("runner.other_machines='refuse': 2 of 2 stored parts were ")
    assert sorted(elsewhere.rglob("*")) == before
    assert runner.run(cells(elsewhere, reps=1), progress=False).reused == 1


def test_parts_that_the_run_does_not_use_are_not_counted(tmp_path, monkeypatch, capsys):
    runner.run(cells(tmp_path, reps=2), progress=False)
    with monkeypatch.context() as patch:
        patch.setattr(tasks, "machine", lambda: OTHER)
        runner.run(cells(tmp_path), progress=False)
    capsys.readouterr()
    runner.run(cells(tmp_path, reps=2, other_machines="refuse"), progress=False)
    assert "processor" not in capsys.readouterr().err


def test_a_worker_of_another_kind_refuses(tmp_path, monkeypatch):
    (cell,) = cells(tmp_path, other_machines="refuse")
    task = tasks.Task(cell, {"ls": "key"}, None, 0, 1)
    monkeypatch.setattr(machines, "machine", lambda: OTHER)
    with pytest.raises(RunError, match=r"another kind of processor than this run \(NumPy's BLAS"):
        dask.compute_remotely(0, task, tmp_path, machine())


def test_kinds_of_a_clusters_workers_are_compared(elsewhere, capsys):
    runner.run(cells(elsewhere), progress=False)
    capsys.readouterr()
    found = machines.Machines(refuse=False, remote=True)
    keys = [folder.name for folder in (elsewhere / "parts").iterdir()]
    found.compare(elsewhere, keys)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("aoabench: the parts were computed on 2 kinds of processors (NumPy's")
    found.note(examined(elsewhere, keys[0])[0], 4)
    found.settle()
    assert capsys.readouterr().err == ""
    found.remote = False
    for _ in range(2):  # as before each check of the precision
        found.settle()
    assert len(capsys.readouterr().err.splitlines()) == 1
