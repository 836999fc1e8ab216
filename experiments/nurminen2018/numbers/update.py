"""Figure 2: one update near the pole, by Kalman filters and by exact integration."""

from __future__ import annotations

import numpy as np
import pandas as pd

from aoabench.filters.gaussian import Gaussian
from aoabench.filters.kalman import EKF, UKF
from aoabench.maths.geometry import to_unit
from aoabench.models.azel import AzEl, AzElAdaptive, AzElFitted
from aoabench.models.unit_vector import UnitVector
from aoabench.noise.angular import FlippedAngles
from aoabench.types import Anchors, Batch

FIG2 = {
    "mean": np.array([0.3, -0.3, -2.0]),
    "sigma_m": 0.75,
    "azimuth": -np.pi,
    "elevation": -9 * np.pi / 20,
    "sigma": np.deg2rad(5.0),
}


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
            prior = Gaussian(FIG2["mean"][None], FIG2["sigma_m"] * np.eye(3)[None])
            mean = kalman.update(prior, y, r, anchor).mean
            rows.append((name, model, *mean[0], angle_deg(mean[0], u)))
        exact = exact_mean(h, nodes)
        rows.append(("exact", model, *exact, angle_deg(exact, u)))
    rows.append(("prior", "prior", *FIG2["mean"], angle_deg(FIG2["mean"], u)))
    return pd.DataFrame(
        rows, columns=["method", "model", "x_m", "y_m", "z_m", "angle_to_measurement_deg"]
    )


def measurement_of(h: object) -> tuple[np.ndarray, np.ndarray]:
    """Figure 2's measurement (1, m) as a model sees it, and its nominal variances (1, m)."""
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
    """Angle in degrees between the direction of position x (3,) from the anchor at the origin and
    the unit vector u (3,).
    """
    v = x / np.linalg.norm(x)
    return float(np.rad2deg(2 * np.arcsin(min(1.0, 0.5 * np.linalg.norm(v - u)))))
