"""Nurminen et al. 2018: the numbers behind each table and figure, one function per item, each
giving one frame.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from aoabench.config.compose import compose_cells
from aoabench.engine.tiles import Draws, estimate_tile
from aoabench.filters.kalman import EKF, UKF
from aoabench.maths import directional, statistics
from aoabench.maths.geometry import to_unit, wrap
from aoabench.models.azel import AzEl, AzElAdaptive, AzElFitted, adaptive_table
from aoabench.models.unit_vector import UnitVector
from aoabench.noise.angular import FlippedAngles, VonMisesFisher
from aoabench.store.summary import QUANTILES
from aoabench.types import Anchors

SIGMA = np.deg2rad(10.0)
DATA = {"model1": FlippedAngles(sigma_deg=10.0), "model2": VonMisesFisher(sigma_deg=10.0)}
MODELS = ("ae_nominal", "ae_fitted", "ae_adaptive", "vmf")
FIG2 = {
    "mean": np.array([0.3, -0.3, -2.0]),
    "sigma_m": 0.75,
    "azimuth": -np.pi,
    "elevation": -9 * np.pi / 20,
    "sigma": np.deg2rad(5.0),
}

# --- Table I --------------------------------------------------------------------------------------


def table1(scale: str) -> pd.DataFrame:
    """Model comparison numbers (10), (11) with standard errors, and the fitted parameters, by Monte
    Carlo integration.

    The paper takes 10^5 samples once; here 40 (paper) or 10 (quick) times as many.
    """
    batches, size = {"quick": 10, "paper": 40}[scale], 100_000
    rows = []
    for data, noise in DATA.items():
        logliks, residuals = [], []
        for batch in range(batches):
            rng = np.random.default_rng([2018, batch, data == "model2"])
            l, r = log_likelihoods(noise, *uniform_directions(rng, size), rng)
            logliks.append(l)
            residuals.append(r)
        L, res = np.concatenate(logliks, axis=1), np.concatenate(residuals, axis=1)
        n = L.shape[1]
        score = np.exp(L.mean(axis=1) - L.mean(axis=1).max())
        share = score / score.sum()
        influence = share[:, None] * (L - share @ L)  # delta method for exp(L_i) / sum_j exp(L_j)
        for model, value, se in zip(MODELS, share, influence.std(axis=1, ddof=1) / np.sqrt(n)):
            rows.append((data, model, "share", value, se, n))
        for angle, r in zip(("azimuth", "elevation"), res):
            rms = np.sqrt(np.mean(r**2))
            se = np.std(r**2, ddof=1) / np.sqrt(n) / (2 * rms)
            rows.append(
                (data, "ae_fitted", f"sigma_{angle}_deg", np.rad2deg(rms), np.rad2deg(se), n)
            )
        rows.append((data, "vmf", "kappa", 1 / SIGMA**2, 0.0, n))
    return pd.DataFrame(rows, columns=["data", "model", "quantity", "value", "se", "samples"])


def uniform_directions(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Azimuth and elevation (n,) rad of directions uniform on the sphere."""
    return 2 * np.pi * rng.random(n) - np.pi, np.arcsin(2 * rng.random(n) - 1)


