"""Table I and Figure 1: likelihoods of the models of the noise, and the noise's deviations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from aoabench.maths import directional, statistics
from aoabench.maths.estimate import Estimate
from aoabench.maths.geometry import to_unit, wrap
from aoabench.models.azel import adaptive_table
from aoabench.noise.angular import FlippedAngles, VonMisesFisher

SIGMA = np.deg2rad(10.0)
DATA = {"model1": FlippedAngles(sigma_deg=10.0), "model2": VonMisesFisher(sigma_deg=10.0)}
MODELS = ("ae_nominal", "ae_fitted", "ae_adaptive", "vmf")


def table1(scale: str) -> pd.DataFrame:
    """Model comparison numbers (10), (11) with standard errors, and the fitted parameters, by Monte
    Carlo integration.

    The paper takes 10^5 samples once; here 40 (paper) or 10 (quick) times as many.
    """
    batches = {"quick": 10, "paper": 40}[scale]
    rows = []
    for data, noise in DATA.items():
        logliks, residuals = samples(noise, data, batches)
        n = logliks.shape[1]
        for model, share in zip(MODELS, shares(logliks)):
            rows.append(_row(data, model, "share", share, n))
        for model, quantity, e in distances(logliks):
            rows.append(_row(data, model, quantity, e, n))
        for angle, r in zip(("azimuth", "elevation"), residuals):
            sigma = statistics.mean(r**2).root() * np.rad2deg(1.0)
            rows.append(_row(data, "ae_fitted", f"sigma_{angle}_deg", sigma, n))
        rows.append(_row(data, "vmf", "kappa", Estimate(1 / SIGMA**2, 0.0), n))
    return pd.DataFrame(rows)


def _row(data: str, model: str, quantity: str, number: Estimate, samples: int) -> dict[str, Any]:
    """A row of `table1`."""
    row = {"data": data, "model": model, "quantity": quantity}
    return row | number.columns("value", "se") | {"samples": samples}


def samples(noise: object, data: str, batches: int) -> tuple[np.ndarray, np.ndarray]:
    """Log likelihoods (4, n) of measurements of directions uniform on the sphere, and residuals (2,
    n) rad: n = 100 000 in each of the batches.
    """
    logliks, residuals = [], []
    for batch in range(batches):
        rng = np.random.default_rng([2018, batch, data == "model2"])
        l, r = log_likelihoods(noise, *uniform_directions(rng, 100_000), rng)
        logliks.append(l)
        residuals.append(r)
    return np.concatenate(logliks, axis=1), np.concatenate(residuals, axis=1)


def shares(logliks: np.ndarray) -> list[Estimate]:
    """exp(L_i) / sum_j exp(L_j) of the mean log likelihoods L (4,) of (4, n) samples, errors by the
    delta method.
    """
    L = logliks.mean(axis=1)
    score = np.exp(L - L.max())
    share = score / score.sum()
    influence = share[:, None] * (logliks - share @ logliks)
    return [statistics.from_influence(value, i) for value, i in zip(share, influence)]


def distances(logliks: np.ndarray) -> list[tuple[str, str, Estimate]]:
    """Models, quantities and values from log likelihoods (4, n).

    "below_vmf": how far an AE model's mean lies below that of VMF, "distance": the size of that,
    "closer_than_...": how much shorter AE-adaptive's distance is than another's.
    """
    *ae, vmf = logliks
    below = {model: vmf - own for model, own in zip(MODELS, ae)}
    away = {model: np.sign(d.mean()) * d for model, d in below.items()}
    found = [(m, "below_vmf", statistics.mean(d)) for m, d in below.items()]
    found += [(m, "distance", statistics.mean(d)) for m, d in away.items()]
    near = away.pop("ae_adaptive")
    closer = [
        ("ae_adaptive", f"closer_than_{m}", statistics.mean(d - near)) for m, d in away.items()
    ]
    return found + closer


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
