"""The study's own statistics and counts, and every printed id."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from aoabench.studies import study

LU = study.load("lu2019")
N = LU.numbers

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


def test_printed_counts():
    assert [N.cost.printed_count(name, 4, 9) for name in N.METHODS] == [27648, 13824, 44]


def made_up(levels, rng, trials=40):
    """Trials whose filter error grows with the uncertainty and whose centroid's does not."""
    rows = []
    for kind in ("independent", "common"):
        for sigma in levels:
            for name, slope, offset in (
                ("ekf_toa_aoa", 1.0, 0.0),
                ("ekf_aoa", 2.0, 0.0),
                ("wcg", 0.0, 2.0),
            ):
                for r, e in enumerate(rng.gamma(100, 0.01, trials)):
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


def test_every_printed_id_and_effect_is_found_and_every_figure_draws(rng, fig2):
    import matplotlib.pyplot as plt

    levels = [0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0]
    nees = [
        (scenario, sigma, name, t, 3.0 + rng.normal(), 16)
        for scenario in ("indoor_map", "indoor_map_model") for sigma in (0.0, 0.5, 5.0)
        for name in N.METHODS[:2] for t in (5.0, 20.0, 30.0)
    ]  # fmt: skip
    tables = {
        "table1": N.table1("quick"), "fig2": fig2, "fig4": N.fig4(made_up(levels, rng)),
        "fig3": pd.DataFrame(
            [("cdf", n, x, 0.5, np.nan, 8) for n in ("toa_m", "azimuth_deg", "elevation_deg") for x in (-1.0, 1.0)]
            + [(k, n, np.nan, 90.0, 1.0, 8) for k, n in (
                ("share", "angles_within_half_degree"), ("share", "toa_within_10_m"), ("share", "thermal_within_printed"),
                ("ratio", "all_over_thermal"))],
            columns=["kind", "name", "x", "value", "se", "trials"],
        ),
        "table2": pd.DataFrame([
            {"estimator": n, "printed_formula": 1, "textbook": 1, "ours": 1, "microseconds_per_step": 1.0} for n in N.METHODS
        ]),
        "errata": N.errata(errata_runs(rng)),
        "nees": pd.DataFrame(nees, columns=["scenario", "an_sigma_m", "estimator", "time_s", "nees", "trials"]),
    }  # fmt: skip
    found = {
        key
        for name, frame in tables.items()
        for key in getattr(LU.figures, f"{name}_values")(frame)
    }
    assert {e["id"] for e in LU.printed} <= found
    assert {e["effect"]["id"] for e in LU.errata if "effect" in e} <= found
    for item in LU.items:
        if item.figure:
            figure = getattr(LU.figures, item.name)(tables[item.name])
            assert figure.axes
            plt.close(figure)


def test_the_map_counts_what_the_paper_says(fig2):
    values = LU.figures.fig2_values(fig2)
    assert values["fig2/length_m"].value == 150
    assert values["fig2/width_m"].value == 112
    assert values["fig2/least_line_of_sight"].value >= 4
    assert values["fig2/per_25_m2"].value == pytest.approx(1.24, abs=0.005)
