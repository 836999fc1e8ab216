"""Many small cells in one run: memory and file handles stay flat."""

import gc
from dataclasses import replace

import psutil

import aoabench
from aoabench.config.compose import compose_cells
from aoabench.engine import runner, tasks

CELLS = 100


def test_a_hundred_cells_leave_memory_and_handles_as_they_were(tmp_path, monkeypatch):
    """In this process, where all work is done; looked at after a fifth of the tasks, when
    everything has been loaded.
    """
    words = ["filter=[pf_vmf]", "filter.pf_vmf.particles=20"]
    words += ["reps=2", "runner.chunk=2", "runner.n_jobs=1", f"runner.out={tmp_path}"]
    first = compose_cells(words)[0]
    cells = [
        replace(first, seed=seed, config={**first.config, "seed": seed}) for seed in range(CELLS)
    ]
    me, seen = psutil.Process(), []
    compute = tasks.compute

    def watched(task, out):
        found = compute(task, out)
        seen.append((me.num_fds(), me.memory_info().rss / 2**20))
        return found

    monkeypatch.setattr(tasks, "compute", watched)
    assert runner.run(cells, progress=False).computed == 2 * CELLS
    assert len(seen) == CELLS
    early, late = (seen[CELLS // 5 :][:20], seen[-20:])
    assert max(fds for fds, _ in late) <= max(fds for fds, _ in early) + 2
    assert min(mib for _, mib in late) <= max(mib for _, mib in early) + 20
    before = me.num_fds()
    assert runner.run(cells, progress=False).computed == 0
    gc.collect()
    assert me.num_fds() <= before + 2
    assert aoabench.load(tmp_path).groupby("cell").size().eq(2).all()
