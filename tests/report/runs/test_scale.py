"""What the foot of a figure says of how much was computed."""

import pytest

import aoabench
from aoabench.report.runs.choice import Asked
from aoabench.report.runs.drawing import prepare
from aoabench.report.runs.scale import scale_text
from aoabench.report.runs.source import read

CELL = (
    "runner.n_jobs=1",
    "filter=[ekf_vmf]",
    "filter.ekf_vmf.engine=numpy",
    "scenario.steps=4",
    "noise=vmf",
)


def of(experiment, config, reps, reached):
    assert config["noise"]["_target_"]
    return {"a": "paper", "b": "quick" if reps == 7 and not reached else "?"}.get(experiment, "")


@pytest.mark.parametrize(
    ("experiments", "words"),
    [
        ({"vmf": "a", "ae_flip": "b"}, "paper and quick scale"),
        ({"vmf": "a", "ae_flip": None}, "paper scale"),
        ({"vmf": "b", "ae_flip": "c"}, "own and quick scale"),
        ({"vmf": None, "ae_flip": None}, ""),
    ],
)
def test_the_scales_of_all_cells_are_named(sweep, experiments, words):
    source = read(sweep)
    source.frame["experiment"] = source.frame["noise"].map(experiments)
    assert scale_text(source, of) == words
    assert scale_text(source, None) == ""
    footer = prepare(sweep, Asked(), scale_of=of).footer[0]
    assert footer.startswith("N = 7 replications of each estimator and cell; synthetic; ")


def test_a_frame_has_no_scale(sweep):
    assert scale_text(read(aoabench.load(sweep)), of) == ""


@pytest.mark.parametrize(
    ("se", "words"), [(100, "reached"), (1e-9, "not reached by 1 of 1 estimators")]
)
def test_the_precision_of_until_is_named(tmp_path, se, words):
    until = ("until.metric=rmse_3d_m", f"until.se={se}", "until.min_reps=4", "until.max_reps=8")
    aoabench.run(*CELL, *until, out=tmp_path)
    footer = prepare(tmp_path, Asked()).footer[0]
    assert f" of each estimator; precision of until {words}; synthetic; " in footer
