"""Which figure a run's contents and a user's wishes give."""

import pytest

from aoabench.errors import UserError
from aoabench.report.runs.choice import Asked, choose
from aoabench.report.runs.source import read

TWO = {"a": [1.0, 2.0], "b": [3.0, 4.0]}
SIGMA = {"noise.sigma_deg": [2, 5, 10]}


def chosen(frame, fixes=False, steps=False, **asked):
    return choose(read(frame), Asked(**asked), fixes, steps)


@pytest.mark.parametrize(
    ("swept", "kind", "over", "panels"),
    [
        ({}, "cdf", (), ()),
        ({"noise": ["x", "y"]}, "cdf", (), ("noise",)),
        ({"seed": [1, 2]}, "cdf", (), ("seed",)),
        (SIGMA, "curve", ("noise.sigma_deg",), ()),
        ({**SIGMA, "noise": ["x", "y"]}, "curve", ("noise.sigma_deg",), ("noise",)),
        ({**SIGMA, "k": [1, 2]}, "heatmap", ("noise.sigma_deg", "k"), ("estimator",)),
        ({"k": [1, 2], "s": ["x", "y"], **SIGMA}, "heatmap", ("k", "noise.sigma_deg"), ("estimator", "s")),
    ],
)  # fmt: skip
def test_what_was_swept_decides(frame, swept, kind, over, panels):
    found = chosen(frame(TWO, **swept))
    assert (found.kind, found.over, found.panels) == (kind, over, panels)
    assert (found.by, found.metric) == ("estimator", "rmse_3d_m")


def test_errors_of_fixes_are_drawn_where_they_are_stored(frame):
    whole = frame(TWO)
    assert chosen(whole, fixes=True).metric == "error_3d_m"
    assert chosen(whole, fixes=True, kind="pairs").metric == "rmse_3d_m"
    assert chosen(whole, fixes=True, metric="rmse_xy_m").metric == "rmse_xy_m"


def test_what_is_not_on_an_axis_has_panels(frame):
    whole = frame(TWO, **SIGMA, noise=["x", "y"])
    found = chosen(whole, by="noise")
    assert (found.over, found.panels) == (("noise.sigma_deg",), ("estimator",))
    found = chosen(whole, over=("noise",))
    assert (found.kind, found.over, found.panels) == ("curve", ("noise",), ("noise.sigma_deg",))
    found = chosen(whole, over=("estimator",), by="noise")
    assert (found.over, found.panels) == (("estimator",), ("noise.sigma_deg",))
    found = chosen(whole, kind="heatmap")
    assert (found.over, found.panels) == (("noise.sigma_deg", "noise"), ("estimator",))


def test_a_baseline_asks_for_pairs(frame):
    assert chosen(frame(TWO, **SIGMA), baseline="a").kind == "pairs"


def test_other_kinds_that_fit_are_named(frame):
    assert chosen(frame(TWO, **SIGMA)).others == ("cdf", "box", "violin", "pairs")
    assert chosen(frame({"a": [1.0, 2.0]})).others == ("box", "violin")


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"kind": "bar"}, "kind=bar: no such kind; allowed: cdf, box, violin, curve, heatmap"),
        ({"kind": "curves"}, "kind=curves: no such kind; did you mean 'curve'?"),
        ({"metric": "rmse"}, "metric=rmse: no such metric"),
        ({"by": "nois"}, "by nois: no such column; did you mean 'noise'?"),
        ({"kind": "heatmap"}, "kind=heatmap: it needs two swept parameters, and this run sweeps "
         "noise.sigma_deg; these kinds fit: cdf, box, violin, curve, pairs"),
        ({"kind": "time"}, "kind=time: it needs the steps, which a frame does not hold"),
        ({"over": ("noise",)}, "over=noise: has one value here; allowed"),
        ({"over": ("noise.sigma_deg",), "by": "noise.sigma_deg"}, "over=noise.sigma_deg: is used"),
        ({"kind": "cdf", "over": ("noise.sigma_deg",)}, "over=noise.sigma_deg: allowed for kind=cdf: no parameter"),
        ({"baseline": "c"}, "baseline=c: not among these results; allowed: a, b"),
        ({"kind": "cdf", "baseline": "a"}, "baseline=a: allowed for kind=pairs alone"),
        ({"kind": "pairs", "by": "noise"}, "by=noise: allowed for kind=pairs: estimator"),
        ({"kind": "cdf", "metric": "cep50_m"}, "kind=cdf: cep50_m is one number for a cell"),
        ({"kind": "curve", "metric": "error_xy_m"}, "kind=curve: error_xy_m is the error of a fix; "
         "use an RMSE, such as rmse_3d_m"),
        ({"metric": "error_xy_m"}, "metric=error_xy_m: no kind of figure fits"),
        ({"kind": "box", "metric": "error_xy_m"}, "kind=box: the fixes are not stored; run the same "
         "command again with store.steps=true, or use rmse_3d_m"),
    ],
)  # fmt: skip
def test_a_wish_that_does_not_fit_is_one_line(frame, asked, message):
    with pytest.raises(UserError) as error:
        chosen(frame(TWO, **SIGMA), **asked)
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)


def test_pairs_need_two_estimators_in_a_cell(frame):
    whole = frame(TWO, x=[1, 2])
    apart = whole[(whole["x"] == 1) == (whole["estimator"] == "a")]
    with pytest.raises(UserError, match="kind=pairs: it needs two estimators in a cell"):
        chosen(apart, kind="pairs")


def test_steps_are_asked_for_where_they_lack(sweep, grid):
    assert choose(read(sweep), Asked("time"), True, True).metric == "error_3d_m"
    with pytest.raises(UserError, match=r"run the same command again with store\.steps=true"):
        choose(read(grid), Asked("time"), True, False)
