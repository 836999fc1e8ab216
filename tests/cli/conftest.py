"""One small run that the commands read."""

import pytest

SMALL = ["filter=[ekf_vmf]", "filter.ekf_vmf.engine=numpy", "scenario.steps=4", "reps=3", "runner.n_jobs=1"]  # fmt: skip


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    """The folder of a sweep over two cells with two filters each."""
    import aoabench

    out = tmp_path_factory.mktemp("run") / "a sweep"
    words = ["filter=[ekf_vmf,ekf_ae_nominal]", "filter.ekf_ae_nominal.engine=numpy", *SMALL[1:]]
    aoabench.run(*words, "noise=vmf,ae_flip", out=out)
    return out
