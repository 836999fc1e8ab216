"""Figure 4 of lu2019 shows the printed range: medians beside RMSE, values beyond it as marks."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from aoabench.studies import stored, study

RESULTS = Path(__file__).parents[2] / "results"
LU = study.load("lu2019")
FRAME = stored.table(RESULTS, LU, next(i for i in LU.items if i.name == "fig4"))
SHOWN_M = sys.modules[LU.figures.fig4.__module__].SHOWN_M
ROWS = FRAME[(FRAME["an_error"] == "independent") & FRAME["an_sigma_m"].notna()]


def drawn(axis):
    return [np.asarray(line.get_ydata(), dtype=float) for line in axis.lines]


@pytest.fixture
def figure():
    yield lambda frame: LU.figures.fig4(frame)
    plt.close("all")


def test_rmse_and_median_of_each_method_are_drawn_in_the_printed_range(figure):
    axis = figure(FRAME).axes[0]
    assert axis.get_ylim() == SHOWN_M
    assert axis.get_ylim()[1] > 29, "the largest printed number"
    for name, rows in ROWS.groupby("estimator"):
        rows = rows.sort_values("an_sigma_m")
        seen = rows["rmse_3d"].where(rows["rmse_3d"] <= axis.get_ylim()[1])
        for values in (seen, rows["median_3d"]):
            assert any(np.array_equal(y, values, equal_nan=True) for y in drawn(axis)), name
        assert rows["median_3d"].between(*axis.get_ylim()).all()


def test_what_lies_beyond_the_axis_is_marked_with_its_value(figure):
    axes = figure(FRAME).axes
    beyond = ROWS[ROWS["rmse_3d"] > SHOWN_M[1]]["rmse_3d"]
    assert len(beyond) > 1
    texts = {text.get_text() for text in axes[0].texts}
    shown = [float(t.split()[0]) * {"km": 1000, "m": 1}[t.split()[1]] for t in texts]
    assert sorted(shown) == pytest.approx(sorted(beyond), rel=0.005)
    assert not [t for t in texts if "e" in t], "no exponents"
    shares = 100 * ROWS[ROWS["estimator"] == "ekf_aoa"].sort_values("an_sigma_m")["diverged"]
    assert any(np.array_equal(y, shares) for y in drawn(axes[4])), "divergence stands below"


def test_the_vertical_median_is_drawn_where_the_table_has_it(figure):
    older = FRAME.drop(columns="median_z", errors="ignore")
    newer = older.assign(median_z=older["rmse_z"] / 2)
    count = len(figure(older).axes[2].lines)
    assert len(figure(newer).axes[2].lines) == count + 3
