"""The study's own statistics and counts, and the numbers and verdicts of its claims."""

import math
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

from aoabench.engine.tiles import Draws
from aoabench.maths.digest import flatten
from aoabench.maths.geometry import to_unit
from aoabench.store.files import write_frame
from aoabench.studies import statements, study

LU = study.load("lu2019")
N = LU.numbers
LEVELS = [0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0]

COUNTING = """
import math
from types import SimpleNamespace
import numpy as np
from aoabench.kernels import access_nodes as K
from aoabench.kernels import square_root
from aoabench.models.motion import ConstantAcceleration

class Counted:
    n = 0
    def __init__(self, v): self.v = float(v)
    def __add__(self, o): return Counted(self.v + float(o))
    def __sub__(self, o): return Counted(self.v - float(o))
    def __rsub__(self, o): return Counted(float(o) - self.v)
    def __mul__(self, o): Counted.n += 1; return Counted(self.v * float(o))
    def __truediv__(self, o): Counted.n += 1; return Counted(self.v / float(o))
    def __rtruediv__(self, o): Counted.n += 1; return Counted(float(o) / self.v)
    __radd__, __rmul__ = __add__, __mul__
    def __neg__(self): return Counted(-self.v)
    def __lt__(self, o): return self.v < float(o)
    def __le__(self, o): return self.v <= float(o)
    def __gt__(self, o): return self.v > float(o)
    def __abs__(self): return Counted(abs(self.v))
    def __float__(self): return self.v

def counted(a):
    out = np.empty(np.shape(a), dtype=object)
    for i, v in np.ndenumerate(a): out[i] = Counted(v)
    return out

K.TILE = 1
K.np = SimpleNamespace(empty=lambda shape: counted(np.zeros(shape)), zeros=lambda shape: counted(np.zeros(shape)), rint=np.rint)
K.math = SimpleNamespace(sqrt=lambda x: Counted(math.sqrt(float(x))), isnan=lambda x: math.isnan(float(x)), inf=math.inf, nan=math.nan)
square_root.math = K.math
K.angle = lambda y, x, length: Counted(math.atan2(float(y), float(x)))
K.wrapped = lambda a: a
rng, (F, Q) = np.random.default_rng(0), ConstantAcceleration(0.1).matrices(0.1)
for toa in (True, False):
    for M in (1, 4, 8):
        y = rng.normal(size=(1, 1, M, 3))
        if not toa: y[..., 0] = np.nan
        Counted.n = 0
        K.ekf(counted(np.zeros((1, 9))), counted(np.eye(9)), F, Q, counted(y), counted(np.ones(y.shape)), np.arange(M)[None],
              counted(rng.normal(size=(1, M, 3))), counted(rng.normal(size=(M, 3, 3))), counted(np.ones((M, 3))),
              False, False, False, False, np.zeros((1, 1, 3)), np.zeros((1, 1, 3, 3)), np.zeros((1, 1)))
        print("ekf_toa_aoa" if toa else "ekf_aoa", M, Counted.n)
"""


def test_our_count_is_what_the_kernel_multiplies():
    """The kernel's source, run as plain Python on numbers that count their multiplications and
    divisions.
    """
    environment = {"NUMBA_DISABLE_JIT": "1", "PATH": ""}
    done = subprocess.run(
        [sys.executable, "-c", COUNTING],
        capture_output=True,
        text=True,
        env=environment,
        check=True,
    )
    lines = [line.split() for line in done.stdout.splitlines()]
    assert len(lines) == 6
    for method, M, count in lines:
        assert N.cost.our_count(method, int(M)) == int(count)


def test_textbook_count_is_what_dense_loops_multiply():
    """Each product of (17), (18) by its dimensions: rows x columns x inner length."""
    m, n = 12, 9
    products = [
        (n, 1, n),
        (n, n, n),
        (n, n, n),
        (n, m, n),
        (m, m, n),
        (n, m, m),
        (n, 1, m),
        (m, n, n),
        (n, n, m),
    ]
    products.remove((m, n, n))  # H P is the transpose of P H^T
    assert N.cost.textbook_count(m, n) == sum(a * b * c for a, b, c in products) + m**3


@dataclass
class Counted:
    """A number that counts the multiplications it takes part in."""

    products = 0

    def __mul__(self, other):
        Counted.products += 1
        return self

    def __add__(self, other):
        return self


def test_the_centroids_printed_count_is_that_of_its_equations():
    """(12): c tau cos(phi) cos(theta) and so on; (14): each position times its weight."""
    c, tau, cos_phi, sin_phi, cos_theta, sin_theta, an, weight = (Counted() for _ in range(8))
    Counted.products = 0
    for _ in range(4):
        x = an + c * tau * cos_phi * cos_theta
        y = an + c * tau * cos_phi * sin_theta
        z = an + c * tau * sin_phi
        _ = [x * weight, y * weight, z * weight]
    assert N.cost.textbook_centroid_count(4) == Counted.products


