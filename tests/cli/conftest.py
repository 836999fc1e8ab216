"""One small run that the commands read, and a call of the command line in this process."""

import pytest

from aoabench.cli.main import main

SMALL = ["filter=[ekf_vmf]", "filter.ekf_vmf.engine=numpy", "scenario.steps=4", "reps=3", "runner.n_jobs=1"]  # fmt: skip


@pytest.fixture
def call(capsys):
    """The function (words) -> exit status, standard output, standard error."""

    def run(*words):
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main([str(word) for word in words])
        return stop.value.code, *capsys.readouterr()

    return run


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    """The folder of a sweep over two cells with two filters each."""
    import aoabench

    out = tmp_path_factory.mktemp("run") / "a sweep"
    words = ["filter=[ekf_vmf,ekf_ae_nominal]", "filter.ekf_ae_nominal.engine=numpy", *SMALL[1:]]
    aoabench.run(*words, "noise=vmf,ae_flip", out=out)
    return out
