"""Tasks for all workers: where a run has fewer, its estimators are divided among them."""

import pytest

import aoabench
from aoabench.cell import RunnerOptions
from aoabench.config.compose import compose_cells
from aoabench.engine import runner, workers
from aoabench.engine.planning import spread, tasks_of
from aoabench.engine.tasks import Task


def task(*names, stop=4):
    return Task(None, {name: name.upper() for name in names}, None, 0, stop)


@pytest.mark.parametrize(
    ("given", "count", "expected"),
    [
        (["abcde"], 2, ["ace", "bd"]),
        (["abcd", "e"], 4, ["a", "c", "bd", "e"]),
        (["a"], 2, ["a"]),
        (["abc", "d"], 2, ["abc", "d"]),
        (["abc"], 0, ["abc"]),
        (["ab"], 16, ["a", "b"]),
        ([], 2, []),
    ],
)
def test_tasks_are_divided_until_every_worker_has_one(given, count, expected):
    found = spread([task(*names) for names in given], count)
    assert ["".join(one.keys) for one in found] == expected
    assert all(one.keys == {n: n.upper() for n in one.keys} for one in found)
    assert {(one.start, one.stop) for one in found} <= {(0, 4)}


@pytest.mark.parametrize(("cells", "count"), [(1, 32), (2, 16), (10, 8), (1000, 8)])
def test_cells_that_are_planned_together_have_fewer_and_larger_parts(cells, count):
    words = ["noise=vmf", "filter=[ekf_vmf]", "reps=4096", "runner.n_jobs=2"]
    (cell,) = compose_cells(words)
    tasks = list(tasks_of(cell, {"ekf_vmf": "key"}, None, {"ekf_vmf": []}, 4096, cells))
    assert [(t.start, t.stop) for t in tasks] == [
        (k * 4096 // count, (k + 1) * 4096 // count) for k in range(count)
    ]


@pytest.mark.parametrize("backend", ["loky", "threading"])
def test_workers_that_run_get_a_small_run_too(tmp_path, backend, monkeypatch):
    """A run of one task starts no workers; the tables do not show who computed them."""
    monkeypatch.setattr(workers, "_running", set())
    planned, compute_all = [], runner.compute_all
    monkeypatch.setattr(
        runner,
        "compute_all",
        lambda tasks, *rest: planned.append(tasks) or compute_all(tasks, *rest),
    )

    def run(out, reps=6):
        words = ["noise=vmf", "filter=[ekf_vmf,ukf_vmf]", f"reps={reps}", "runner.n_jobs=2"]
        cells = compose_cells([*words, f"runner.backend={backend}", f"runner.out={tmp_path / out}"])
        runner.run(cells, progress=False)
        return aoabench.load(tmp_path / out)

    options = RunnerOptions(out="out", backend=backend, n_jobs=2)
    before = run("first")
    assert [len(tasks) for tasks in planned] == [1]
    assert workers.idle(options) == 0
    run("second", reps=200)
    assert workers.idle(options) == 2
    assert workers.idle(RunnerOptions(out="out", backend="sequential")) == 0
    assert run("third").equals(before)
    assert [[list(t.keys) for t in tasks] for tasks in planned[2:]] == [[["ekf_vmf"], ["ukf_vmf"]]]