def test_printed_counts():
    assert [N.cost.printed_count(name, 4, 9) for name in N.METHODS] == [27648, 13824, 44]


def made_up(levels, rng, trials=40, slopes=(1.0, 2.0, 0.0), begin=2.0, shape=100):
    """Trials whose errors grow with the uncertainty by `slopes`, the filters' from 1 cm and the
    centroid's from `begin` m on; the larger the shape, the less the trials differ.
    """
    rows = []
    for kind in ("independent", "common"):
        for sigma in levels:
            for name, slope, offset in zip(N.METHODS, slopes, (0.01, 0.01, begin)):
                for r, e in enumerate(rng.gamma(shape, 1 / shape, trials)):
                    rmse = offset * e + slope * sigma * e
                    rows.append((f"{kind}{sigma}", kind, sigma, name, r, rmse, 0.1 * rmse))
    columns = [
        "cell",
        "noise.an_error",
        "noise.an_sigma_m",
        "estimator",
        "replication",
        "rmse_3d_m",
        "rmse_z_m",
    ]
    return pd.DataFrame(rows, columns=columns)


def test_crossing_is_found_with_its_interval(rng):
    runs = made_up([0.0, 1.0, 3.0, 5.0], rng)
    half = runs[runs["noise.an_error"] == "common"]
    for name, where in (("ekf_toa_aoa", 2.0), ("ekf_aoa", 1.0)):
        found = N.trials.crossing(half, name)
        assert found["crossing_low_m"] <= found["crossing_m"] <= found["crossing_high_m"]
        assert found["crossing_m"] == pytest.approx(where, abs=0.1)
    never = N.trials.crossing(half[half["noise.an_sigma_m"] <= 1.0], "ekf_toa_aoa")
    assert np.isinf(never["crossing_m"])


def test_diverged_trials_are_counted_and_not_dropped(rng):
    runs = made_up([0.0, 5.0], rng)
    lost = (
        (runs["estimator"] == "ekf_aoa")
        & (runs["noise.an_sigma_m"] == 5.0)
        & (runs["replication"] < 4)
    )
    runs.loc[lost, "rmse_3d_m"] = 1000.0
    row = (
        N.fig4(runs)
        .set_index(["an_error", "an_sigma_m", "estimator"])
        .loc["common", 5.0, "ekf_aoa"]
    )
    assert row["diverged"] == pytest.approx(0.1)
    assert row["rmse_3d"] > 300
    assert 5 < row["kept_3d"] < 15


def errata_runs(rng):
    rows = []
    for sigma in (0.0, 5.0):
        for gain in ("[]", '["gain"]'):
            for flags in ("[]", '["jacobian"]', '["wrap"]', '["shared"]', '["cross"]'):
                for name in ("ekf_toa_aoa", "ekf_aoa", "wcg", "wcg_as_printed"):
                    factor = (
                        1
                        + ("gain" in gain)
                        + 2 * ("wrap" in flags) * ("ekf" in name)
                        + 3 * ("printed" in name)
                    )
                    for r, e in enumerate(rng.gamma(100, 0.01, 5)):
                        rows.append(
                            (f"{sigma}{gain}{flags}", sigma, gain, flags, name, r, factor * e)
                        )
    columns = [
        "cell",
        "noise.an_sigma_m",
        "noise.as_printed",
        "filter.ekf_toa_aoa.as_printed",
        "estimator",
    ]
    return pd.DataFrame(rows, columns=[*columns, "replication", "rmse_3d_m"])


def test_each_erratum_is_taken_alone(rng):
    frame = N.errata(errata_runs(rng))
    variants = frame.groupby("estimator")["variant"].unique()
    assert set(variants["ekf_aoa"]) == {"meant", "gain", "jacobian", "wrap", "shared", "cross"}
    assert set(variants["wcg"]) == {"meant", "gain", "alpha"}
    rmse = frame[frame["an_sigma_m"] == 0].set_index(["estimator", "variant"])["median_m"]
    for key, factor in {
        ("ekf_aoa", "meant"): 1,
        ("ekf_aoa", "gain"): 2,
        ("ekf_toa_aoa", "wrap"): 3,
        ("wcg", "alpha"): 4,
    }.items():
        assert rmse[key] == pytest.approx(factor, rel=0.2)


@pytest.fixture(scope="module")
def fig2():
    return N.fig2("quick")


def pilots():
    """A table of Figure 3, made up: one number for each name and setting."""
    curves = [("cdf", "chosen", n, x, 0.5, np.nan, 8) for n in N.setting.GRIDS for x in (-1.0, 1.0)]
    numbers = [
        (kind, setting, name, np.nan, 90.0, 1.0, 8)
        for setting in N.common.SETTINGS
        for name, (kind, _) in N.setting.NUMBERS.items()
    ]
    exact = [("exact", "chosen", "clock_m", np.nan, 3.0, 0.0, 0)]
    columns = ["kind", "setting", "name", "x", "value", "se", "trials"]
    return pd.DataFrame(curves + numbers + exact, columns=columns)


