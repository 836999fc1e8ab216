"""The numbers that the study's claims are judged by, and verdicts where the truth is known."""

import math
import sys

import numpy as np
import pandas as pd
import pytest

from aoabench.store.files import write_frame
from aoabench.studies import statements, study
from tests.studies.lu2019 import LEVELS, LU, N, errata_runs, made_up, pilots, readings_of


@pytest.fixture(scope="module")
def fig2():
    return N.fig2("quick")


def test_every_claim_and_effect_is_found_and_every_figure_draws(rng, fig2, monkeypatch):
    import matplotlib.pyplot as plt

    nees = [
        (scenario, sigma, name, t, 3.0 + rng.normal(), 16)
        for scenario in ("indoor_map", "indoor_map_model") for sigma in (0.0, 0.5, 5.0)
        for name in N.METHODS[:2] for t in (5.0, 20.0, 30.0)
    ]  # fmt: skip
    tables = {
        "table1": N.table1("quick"), "fig2": fig2, "fig4": N.fig4(made_up(LEVELS, rng)),
        "fig3": pilots(), "operations": N.operations("quick"),
        "readings": readings_of(rng, monkeypatch),
        "table2": pd.DataFrame([
            {"estimator": n, "printed_formula": 1, "textbook": 1, "ours": 1, "microseconds_per_step": 1.0} for n in N.METHODS
        ]),
        "errata": N.errata(errata_runs(rng)),
        "nees": pd.DataFrame(nees, columns=["scenario", "an_sigma_m", "estimator", "time_s", "nees", "trials"]),
    }  # fmt: skip
    values = {name: getattr(LU.figures, f"{name}_values")(frame) for name, frame in tables.items()}
    for claim in LU.claims:
        for reading in claim.readings:
            assert reading.ids(values[claim.item]), (claim.id, reading.name)
    found = set().union(*values.values())
    assert {e["effect"]["id"] for e in LU.errata if "effect" in e} <= found
    for item in LU.items:
        if item.figure:
            figure = getattr(LU.figures, item.name)(tables[item.name])
            assert figure.axes
            plt.close(figure)


def verdicts_of(frame, folder):
    """Verdict by claim of Figure 4, from a table at paper scale."""
    item = next(i for i in LU.items if i.name == "fig4")
    write_frame(study.table_path(folder, LU, item), frame, {"scale": "paper"})
    found = statements.verdicts([LU], folder).claims
    return found[found["item"] == "fig4"].set_index("id")["verdict"]


@pytest.mark.parametrize(("slopes", "better", "worse", "steeper"), [
    ((1.2, 1.1, 0.1), "holds", "holds", "holds"),  # they cross between 0.5 and 0.75 m
    ((0.5, 0.5, 0.1), "holds", "fails", "holds"),
    ((2.5, 0.5, 0.1), "fails", "fails", "holds"),  # the first crosses before 0.5 m
    ((0.1, 0.1, 0.5), "holds", "fails", "fails"),
])  # fmt: skip
def test_verdicts_of_trials_whose_truth_is_known(slopes, better, worse, steeper, rng, tmp_path):
    runs = made_up(LEVELS, rng, slopes=slopes, begin=0.65, shape=10_000)
    found = verdicts_of(N.fig4(runs), tmp_path)
    words = [found[f"fig4/{name}"] for name in ("better", "worse", "steeper", "all_worse")]
    assert words == [better, worse, steeper, "holds"]
    assert found["fig4/centimetres"] == "holds", "1 cm at exact access nodes"


def test_a_mean_without_variance_is_not_judged(rng, tmp_path):
    runs = made_up(LEVELS, rng)
    lost = runs["estimator"].str.startswith("ekf") & (runs["noise.an_sigma_m"] == 0)
    runs.loc[lost & (runs["replication"] == 3), ["rmse_3d_m", "rmse_z_m"]] = 1e6
    found = verdicts_of(N.fig4(runs), tmp_path)
    assert found["fig4/centimetres"] == found["fig4/better"] == "holds"
    for name in ("centimetres", "better", "5/ekf_aoa/3d", "5/ekf_aoa/z"):
        assert found[f"fig4/{name}/all"] == "not judged"


def hand_made(**columns):
    """Rows of Figure 4 at 0.5 and 2.5 m, for a filter and the centroid."""
    rows = []
    for sigma, filter_m, centroid_m in ((0.5, 0.3, 1.0), (2.5, 1.5, 1.2)):
        for name, value in (("ekf_aoa", filter_m), ("wcg", centroid_m)):
            row = {"an_error": "common", "an_sigma_m": sigma, "estimator": name, "trials": 9}
            for measure in ("rmse", "kept", "median"):
                for part in ("3d", "z"):
                    row |= {f"{measure}_{part}": value, f"{measure}_{part}_se": 0.01 * value}
            row |= dict.fromkeys(("diverged", "diverged_se", "above_wcg", "above_wcg_se"), 0.0)
            row |= {"above_wcg_z": 0.0, "above_wcg_z_se": 0.0}
            rows.append(row)
    crossing = {"an_error": "common", "estimator": "ekf_aoa"} | columns
    return pd.DataFrame([*rows, crossing])