def log_likelihoods(
    noise: object, azimuth: np.ndarray, elevation: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Log likelihoods (4, n) of one noisy measurement of each direction under the four models, and
    residuals (2, n).

    Per radian of azimuth and elevation: the VMF density gets the factor cos(elevation) of the
    change of variables.
    """
    y, e = noise.perturb(rng, azimuth, elevation)
    da, de = wrap(y - azimuth), e - elevation
    fitted = noise.printed_fit_deg
    sigma_a, sigma_e = (
        t[np.rint(np.rad2deg(elevation)).astype(int) + 90] for t in adaptive_table(SIGMA)
    )

    def normal(r: np.ndarray, s: object) -> np.ndarray:
        return -0.5 * (r / s) ** 2 - np.log(s) - 0.5 * np.log(2 * np.pi)

    return np.stack(
        [
            normal(da, SIGMA) + normal(de, SIGMA),
            normal(da, np.deg2rad(fitted[0])) + normal(de, np.deg2rad(fitted[1])),
            normal(da, sigma_a) + normal(de, sigma_e),
            directional.vmf_logpdf(to_unit(y, e), to_unit(azimuth, elevation), 1 / SIGMA**2)
            + np.log(np.cos(e)),
        ]
    ), np.stack([da, de])


# --- Figure 1 -------------------------------------------------------------------------------------


def fig1(scale: str) -> pd.DataFrame:
    """Deviations in degrees at every degree of elevation, closed form."""
    degrees = np.arange(-90.0, 91.0)
    elevation = np.deg2rad(degrees)
    bias, about_truth = directional.flipped_elevation_moments(elevation, SIGMA)
    return pd.DataFrame(
        {
            "elevation_deg": degrees,
            "azimuth_deg": np.rad2deg(directional.flipped_azimuth_std(elevation, SIGMA)),
            "elevation_about_truth_deg": np.rad2deg(about_truth),
            "elevation_about_mean_deg": np.rad2deg(
                np.sqrt(np.maximum(about_truth**2 - bias**2, 0.0))
            ),
        }
    )


# --- Figure 2 -------------------------------------------------------------------------------------


def fig2(scale: str) -> pd.DataFrame:
    """Posterior means after one update: Kalman filters and exact integration, with the angle to the
    measurement.
    """
    noise = FlippedAngles(sigma_deg=float(np.rad2deg(FIG2["sigma"])))
    models = {
        "ae_nominal": AzEl(sigma_deg=float(np.rad2deg(FIG2["sigma"]))),
        "ae_fitted": AzElFitted(fit="own", noise=noise),
        "ae_adaptive": AzElAdaptive(noise=noise),
        "vmf": UnitVector(kappa=1 / FIG2["sigma"] ** 2),
    }
    anchor = Anchors(np.zeros((1, 1, 3)), np.eye(3)[None, None])
    u = to_unit(FIG2["azimuth"], FIG2["elevation"])
    rows = []
    nodes = {"quick": 200, "paper": 400}[scale]
    for model, h in models.items():
        y, r = measurement_of(h)
        for name, kalman in (("ekf", EKF(h)), ("ukf", UKF(h))):
            mean, _ = kalman.update(
                FIG2["mean"][None], FIG2["sigma_m"] ** 2 * np.eye(3)[None], y, r, anchor
            )
            rows.append((name, model, *mean[0], angle_deg(mean[0], u)))
        exact = exact_mean(h, nodes)
        rows.append(("exact", model, *exact, angle_deg(exact, u)))
    rows.append(("prior", "prior", *FIG2["mean"], angle_deg(FIG2["mean"], u)))
    return pd.DataFrame(
        rows, columns=["method", "model", "x_m", "y_m", "z_m", "angle_to_measurement_deg"]
    )


def measurement_of(h: object) -> tuple[np.ndarray, np.ndarray]:
    """Figure 2's measurement (1, m) as a model sees it, and its nominal variances (1, m)."""
    from aoabench.types import Batch

    one = np.ones((1, 1, 1))
    anchor = Anchors(np.zeros((1, 1, 3)), np.eye(3)[None, None])
    batch = Batch(FIG2["azimuth"] * one, FIG2["elevation"] * one, anchor)
    y, r = h.observe(batch)
    return y[:, 0], r[:, 0]


def exact_mean(h: object, nodes: int) -> np.ndarray:
    """Posterior mean (3,) m by integration over distance, azimuth and elevation (nodes, 2 nodes,
    nodes of them).

    The likelihood depends on the direction alone; along each ray the prior times r^2 is integrated
    by Gauss-Legendre.
    """
    anchor = Anchors(np.zeros((1, 1, 3)), np.eye(3)[None, None])
    y, quality = measurement_of(h)
    e, we = np.polynomial.legendre.leggauss(nodes)
    e, we = e * np.pi / 2, we * np.pi / 2
    a = (np.arange(2 * nodes) + 0.5) * np.pi / nodes - np.pi
    distance, wd = np.polynomial.legendre.leggauss(nodes)
    furthest = np.linalg.norm(FIG2["mean"]) + 10 * FIG2["sigma_m"]
    distance, wd = 0.5 * furthest * (distance + 1), 0.5 * furthest * wd
    mass, moment = 0.0, np.zeros(3)
    for elevation, weight in zip(e, we):
        u = to_unit(a, elevation)
        likelihood = np.exp(h.loglik(u[None], anchor, y, quality)[0]) * weight * np.cos(elevation)
        if likelihood.max() == 0.0:
            continue
        offset2 = (
            distance**2 - 2 * (u @ FIG2["mean"])[:, None] * distance + FIG2["mean"] @ FIG2["mean"]
        )
        along = wd * distance**2 * np.exp(-0.5 * offset2 / FIG2["sigma_m"] ** 2)
        mass += likelihood @ along.sum(axis=1)
        moment += (likelihood * (along @ distance)) @ u
    return moment / mass


def angle_deg(x: np.ndarray, u: np.ndarray) -> float:
    """Angle in degrees between position x (3,), seen from the anchor in the origin, and the unit
    vector u (3,).
    """
    v = x / np.linalg.norm(x)
    return float(np.rad2deg(2 * np.arcsin(min(1.0, 0.5 * np.linalg.norm(v - u)))))


# --- Figure 3 -------------------------------------------------------------------------------------


def fig3(scale: str) -> pd.DataFrame:
    """Replication 0 of each data model on the base layout: truth, particle filters' estimates,
    anchors.
    """
    filters = [f"pf_{model}" for model in MODELS]
    rows = []
    for noise in ("ae_flip", "vmf"):
        cell = compose_cells(
            [f"noise={noise}", f"filter=[{','.join(filters)}]", "scenario=square_track"]
        )[0]
        draws = Draws(cell.scenario, cell.noise, cell.seed)
        truth, _ = draws.tile(0, 1)
        tracks = {"truth": truth[0]}
        for name, estimator in cell.estimators.items():
            tracks[name] = estimate_tile(draws, estimator, 0)[1].position[0]
        for name, track in tracks.items():
            rows += [(noise, name, k, *x, np.nan, np.nan) for k, x in enumerate(track[:, :3])]
        anchors = cell.scenario.known_anchors
        poles = anchors.rotation[0, :, 2]  # the global direction of each pole
        rows += [(noise, "anchor", j, *s, *poles[j, :2]) for j, s in enumerate(anchors.position[0])]
    return pd.DataFrame(
        rows, columns=["noise", "kind", "step", "x_m", "y_m", "z_m", "pole_x", "pole_y"]
    )


# --- from replications ----------------------------------------------------------------------------


def frames(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean RMSE of each filter in each anchor frame, and its paired change in percent from the
    unturned frames.
    """
    key = "scenario.anchors.frame_rpy_deg"
    rows = []
    for name, group in runs.groupby("estimator", sort=False):
        wide = group.pivot(index="replication", columns=key, values="rmse_3d_m")
        for frame in sorted(wide.columns, key=lambda c: (c != "[0, 0, 0]", c)):
            mean, pair = (
                statistics.mean(wide[frame]),
                statistics.paired(wide[frame], wide["[0, 0, 0]"]),
            )
            rows.append(
                (name, frame, mean.value, mean.se, pair.percent.value, pair.percent.se, len(wide))
            )
    columns = [
        "estimator",
        "frame_rpy_deg",
        "rmse_mean_3d_m",
        "se_m",
        "change_percent",
        "change_se",
        "replications",
    ]
    return pd.DataFrame(rows, columns=columns)


def fig4(runs: pd.DataFrame) -> pd.DataFrame:
    """Per layout, data model and filter: RMSE, its percentage difference from PF-VMF, paired
    differences of models.

    Columns q05 ... maximum are levels of the per-replication difference; above_X_percent is the
    paired difference of mean RMSE from the same filter with model X (pf_vmf: from PF-VMF).
    """
    rows = []
    for (layout, noise), group in runs.groupby(["scenario", "noise"], sort=False):
        wide = group.pivot(index="replication", columns="estimator", values="rmse_3d_m")
        for name in wide.columns:
            family, _, model = name.partition("_")
            percent = 100 * (wide[name] / wide["pf_vmf"] - 1)
            levels = [statistics.quantile(percent, q) for q in QUANTILES]
            mean = statistics.mean(wide[name])
            row = {
                "layout": layout,
                "noise": noise,
                "estimator": name,
                "family": family,
                "model": model,
            }
            row |= {
                "particles": int(group["filter.pf_vmf.particles"].iloc[0]),
                "replications": len(wide),
            }
            row |= {"rmse_mean_3d_m": mean.value, "se_m": mean.se}
            row |= {f"q{round(100 * q):02d}": level.value for q, level in zip(QUANTILES, levels)}
            row |= {"median_se": levels[2].se, "minimum": percent.min(), "maximum": percent.max()}
            others = {"pf_vmf": "pf_vmf"} | {
                m: f"{family}_{m}" for m in ("vmf", "ae_nominal", "ae_fitted")
            }
            for other, against in others.items():
                pair = statistics.paired(wide[name], wide[against]).percent
                row |= {f"above_{other}_percent": pair.value, f"above_{other}_se": pair.se}
            rows.append(row)
    return pd.DataFrame(rows)


def layouts(runs: pd.DataFrame) -> pd.DataFrame:
    """The same over the layout variants."""
    return fig4(runs)


def adaptivity(runs: pd.DataFrame) -> pd.DataFrame:
    """Per layout, data model and form of AE-adaptive: paired percentage from the same filter with
    another AE model.
    """
    rows = []
    for (layout, noise), group in runs.groupby(["scenario", "noise"], sort=False):
        wide = group.pivot(index="replication", columns="estimator", values="rmse_3d_m")
        for name in ("ekf_ae_adaptive", "ukf_ae_adaptive", "ukf_ae_adaptive_augmented"):
            for other in ("ae_nominal", "ae_fitted"):
                pair = statistics.paired(
                    wide[name], wide[f"{name.partition('_')[0]}_{other}"]
                ).percent
                rows.append((layout, noise, name, other, pair.value, pair.se, len(wide)))
    columns = ["layout", "noise", "estimator", "other", "above_percent", "above_se", "replications"]
    return pd.DataFrame(rows, columns=columns)


def particles(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean RMSE of each particle filter against the number of particles, and its paired excess over
    the largest one.
    """
    rows = []
    for (noise, name), group in runs.groupby(["noise", "estimator"], sort=True):
        wide = group.pivot(
            index="replication", columns="filter.pf_vmf.particles", values="rmse_3d_m"
        )
        for count in sorted(wide.columns):
            mean, pair = (
                statistics.mean(wide[count]),
                statistics.paired(wide[count], wide[max(wide.columns)]).percent,
            )
            rows.append(
                (noise, int(count), name, mean.value, mean.se, pair.value, pair.se, len(wide))
            )
    columns = [
        "noise",
        "particles",
        "estimator",
        "rmse_mean_3d_m",
        "se_m",
        "above_largest_percent",
        "above_largest_se",
    ]
    return pd.DataFrame(rows, columns=[*columns, "replications"])
