"""Tasks: which of them are refused as code or data changed, and when that is looked up."""

from dataclasses import replace

import pytest

from aoabench.config.compose import compose_cells
from aoabench.engine import runner, tasks
from aoabench.errors import RunError
from aoabench.loaded import DataFile, digest_of
from aoabench.store.keys import Origin, RunKeys
from aoabench.store.lock import LOCK


@pytest.fixture(scope="module")
def cell():
    words = ["filter=[]", "estimator=[ls]", "reps=6", "runner.n_jobs=1", "runner.chunk=6"]
    return compose_cells(words)[0]


@pytest.fixture
def out(tmp_path):
    """The locked folder of a run."""
    (tmp_path / LOCK).touch()
    return tmp_path


@pytest.fixture
def computed(monkeypatch):
    """The ranges of replications that were computed."""
    found, compute = [], tasks.run_block

    def noted(*arguments):
        found.append(arguments[4:6])
        return compute(*arguments)

    monkeypatch.setattr(tasks, "run_block", noted)
    return found


def stored(out):
    return [file.stem for file in sorted(out.glob("parts/*/*.json"))]


def test_a_task_of_other_code_is_refused_before_it_computes(cell, out, computed):
    """Also by a worker that has done tasks of its own code before, and does them afterwards."""
    origin = RunKeys.of([cell]).origins[cell.id]
    other = replace(origin, sources=origin.sources | {"aoabench.engine.block": "another"})
    tasks.compute(tasks.Task(cell, {"ls": "key"}, origin, 0, 2), out)
    for _ in range(2):
        with pytest.raises(RunError, match=r"block\.py was changed after it was imported"):
            tasks.compute(tasks.Task(cell, {"ls": "key"}, other, 2, 4), out)
    tasks.compute(tasks.Task(cell, {"ls": "key"}, origin, 4, 6), out)
    assert computed == [(0, 2), (4, 6)]
    assert stored(out) == ["000000000-000000002", "000000004-000000006"]


def test_a_file_that_changes_between_two_tasks(cell, out, computed):
    """The first task is kept; nothing of the second one is written, nor of a third."""
    file = out / "w.txt"
    file.write_text("1")
    origin = RunKeys.of([cell]).origins[cell.id]
    origin = replace(origin, files=(DataFile(file, digest_of(b"1")),))
    tasks.compute(tasks.Task(cell, {"ls": "key"}, origin, 0, 2), out)
    file.write_text("2")
    for _ in range(2):
        with pytest.raises(RunError, match=r"w\.txt was changed after it was read; start again"):
            tasks.compute(tasks.Task(cell, {"ls": "key"}, origin, 2, 4), out)
    assert stored(out) == ["000000000-000000002"]


def test_code_is_compared_once_per_task(cell, tmp_path, monkeypatch):
    """And once before the first one: in a sweep of small cells, the state of some thirty files."""
    checks, check = [], Origin.check

    def counted(origin):
        checks.append(origin)
        check(origin)

    monkeypatch.setattr(Origin, "check", counted)
    tasks._checked.set(None)
    options = replace(cell.runner, out=str(tmp_path / "out"))
    cells = [
        replace(cell, seed=seed, runner=options, config={**cell.config, "seed": seed})
        for seed in range(4)
    ]
    assert runner.run(cells, progress=False).computed == 4 * 6
    assert len(checks) == 1 + 4