def readings_of(rng, monkeypatch, excess=1.3):
    """The table of the readings, of made-up trials whose filters err `excess` times the
    centroid.
    """

    def trials(cell, count):
        centroid = rng.gamma(4, 0.5, count)
        return {
            name: dict.fromkeys(("3d", "z"), centroid * (1 if name == "wcg" else excess))
            for name in N.METHODS
        }

    module = sys.modules[f"{N.__name__}.readings"]
    monkeypatch.setattr(module, "trial_rmses", trials)
    monkeypatch.setattr(module, "cell_of", lambda *_: None)
    return N.readings("quick")


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


def test_each_setting_changes_one_key_and_has_a_label():
    labels = sys.modules[f"{LU.figures.__name__}.readings"].SETTINGS
    assert list(labels) == list(N.common.SETTINGS)
    base = dict(flatten(N.common.cell_of().config))
    for setting, words in N.common.SETTINGS.items():
        config = dict(flatten(N.common.cell_of(*words).config))
        changed = {k for k in base.keys() | config.keys() if base.get(k) != config.get(k)}
        assert changed == {word.split("=")[0] for word in words}, setting
        assert len(changed) == (setting != "chosen")


def test_the_excess_is_paired_within_the_trials(rng, monkeypatch):
    frame = readings_of(rng, monkeypatch)
    found = LU.figures.readings_values(frame)
    excess, trials = found["readings/all_in_sight/common/5/ekf_aoa/excess_z"]
    assert excess.value == pytest.approx(30.0)
    assert excess.se == pytest.approx(0.0, abs=1e-9)
    assert trials == 8
    assert "readings/all_in_sight/common/5/wcg/excess_z" not in found
    assert found["readings/chosen/common/5/wcg/median_3d"][0].se > 0
    assert len(LU.figures.readings_table(frame)) == 2 * len(N.common.SETTINGS)


def test_shares_of_azimuth_and_elevation_are_apart():
    errors = {
        "azimuth_deg": np.array([-0.6, 0.1, 0.2, 0.5]),
        "elevation_deg": np.array([0.1, -0.1, 0.1, 0.1]),
        "toa_m": np.array([3.0, -3.0, 3.0, 11.0]),
        "thermal_cm": np.array([0.01, 0.02, 0.03, 9.0]),
        "across_m": np.array([[0.2, 0.0], [0.2, 0.2]]),
    }
    found = {name: number(errors) for name, (_, number) in N.setting.NUMBERS.items()}
    toa = math.sqrt((3 * 9 + 121) / 4)
    expected = {
        "azimuth_within_half_degree": 75.0,
        "elevation_within_half_degree": 100.0,
        "toa_within_10_m": 75.0,
        "thermal_median_cm": 0.025,
        "all_over_thermal": toa / 0.00025,
        "toa_over_across": toa / math.sqrt(0.03),
    }
    assert found == pytest.approx(expected)


@pytest.fixture(scope="module")
def coarse():
    """A cell of few steps, and the words that make it so."""
    return N.common.cell_of("scenario.dt=5", "noise.an_sigma_m=0.5")


def test_errors_across_are_distances_between_directions(coarse):
    """The points at the true distance in the measured and in the true direction."""
    draws = Draws(coarse.scenario, coarse.noise, coarse.seed)
    truth, batch = draws.tile(0, 8)
    anchors = coarse.scenario.true_anchors
    offset = truth[:, :, None, :3] - anchors.position
    d = np.linalg.norm(offset, axis=-1)
    local = to_unit(batch.azimuth, batch.elevation)
    measured = np.einsum("rtbi,bij->rtbj", local, anchors.rotation[0, 0])
    apart = np.linalg.norm(d[..., None] * measured - offset, axis=-1)
    for r, errors in enumerate(N.setting.tile_errors(coarse, draws, 0)):
        expected = apart[r][np.isfinite(batch.azimuth[r])]
        small = expected < 0.05 * d[r][np.isfinite(batch.azimuth[r])]
        assert small.mean() > 0.9
        across = np.hypot(*errors["across_m"].T)
        assert across[small] == pytest.approx(expected[small], rel=2e-3)


def test_trials_of_the_readings_are_the_cells_replications(coarse):
    few, more = (N.readings.__globals__["trial_rmses"](coarse, n) for n in (8, 16))
    assert set(more) == set(N.METHODS)
    for name, found in more.items():
        for part, values in found.items():
            assert len(values) == len(np.unique(values)) == 16
            assert np.array_equal(values[:8], few[name][part])


def test_the_map_counts_what_the_paper_says(fig2):
    values = LU.figures.fig2_values(fig2)
    assert values["fig2/length_m"].value == 150
    assert values["fig2/width_m"].value == 112
    assert values["fig2/least_line_of_sight"].value >= 4
    assert values["fig2/per_25_m2"].value == pytest.approx(1.24, abs=0.005)
