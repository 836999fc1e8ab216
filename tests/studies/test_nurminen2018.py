"""Nurminen et al. 2018: Table I against quadrature, Figure 2's exact posterior, layout, third
argument, errata.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from aoabench.config.compose import compose_cells
from aoabench.engine.block import run_block
from aoabench.maths import directional as d
from aoabench.maths import geometry as g
from aoabench.maths.statistics import paired
from aoabench.models.azel import AzEl, AzElAdaptive, adaptive_table
from aoabench.models.unit_vector import UnitVector
from aoabench.noise.angular import FlippedAngles
from aoabench.studies import study
from aoabench.types import Anchors

STUDY = study.load("nurminen2018")
SIGMA = np.deg2rad(10)


# --- Table I --------------------------------------------------------------------------------------


def expected_logliks(data: str) -> np.ndarray:
    """E[log likelihood] of the four models by quadrature over elevation, angle and turn:
    independent of the samplers.
    """
    fitted = np.deg2rad([18.0 if data == "model1" else 21.0, 10.0])
    kappa = 1 / SIGMA**2
    sine, w_sine = np.polynomial.legendre.leggauss(300)
    elevation, w_elevation = np.arcsin(sine), 0.5 * w_sine
    table_a, table_e = adaptive_table(SIGMA)

    cosines, turns, weights = vmf_nodes()

    def second_moments(b, u):
        if data == "model1":
            return d.flipped_azimuth_std(b, SIGMA) ** 2, d.flipped_elevation_moments(b, SIGMA)[
                1
            ] ** 2
        a, e = g.to_azel(u[..., 0], u[..., 1], u[..., 2])
        return np.sum(weights * a**2), np.sum(weights * (e - b) ** 2)

    def vmf_terms(b, u):
        """E[log vmf + log cos e] at true elevation b."""
        if data == "model2":
            value = d.vmf_log_peak(kappa) - kappa * (1 - cosines)
            return np.sum(weights * (value + 0.5 * np.log(u[..., 0] ** 2 + u[..., 1] ** 2)))
        t, w = np.polynomial.hermite_e.hermegauss(12)  # the azimuth enters by its cosine alone
        w = w / w.sum()
        s = (
            np.arange(4000) + 0.5
        ) / 4000 * 16 - 8  # trapezoid for the elevation: log cos has a singularity
        ws = np.exp(-0.5 * s**2)
        ws /= ws.sum()
        a, e = SIGMA * t[:, None], b + SIGMA * s[None]
        u = g.to_unit(a, e)  # flipping leaves the direction as it is
        cos_angle = u @ g.to_unit(0.0, b)
        value = d.vmf_log_peak(kappa) - kappa * (1 - cos_angle) + np.log(np.abs(np.cos(e)))
        return w @ value @ ws

    L = np.zeros(4)
    for b, w in zip(elevation, w_elevation):
        u = around(b, cosines, turns) if data == "model2" else None
        a2, e2 = second_moments(b, u)
        k = round(np.rad2deg(b)) + 90
        for i, (sa, se) in enumerate([(SIGMA, SIGMA), fitted, (table_a[k], table_e[k])]):
            L[i] += w * (-0.5 * (a2 / sa**2 + e2 / se**2) - np.log(2 * np.pi * sa * se))
        L[3] += w * vmf_terms(b, u)
    return L


def vmf_nodes():
    kappa = 1 / SIGMA**2
    v, w = np.polynomial.legendre.leggauss(120)
    cosines = 1 + np.log1p(0.5 * (v + 1) * np.expm1(-2 * kappa)) / kappa
    turns = (np.arange(360) + 0.5) * 2 * np.pi / 360
    return cosines[:, None], turns[None], np.broadcast_to(0.5 * w[:, None] / 360, (120, 360))


def around(b, cosines, turns):
    sine = np.sqrt(1 - cosines**2)
    north, east = sine * np.cos(turns), sine * np.sin(turns)
    c = cosines + 0 * turns
    return np.stack(
        [c * np.cos(b) - north * np.sin(b), east, c * np.sin(b) + north * np.cos(b)], axis=-1
    )


@pytest.fixture(scope="module")
def table1():
    return STUDY.numbers.table1("quick")


@pytest.mark.parametrize("data", ["model1", "model2"])
def test_table1_agrees_with_quadrature(data, table1):
    """Four shares per data model within 3 standard errors of 1e6 samples: false alarm 2e-2 in all
    (fixed seed).
    """
    L = expected_logliks(data)
    exact = np.exp(L - L.max())
    exact /= exact.sum()
    rows = table1[(table1["data"] == data) & (table1["quantity"] == "share")]
    assert np.all(np.abs(rows["value"].to_numpy() - exact) < 3.0 * rows["se"].to_numpy()), (
        exact,
        rows,
    )


def test_elevation_limits_must_be_plus_minus_half_pi():
    """Erratum N9: over [0, pi] of the equator-based elevation, as (10), (11) print, half of the
    mass is missing.
    """
    sine, w = np.polynomial.legendre.leggauss(200)
    density = 1 / (4 * np.pi)  # uniform directions per steradian, times cos(elevation) per radian
    full = 2 * np.pi * density * w.sum()
    e = 0.5 * np.pi * (sine + 1)
    printed = 2 * np.pi * density * np.sum(0.5 * np.pi * w * np.maximum(np.cos(e), 0))
    assert full == pytest.approx(1)
    assert printed == pytest.approx(0.5, abs=1e-3)


# --- Figure 2 -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "h",
    [
        UnitVector(kappa=(36 / np.pi) ** 2),
        AzEl(sigma_deg=5.0),
        AzElAdaptive(noise=FlippedAngles(5.0)),
    ],
    ids=["vmf", "ae", "adaptive"],
)
def test_exact_posterior_converges_under_refinement(h):
    """Doubling the nodes changes the mean by less than 1 mm (adaptive: the table's steps are of one
    degree, 5 mm).
    """
    coarse, fine = (STUDY.numbers.update.exact_mean(h, nodes) for nodes in (120, 240))
    assert np.allclose(coarse, fine, atol=5e-3 if isinstance(h, AzElAdaptive) else 1e-3)


def test_exact_posterior_equals_importance_sampling():
    """Self-normalised sampling from the prior, 4e6 draws: each coordinate within 5 standard errors,
    6e-6.
    """
    h = UnitVector(kappa=(36 / np.pi) ** 2)
    y, r = STUDY.numbers.update.measurement_of(h)
    rng = np.random.default_rng(4)
    x = STUDY.numbers.update.FIG2["mean"] + 0.75 * rng.standard_normal((1, 4_000_000, 3))
    from aoabench.types import Anchors

    L = h.loglik(x, Anchors(np.zeros((1, 1, 3)), np.eye(3)[None, None]), y, r)[0]
    w = np.exp(L - L.max())
    w /= w.sum()
    mean = w @ x[0]
    se = np.sqrt((w**2) @ (x[0] - mean) ** 2)
    assert np.all(np.abs(mean - STUDY.numbers.update.exact_mean(h, 160)) < 5 * se)


@pytest.mark.parametrize("model", ["ae_nominal", "vmf"])
def test_figure_2_is_a_textbook_update_from_the_papers_prior(model):
    """EKF with a covariance P = 0.75^2 I, written out [Nurminen 2018, Section IV-C], and the moments
    of the seven sigma points for the UKF's predicted measurement.
    """
    setting = STUDY.numbers.FIG2
    x, P = setting["mean"], setting["sigma_m"] ** 2 * np.eye(3)
    h = AzEl(5.0) if model == "ae_nominal" else UnitVector(kappa=1 / np.deg2rad(5.0) ** 2)
    anchor = Anchors(np.zeros((1, 1, 3)), np.eye(3)[None, None])
    y, r = STUDY.numbers.update.measurement_of(h)
    H = h.jacobian(x[None], anchor)[0]
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(r[0]))
    mean = x + K @ h.residual(y, h.predict(x[None], anchor))[0]
    rows = STUDY.numbers.fig2("quick").set_index(["method", "model"])
    found = rows.loc[("ekf", model), ["x_m", "y_m", "z_m"]].to_numpy(dtype=float)
    assert np.allclose(found, mean, atol=1e-9)
    root = np.sqrt(3.5) * setting["sigma_m"]
    points = np.concatenate([x[None], x + root * np.eye(3), x - root * np.eye(3)])
    w = np.array([0.5 / 3.5, *[0.5 / 3.5] * 6])
    assert np.allclose(w, 1 / 7), "equally weighted"
    centre = h.predict(points[:1], anchor)
    d = h.residual(np.concatenate([h.predict(p[None], anchor) for p in points]), centre)
    middle, moved = w @ d, points - x
    S = (d - middle).T @ (w[:, None] * (d - middle)) + np.diag(r[0])
    D = moved.T @ (w[:, None] * (d - middle))
    mean = x + D @ np.linalg.solve(S, h.residual(y, centre + middle)[0])
    found = rows.loc[("ukf", model), ["x_m", "y_m", "z_m"]].to_numpy(dtype=float)
    assert np.allclose(found, mean, atol=1e-9)


def test_earlier_versions_elevation_is_a_colatitude():
    """Erratum N10: -19 pi / 20 there can only be the colatitude +19 pi / 20, the same direction as
    -9 pi / 20 here.
    """
    colatitude = 19 * np.pi / 20
    z = np.cos(colatitude)
    assert g.to_unit(-np.pi, -9 * np.pi / 20)[2] == pytest.approx(z)
    assert np.pi / 2 - colatitude == pytest.approx(-9 * np.pi / 20)


# --- track and layout -----------------------------------------------------------------------------


def cell(scenario="square_track", noise="vmf", *more):
    return compose_cells([f"scenario={scenario}", f"noise={noise}", "filter=[ekf_vmf]", *more])[0]


POLE_LINES = {
    "square_track": {0: [0, 1], 2: [2, 3]},
    "square_track_far": {0: [0, 1], 2: [2, 3]},
    "square_track_corner": {0: [0, 1], 1: [2, 3]},
    "square_track_sides": {0: [0], 1: [1], 2: [2], 3: [3]},
    "square_track_upright": {},
}


@pytest.mark.parametrize("scenario", POLE_LINES)
def test_which_sides_are_pole_lines_of_which_anchors(scenario):
    """Reading and erratum N11: "elevation zero" means at the pole; each variant has the poles that
    it says.
    """
    s = cell(scenario).scenario
    for side in range(4):
        x = s.at(np.array([5.0 * side + 1.7, 5.0 * side + 3.1]))[None]
        anchors = s.true_anchors
        elevation = g.to_azel(*g.in_frames(x, anchors.position, anchors.rotation))[1][0]
        at_pole = np.flatnonzero(np.all(np.isclose(elevation, np.pi / 2), axis=0))
        assert list(at_pole) == POLE_LINES[scenario].get(side, [])


def test_track_is_one_lap_counter_clockwise(track):
    corners = track.at(np.array([0.0, 5, 10, 15, 20, 21, -1]))
    assert np.allclose(corners[:, :2], [[0, 0], [5, 0], [5, 5], [0, 5], [0, 0], [1, 0], [0, 1]])
    assert np.all(corners[:, 2] == 0)
    mean, sigma = track.step_length()
    assert mean == pytest.approx(0.3133, abs=5e-5)
    assert 64 * mean == pytest.approx(20, abs=0.1)
    assert sigma == pytest.approx(np.sqrt(2 * 0.25 * 0.25 * (1 - np.pi / 4)))


def test_step_lengths_follow_equation_12(track):
    """Mean and variance of 64 x 2000 steps along the first side, 4 standard errors each: 1e-4."""
    lengths = []
    for seed in range(2000):
        x = track.truth(np.random.default_rng(seed))
        step = np.diff(x[:8, 0])
        if np.all(x[:8, 1] == 0) and np.all(x[:8, 0] > 0.0):
            lengths.append(step)
    lengths = np.concatenate(lengths)
    mean, sigma = track.step_length()
    n = len(lengths)
    assert n > 10_000
    assert abs(lengths.mean() - mean) < 4 * sigma / np.sqrt(n) + 2e-3, (
        "tracks that turn back are left out"
    )


def test_prior_mean_is_drawn_once_per_replication_around_the_true_start(track):
    """Mean and variance of 3 x 4000 draws, 4 standard errors: 2e-4."""
    draws = np.array([track.prior(np.random.default_rng(i), None)[0] for i in range(4000)])
    assert np.all(np.abs(draws.mean(axis=0)) < 4 / np.sqrt(4000))
    assert np.all(np.abs(draws.var(axis=0) - 1) < 4 * np.sqrt(2 / 4000))


# --- the third argument ---------------------------------------------------------------------------


def test_turning_anchor_frames_leaves_vmf_filters_alone_and_changes_ae_filters():
    """Paired over 512 replications: VMF changes stay within 4 standard errors (4 tests, 3e-4), AE's
    exceed 10.
    """
    names = [
        "ekf_ae_nominal",
        "ekf_ae_fitted",
        "ekf_ae_adaptive",
        "ekf_vmf",
        "ukf_ae_nominal",
        "ukf_ae_fitted",
        "ukf_ae_adaptive",
        "ukf_vmf",
    ]
    rmse = {}
    for turn in ("[0,0,0]", "[30,40,50]", "[90,0,0]"):
        c = compose_cells(
            ["noise=vmf", f"filter=[{','.join(names)}]", f"scenario.anchors.frame_rpy_deg={turn}"]
        )
        assert len(c) == 1
        rows = run_block(c[0].scenario, c[0].noise, c[0].estimators, 1, 0, 512)
        rmse[turn] = {name: block["rows"]["rmse_3d_m"] for name, block in rows.items()}
    for turn in ("[30,40,50]", "[90,0,0]"):
        for name in names:
            change = paired(rmse[turn][name], rmse["[0,0,0]"][name]).percent
            if name.endswith("vmf"):
                assert abs(change.value) < 4 * change.se, (name, turn, change)
    for name in names:
        if not name.endswith("vmf"):
            changes = [
                paired(rmse[t][name], rmse["[0,0,0]"][name]).percent
                for t in ("[30,40,50]", "[90,0,0]")
            ]
            assert max(abs(c.value) / c.se for c in changes) > 10, name


# --- errata ---------------------------------------------------------------------------------------


def test_every_erratum_names_a_test_that_exists_and_has_an_id_of_its_own():
    errata = yaml.safe_load((STUDY.folder / "errata.yaml").read_text())
    assert len({e["id"] for e in errata}) == len(errata) >= 12
    root = Path(__file__).parents[2]
    for e in errata:
        file, _, function = e["test"].partition("::")
        assert f"def {function}(" in (root / file).read_text(), e["id"]
        assert set(e) == {"id", "where", "printed", "correct", "test"}


# --- claims ---------------------------------------------------------------------------------------


def test_the_prints_own_error_is_that_of_its_samples(table1):
    """printed_se in claims.yaml against the table's standard error at 10^5 samples; the standard
    deviation of a heavy tail varies by a tenth.
    """
    rows = table1.set_index(["data", "model", "quantity"])
    checked = 0
    for claim in STUDY.claims:
        if claim.item == "table1" and claim.kind == "number":
            _, data, model, quantity = claim.id.split("/")
            row = rows.loc[(data, model, quantity)]
            assert claim.printed_se == pytest.approx(row["se"] * (row["samples"] / 1e5) ** 0.5, rel=0.12)  # fmt: skip
            checked += 1
    assert checked == 12


def test_distances_of_models_are_paired_differences_of_mean_log_likelihoods():
    rng = np.random.default_rng(5)
    logliks = rng.normal(size=(4, 5000)) + [[-0.5], [-0.2], [0.1], [0.0]]
    found = {(m, q): e for m, q, e in STUDY.numbers.models.distances(logliks)}
    nominal, fitted, adaptive, vmf = logliks
    assert found["ae_nominal", "below_vmf"].value == pytest.approx((vmf - nominal).mean())
    above = (adaptive - vmf).mean()
    assert above > 0, "the case where a distance is not a shortfall"
    assert found["ae_adaptive", "below_vmf"].value == pytest.approx(-above)
    assert found["ae_adaptive", "distance"].value == pytest.approx(above)
    closer = found["ae_adaptive", "closer_than_ae_fitted"]
    d = (vmf - fitted) - (adaptive - vmf)
    assert closer.value == pytest.approx(d.mean())
    assert closer.se == pytest.approx(d.std(ddof=1) / 5000**0.5)


def test_wins_and_excess_beyond_the_particle_filter():
    """On made-up laps: counted by hand; the excess in points against a bootstrap-free recomputation."""
    rng = np.random.default_rng(2)
    names = STUDY.figures.ORDER
    wide = {n: rng.gamma(9.0, 1 + 0.2 * i / len(names), 400) for i, n in enumerate(names)}
    runs = pd.DataFrame([
        {"scenario": "square_track", "noise": "vmf", "estimator": n, "replication": r,
         "rmse_3d_m": x, "filter.pf_vmf.particles": 10}
        for n, values in wide.items() for r, x in enumerate(values)
    ])  # fmt: skip
    table = STUDY.numbers.fig4(runs).set_index("estimator")
    row = table.loc["ukf_ae_fitted"]
    assert row["wins_percent"] == pytest.approx(
        100 * np.mean(wide["ukf_ae_fitted"] < wide["ukf_vmf"])
    )
    own = wide["ukf_ae_fitted"].mean() / wide["ukf_vmf"].mean()
    of_pf = wide["pf_ae_fitted"].mean() / wide["pf_vmf"].mean()
    assert row["beyond_pf_percent"] == pytest.approx(100 * (own - of_pf))
    laps = np.stack([wide[n] for n in ("ukf_ae_fitted", "ukf_vmf", "pf_ae_fitted", "pf_vmf")])

    def excess(some):
        a, b, c, d = some.mean(axis=1)
        return a / b - c / d

    left = [excess(np.delete(laps, i, axis=1)) for i in range(400)]
    jackknife = 100 * np.sqrt(399 * np.var(left))
    assert row["beyond_pf_se"] == pytest.approx(jackknife, rel=0.01)
    augmented = table.loc["ukf_ae_adaptive_augmented"]
    own = wide["ukf_ae_adaptive_augmented"].mean() / wide["ukf_vmf"].mean()
    of_pf = wide["pf_ae_adaptive"].mean() / wide["pf_vmf"].mean()
    assert augmented["beyond_pf_percent"] == pytest.approx(100 * (own - of_pf))


def test_deviations_about_the_mean():
    """Sampled flipped angles: about the truth their root mean square error, about the mean their
    standard deviation, +- 5 of its errors.
    """
    rng = np.random.default_rng(8)
    about = {a: adaptive_table(SIGMA, a) for a in ("truth", "mean")}
    for degrees in (-90, -80, 0, 65, 88):
        elevation = np.full(40_000, np.deg2rad(degrees))
        _, e = FlippedAngles(10.0).perturb(rng, np.zeros_like(elevation), elevation)
        error = e - elevation
        wanted = {"truth": np.sqrt(np.mean(error**2)), "mean": error.std()}
        for a, value in wanted.items():
            assert about[a][1][degrees + 90] == pytest.approx(value, rel=5 / np.sqrt(2 * 40_000))
    assert np.array_equal(about["truth"][0], about["mean"][0]), "an azimuth has no mean error"
    h = AzElAdaptive(10.0, noise=FlippedAngles(10.0), adaptive_about="mean")
    assert np.allclose(h.variances()[:, 1], about["mean"][1] ** 2)
