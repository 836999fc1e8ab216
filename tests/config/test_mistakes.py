"""Several mistakes of one run are told in one message, a line each."""

import pickle

import pytest

from aoabench.config.compose import compose_cells
from aoabench.errors import BadValue, ManyErrors, Mistakes, UserError

F = "filter=[ekf_vmf]"
CASES = [
    # overrides, and the beginning of each line
    ([F, "noise.sigma_deg=-1", "reps=0", "seed=-1"], ["reps=0", "seed=-1", "noise.sigma_deg=-1"]),
    ([F, "repz=1", "+colour=red", "noise.sigma=2"], ["repz=1", "colour", "noise.sigma:"]),
    ([F, "scenario.foo=1", "scenario.bar=2"], ["scenario.foo", "scenario.bar"]),
    (
        [F, "filter.ekf_vmf.foo=1", "filter.ekf_vmf.engine=x", "filter.ekf_vmf.measurement.kappa=0"],
        ["filter.ekf_vmf.engine", "filter.ekf_vmf.measurement.kappa", "filter.ekf_vmf.foo"],
    ),
    ([F, "filter.ukf_vmf.lambda_=1", "filter.no.a=1"], ["filter.ukf_vmf.lambda_", "filter.no.a"]),
    (["filter.ukf_vmf.lambda_=1", "reps=0"], ["filter.ukf_vmf.lambda_", "reps=0"]),
    (
        ["filter=[ekf_vfm,pf_vfm,ekf_vmf]", "estimator=[lss]", "noise.sigma_deg=-1"],
        ["filter='ekf_vfm'", "filter='pf_vfm'", "estimator='lss'", "noise.sigma_deg=-1"],
    ),
    (["scenario=a", "noise=b", "runner=c", F], ["scenario='a'", "noise='b'", "runner='c'"]),
    (["filter=[ekf_toa_aoa]", "estimator=[wcg,anchor_mean]"], ["noise='vmf'", "scenario='square_track'"]),
    ([F, "runner.n_jobs=0", "runner.chunk=0", "store.steps=7"], ["runner.n_jobs", "runner.chunk", "store.steps"]),
    ([F, "until.metric=nees", "until.se=0", "until.min_reps=1"], ["until.se=0", "until.min_reps=1"]),
    ([F, "until.se=1", "until.relative_se=1", "runner.n_jobs=x"], ["until.se", "until.relative_se", "runner.n_jobs"]),
    (["filter=[", "noise=(", F], ["filter=[ cannot", "noise=( cannot"]),
    ([F, "noise.sigma_deg=-2,5,500", "scenario.steps=0,10"], ["scenario.steps=0", "noise.sigma_deg=-2", "noise.sigma_deg=500"]),
    (["filter=[pf_vmf,ekf_vmf]", "filter.pf_vmf.particles=0", "filter.ekf_vmf.innovation_steps=0"], ["filter.ekf_vmf.innovation_steps", "filter.pf_vmf.particles"]),
]  # fmt: skip


@pytest.mark.parametrize(("words", "begin"), CASES, ids=[" ".join(case[0]) for case in CASES])
def test_all_mistakes_and_no_others(words, begin):
    with pytest.raises(ManyErrors) as error:
        compose_cells(words)
    lines = [str(one) for one in error.value.each]
    assert len(lines) == len(begin), lines
    for text in begin:
        assert sum(line.startswith(text) for line in lines) == 1, (text, lines)
    assert str(error.value).splitlines()[1:] == [f"  {line}" for line in lines]


def test_estimators_that_lack_the_same_thing_share_a_line():
    with pytest.raises(BadValue) as error:
        compose_cells(["filter=[ekf_toa_aoa]", "estimator=[wcg]"])
    assert "which filter.ekf_toa_aoa and estimator.wcg need; these fit: ofdm_crlb" in str(
        error.value
    )


def test_a_long_sweep_with_mistakes_ends_early():
    with pytest.raises(ManyErrors) as error:
        compose_cells([F, "noise.sigma_deg=range(-500,0)"])
    assert len(error.value.each) == 20


def test_the_command_prints_a_heading_and_a_line_each(call):
    status, out, err = call("run", F, "noise.sigma_deg=-1", "reps=0")
    assert (status, out) == (2, "")
    first, *rest = err.splitlines()
    assert first == "aoabench: 2 mistakes:"
    assert [line.split("=")[0] for line in rest] == ["  reps", "  noise.sigma_deg"]
    assert call("run", F, "reps=0")[2].count("\n") == 1, "one mistake is one line"


def test_collected_mistakes():
    mistakes = Mistakes()
    mistakes.check()
    assert mistakes.tried(int, "3") == 3
    for _ in range(2):
        mistakes.note(BadValue("a", 1, "2"))
    with pytest.raises(BadValue):
        mistakes.check()
    mistakes.note(ManyErrors([UserError("b\nc"), BadValue("a", 1, "2")]))
    with pytest.raises(ManyErrors) as error:
        mistakes.check()
    assert str(error.value).splitlines() == ["2 mistakes:", "  a=1 is not allowed; allowed: 2", "  b c"]  # fmt: skip
    assert str(pickle.loads(pickle.dumps(error.value))) == str(error.value)
