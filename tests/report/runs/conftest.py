"""Small runs: a sweep with steps, positions that replications share, and two recorded tags."""

import numpy as np
import pytest

import aoabench
from tests.cli.test_recordings import ANCHORS, log

QUICK = ("runner.n_jobs=1", "filter.ekf_vmf.engine=numpy", "filter.ekf_ae_nominal.engine=numpy")


@pytest.fixture(scope="session")
def sweep(tmp_path_factory):
    """The folder of a sweep over two noises and three deviations, with two filters and steps."""
    out = tmp_path_factory.mktemp("plot") / "sweep"
    words = ("noise=vmf,ae_flip", "noise.sigma_deg=2,5,10", "filter=[ekf_vmf,ekf_ae_nominal]")
    aoabench.run(*QUICK, *words, "scenario.steps=5", "reps=7", "store.steps=true", out=out)
    return out


@pytest.fixture(scope="session")
def grid(tmp_path_factory):
    """The folder of a run whose replications share their positions."""
    out = tmp_path_factory.mktemp("plot") / "grid"
    words = ("scenario=bs_grid", "noise=vmf", "noise.sigma_deg=2,5", "estimator=[ls,vmf_ml]")
    aoabench.run(*words, "scenario.positions=12", "reps=4", "runner.n_jobs=1", out=out)
    return out


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """A function (known) -> folder of a run on two recorded tags, with or without true positions."""
    folder = tmp_path_factory.mktemp("recorded")
    frame = log({"A": 9, "B": 6})
    ANCHORS.to_csv(folder / "anchors.csv", index=False)

    def made(known):
        out = folder / f"out-{known}"
        if not out.exists():
            path = folder / f"log-{known}.csv"
            xyz = ["x_m", "y_m", "z_m"]
            (frame if known else frame.drop(columns=xyz)).to_csv(path, index=False)
            words = (f"scenario.path={path}", f"scenario.anchors={folder / 'anchors.csv'}")
            aoabench.run(
                "scenario=recorded", *words, "estimator=[ls_lines,vmf_ml]", QUICK[0], out=out
            )
        return out

    return made


@pytest.fixture
def frame():
    """The function (values by estimator, other columns) -> a frame as `aoabench.load` returns it,
    with a cell for each combination of the other columns.
    """
    import itertools

    import pandas as pd

    def made(values, **swept):
        rows = []
        for at in itertools.product(*swept.values()):
            given = dict(zip(swept, at))
            cell = "-".join(map(str, at)) or "c"
            names = {"cell": cell, "experiment": None, "scenario": "s", "noise": "n", "seed": 1}
            for name, column in values.items():
                for number, value in enumerate(np.atleast_1d(column)):
                    one = {"estimator": name, "replication": number, "rmse_3d_m": value}
                    rows.append({**names, **one, "outcome": "ok", **given})
        return pd.DataFrame(rows)

    return made