def test_excess_and_growth_by_hand():
    found = LU.figures.fig4_values(hand_made(crossing_low_m=np.inf, crossing_high_m=np.inf))
    at = "fig4/common/2.5/ekf_aoa"
    for measure in ("median_3d", "median_z", "kept_3d", "kept_z"):
        excess, trials = found[f"{at}/{measure}/above_wcg"]
        assert excess.value == pytest.approx(25.0)
        assert excess.se == pytest.approx(100 * 1.25 * math.sqrt(2) * 0.01)
        assert trials == 9
        slope, steeper = (found[f"{at}/{measure}/{name}"][0] for name in ("slope", "steeper"))
        assert slope.value == pytest.approx(0.6)
        assert slope.se == pytest.approx(math.hypot(0.015, 0.003) / 2)
        assert steeper.value == pytest.approx(0.6 - 0.1)
        assert f"fig4/common/0.5/ekf_aoa/{measure}/slope" not in found
    assert "fig4/common/2.5/wcg/median_3d/slope" in found
    assert "fig4/common/2.5/wcg/median_3d/steeper" not in found


def test_a_table_without_the_vertical_median_has_the_other_numbers():
    frame = hand_made(crossing_low_m=np.inf, crossing_high_m=np.inf)
    found = LU.figures.fig4_values(frame.drop(columns=["median_z", "median_z_se"]))
    assert "fig4/common/2.5/ekf_aoa/kept_z/above_wcg" in found
    assert "fig4/common/2.5/ekf_aoa/median_z" not in found


@pytest.mark.parametrize(("low", "high", "name", "value", "se"), [
    (2.0, 2.2, "ekf_aoa", 2.1, 0.1 / 1.96),
    (2.0, np.inf, "ekf_aoa", 2.1, np.nan),
    (np.inf, np.inf, "ekf_aoa/beyond", 2.5, 0.0),
])  # fmt: skip
def test_a_crossing_beyond_the_range_says_so(low, high, name, value, se):
    frame = hand_made(crossing_m=2.1, crossing_low_m=low, crossing_high_m=high)
    found = LU.figures.fig4_values(frame)
    assert [k for k in found if "crossing" in k] == [f"fig4/common/crossing/{name}"]
    estimate = found[f"fig4/common/crossing/{name}"][0]
    assert estimate.value == value
    assert estimate.se == pytest.approx(se, nan_ok=True, abs=1e-12)


def test_operations_grow_as_their_highest_power():
    """The textbook inverts 2 M or 3 M rows and multiplies full matrices: cubic in M and in n."""
    found = LU.figures.operations_values(N.operations("quick"))
    for name in N.METHODS[:2]:
        assert 7.5 < found[f"operations/{name}/textbook/twice_M"].value < 8
        assert 7.5 < found[f"operations/{name}/textbook/twice_n"].value < 8
        assert 1.9 < found[f"operations/{name}/ours/twice_M"].value < 2
        assert 3.9 < found[f"operations/{name}/printed_formula/twice_M"].value < 4
    assert found["operations/wcg/textbook/twice_M"].value == 2
    assert found["operations/wcg/textbook/per_node"].value == 11
    assert found["operations/wcg/ours/per_node"].value == 20


def test_excess_and_share_are_paired_within_the_trials(rng, monkeypatch):
    frame = readings_of(rng, monkeypatch)
    found = LU.figures.readings_values(frame)
    key = "readings/all_in_sight/common/5/ekf_aoa"
    excess, trials = found[f"{key}/excess_z"]
    assert excess.value == pytest.approx(30.0)
    assert excess.se == pytest.approx(0.0, abs=1e-9)
    assert trials == 8
    assert found[f"{key}/worse_z"][0].value == 100
    assert f"{key.replace('ekf_aoa', 'wcg')}/worse_z" not in found
    assert found["readings/chosen/common/5/wcg/median_3d"][0].se > 0
    assert len(LU.figures.readings_table(frame)) == 2 * len(N.common.SETTINGS)


def test_numbers_of_the_readings_by_hand():
    module = sys.modules[f"{N.__name__}.readings"]
    centroid = np.arange(1.0, 41.0)
    factor = np.array([0.5] * 10 + [2.0] * 20 + [1000.0] * 10)  # a quarter diverges
    found = module._numbers(factor * centroid, centroid, "3d")
    assert found["worse_3d"] == 0.75
    assert found["excess_3d"] == found["excess_3d_low"] == found["excess_3d_high"] == 100
    assert found["median_3d"] == pytest.approx(np.median(factor * centroid))


def test_the_map_counts_what_the_paper_says(fig2):
    values = LU.figures.fig2_values(fig2)
    assert values["fig2/length_m"].value == 150
    assert values["fig2/width_m"].value == 112
    assert values["fig2/least_line_of_sight"].value >= 4
    assert values["fig2/per_25_m2"].value == pytest.approx(1.24, abs=0.005)
