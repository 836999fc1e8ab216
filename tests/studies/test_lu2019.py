"""The study's own statistics and counts."""

import math
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest

from aoabench.engine.draws import Draws
from aoabench.maths.digest import flatten
from aoabench.maths.geometry import to_unit
from tests.studies.lu2019 import LU, N, errata_runs, made_up

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

class Deviation(Counted):  # its square is given with it
    def __mul__(self, o): return Counted(self.v * float(o))

def counted(a, kind=Counted):
    out = np.empty(np.shape(a), dtype=object)
    for i, v in np.ndenumerate(a): out[i] = kind(v)
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
        Counted.n = 0
        y, sigma = rng.normal(size=(3, 1, 1, M)).astype(object), np.ones((3, 1, 1, M)).astype(object)  # not counted
        K.ekf(counted(np.zeros((1, 9))), counted(np.eye(9)), F[None, None], Q[None, None], *y, *sigma,
              counted(rng.normal(size=(1, 1, M, 3))), counted(rng.normal(size=(1, 1, M, 9))), counted(np.ones((1, 1, M, 3)), Deviation),
              toa, False, False, False, False,
              np.zeros((1, 1, 3)), np.zeros((1, 1, 3, 3)), np.zeros((1, 1)), np.zeros((1, 1), int))
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


def test_each_setting_changes_one_key_and_has_a_label():
    labels = sys.modules[f"{LU.figures.__name__}.readings"].SETTINGS
    assert list(labels) == list(N.common.SETTINGS)
    base = dict(flatten(N.common.cell_of().config))
    for setting, words in N.common.SETTINGS.items():
        config = dict(flatten(N.common.cell_of(*words).config))
        changed = {k for k in base.keys() | config.keys() if base.get(k) != config.get(k)}
        assert changed == {word.split("=")[0] for word in words}, setting
        assert len(changed) == (setting != "chosen")


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
