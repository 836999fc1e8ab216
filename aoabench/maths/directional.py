"""Directional distributions: von Mises-Fisher (VMF) on the sphere, and the flipped normal of
azimuth and elevation.

Every formula is written so that it neither overflows nor cancels for kappa from 1e-6 to 1e8.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from aoabench.maths.geometry import Array, tangent_basis, wrap

_SERIES_BELOW = 0.1  # kappa below which power series replace differences of nearly equal terms


def kappa_from_sigma(sigma_azimuth: ArrayLike, sigma_elevation: ArrayLike | None = None) -> Array:
    """Concentration 1 / max(sigma_azimuth^2, sigma_elevation^2), sigmas (...) rad [Nurminen 2018,
    (7)].
    """
    sigma = np.asarray(sigma_azimuth, dtype=float)
    if sigma_elevation is not None:
        sigma = np.maximum(sigma, sigma_elevation)
    return 1.0 / sigma**2


def sigma_from_kappa(kappa: ArrayLike) -> Array:
    """Standard deviation 1 / sqrt(kappa) rad of azimuth and of elevation [Nurminen 2018, (7)]."""
    return 1.0 / np.sqrt(np.asarray(kappa, dtype=float))


# --- von Mises-Fisher on the sphere in three dimensions -------------------------------------------


def vmf_logpdf(u: Array, mu: Array, kappa: ArrayLike) -> Array:
    """Log density (...) per steradian of unit vectors u (..., 3) under VMF(mu (..., 3), kappa (...)
    >= 0).

    [Nurminen 2018, (1)-(2)], with kappa mu.u written as kappa - kappa |u - mu|^2 / 2.
    """
    kappa = np.asarray(kappa, dtype=float)
    half_chord2 = 0.5 * np.sum((u - mu) ** 2, axis=-1)
    return vmf_log_peak(kappa) - kappa * half_chord2


def vmf_log_peak(kappa: ArrayLike) -> Array:
    """Log of the VMF density at its mean direction: log(kappa / (2 pi (1 - exp(-2 kappa))))."""
    kappa = np.asarray(kappa, dtype=float)
    positive = np.where(kappa > 0, kappa, 1.0)
    peak = np.log(positive / -np.expm1(-2.0 * positive)) - np.log(2 * np.pi)
    return np.where(kappa > 0, peak, -np.log(4 * np.pi))


def vmf_mean_length(kappa: ArrayLike) -> Array:
    """A(kappa) = coth(kappa) - 1 / kappa, the length of the mean vector E[u] = A mu."""
    kappa = np.asarray(kappa, dtype=float)
    k = np.minimum(kappa, _SERIES_BELOW)
    series = k * (
        1 / 3 + k**2 * (-1 / 45 + k**2 * (2 / 945 + k**2 * (-1 / 4725 + k**2 * 2 / 93555)))
    )
    large = np.maximum(kappa, _SERIES_BELOW)
    return np.where(kappa < _SERIES_BELOW, series, 1.0 / np.tanh(large) - 1.0 / large)


def vmf_variances(kappa: ArrayLike) -> tuple[Array, Array]:
    """Variances (tangential, radial) of VMF: cov(u) = t (I - mu mu^T) + r mu mu^T.

    t = A / kappa and r = 1 - 2 A / kappa - A^2 = 1 / kappa^2 - 1 / sinh^2(kappa); the last form is
    numerically stable.
    """
    kappa = np.asarray(kappa, dtype=float)
    k = np.minimum(kappa, _SERIES_BELOW)
    t_series = 1 / 3 + k**2 * (-1 / 45 + k**2 * (2 / 945 + k**2 * (-1 / 4725 + k**2 * 2 / 93555)))
    r_series = 1 / 3 + k**2 * (-1 / 15 + k**2 * (2 / 189 + k**2 * (-1 / 675 + k**2 * 2 / 10395)))
    large = np.maximum(kappa, _SERIES_BELOW)
    t = (1.0 / np.tanh(large) - 1.0 / large) / large
    q = np.exp(-2.0 * large)
    r = 1.0 / large**2 - 4.0 * q / np.expm1(-2.0 * large) ** 2
    small = kappa < _SERIES_BELOW
    return np.where(small, t_series, t), np.where(small, r_series, r)


def vmf_covariance(mu: Array, kappa: ArrayLike) -> Array:
    """Covariance (..., 3, 3) of VMF(mu (..., 3), kappa (...))."""
    t, r = (np.asarray(v)[..., None, None] for v in vmf_variances(kappa))
    outer = mu[..., :, None] * mu[..., None, :]
    return t * (np.eye(3) - outer) + r * outer


def vmf_sample(rng: np.random.Generator, mu: Array, kappa: ArrayLike) -> Array:
    """One draw (..., 3) for each mean direction mu (..., 3), kappa (...) > 0."""
    return vmf_turned(rng.random((2, *mu.shape[:-1])), mu, kappa)


def vmf_turned(v: Array, mu: Array, kappa: ArrayLike) -> Array:
    """The draw (..., 3) about mu (..., 3), kappa (...) > 0, that belongs to numbers v (2, ...)
    uniform on [0, 1): the cosine by the inverse of its distribution, and the rotation about mu.

    1 - cos(angle) = -log(1 - v (1 - exp(-2 kappa))) / kappa, accurate for any kappa.
    """
    kappa = np.asarray(kappa, dtype=float)
    one_minus_cos = -np.log1p(v[0] * np.expm1(-2.0 * kappa)) / kappa
    one_minus_cos = np.clip(one_minus_cos, 0.0, 2.0)
    sin = np.sqrt(one_minus_cos * (2.0 - one_minus_cos))
    phi = 2 * np.pi * v[1]
    e1, e2 = tangent_basis(mu)
    u = (
        (1.0 - one_minus_cos)[..., None] * mu
        + (sin * np.cos(phi))[..., None] * e1
        + (sin * np.sin(phi))[..., None] * e2
    )
    return u / np.linalg.norm(u, axis=-1, keepdims=True)


def vmf_fit(u: Array) -> tuple[Array, float]:
    """Maximum-likelihood mean direction (3,) and concentration from unit vectors (N, 3), N >= 1.

    Newton's method in log(kappa) solves A(kappa) = |mean of u|. The concentration is inf if all u
    are equal.
    """
    resultant = np.mean(u, axis=0)
    length = float(np.linalg.norm(resultant))
    if length == 0.0:
        return np.array([0.0, 0.0, 1.0]), 0.0
    mu = resultant / length
    # 1 - |mean|, without cancellation where the directions are concentrated: mean of |u - mu|^2 / 2
    deficit = float(np.mean(0.5 * np.sum((u - mu) ** 2, axis=-1)))
    if deficit <= 0.0:
        return mu, float("inf")
    kappa = length * (3.0 - length**2) / (deficit * (1.0 + length))  # Banerjee et al. 2005
    for _ in range(50):
        # f = 1 - A(kappa) - deficit; for large kappa 1 - A = 1 / kappa - 2 / (exp(2 kappa) - 1)
        gap = 1.0 / kappa - 2.0 / np.expm1(2.0 * kappa) if 1.0 < kappa < 350.0 else None
        if gap is None:
            gap = 1.0 / kappa if kappa >= 350.0 else 1.0 - float(vmf_mean_length(kappa))
        step = (gap - deficit) / (
            kappa * float(vmf_variances(kappa)[1])
        )  # dA/dkappa is the radial variance
        kappa *= float(np.exp(np.clip(step, -1.0, 1.0)))
        if abs(step) < 1e-13:
            break
    return mu, float(kappa)


# --- the normal of azimuth and elevation, flipped over the poles ----------------------------------


def flip(azimuth: Array, elevation: Array) -> tuple[Array, Array]:
    """The unique representation of directions: azimuth in (-pi, pi], elevation in [-pi/2, pi/2]
    (...) rad.

    An elevation beyond a pole is flipped to its supplementary angle and its azimuth is turned by pi
    [Nurminen 2018, Model I]. Elevations may have any size; the paper's rule covers one flip.
    """
    e = wrap(elevation)
    over = np.abs(e) > np.pi / 2
    return wrap(np.where(over, azimuth + np.pi, azimuth)), np.where(
        over, np.copysign(np.pi, e) - e, e
    )


def flip_probability(elevation: ArrayLike, sigma: float) -> Array:
    """Probability (...) that N(elevation (...), sigma^2) rad is flipped; elevation in [-pi/2,
    pi/2].
    """
    b = np.asarray(elevation, dtype=float)[..., None]
    k = 2 * np.pi * np.arange(_turns(sigma))
    above = special.ndtr((b - 0.5 * np.pi - k) / sigma) - special.ndtr(
        (b - 1.5 * np.pi - k) / sigma
    )
    below = special.ndtr((-b - 0.5 * np.pi - k) / sigma) - special.ndtr(
        (-b - 1.5 * np.pi - k) / sigma
    )
    return np.sum(above + below, axis=-1)


def flipped_azimuth_std(
    elevation: ArrayLike, sigma: float, sigma_elevation: float | None = None
) -> Array:
    """Root mean square (...) rad of the wrapped azimuth error of the flipped normal at a true
    elevation (...) rad.

    The error is N(0, sigma^2) wrapped, turned by pi with the flip probability; both second moments
    follow from the Fourier series of the squared wrapped angle.
    """
    p = flip_probability(elevation, sigma if sigma_elevation is None else sigma_elevation)
    if sigma < 0.1:  # wrapping beyond 31 standard deviations
        straight = sigma**2
        turned = np.pi**2 - 2 * np.pi * sigma * np.sqrt(2 / np.pi) + sigma**2
    else:
        k = np.arange(1, int(np.ceil(9.0 / sigma)) + 1)
        terms = 4.0 / k**2 * np.exp(-0.5 * (k * sigma) ** 2)
        straight = np.pi**2 / 3 + np.sum((-1.0) ** k * terms)
        turned = np.pi**2 / 3 + np.sum(terms)
    return np.sqrt((1.0 - p) * straight + p * turned)


def flipped_elevation_moments(elevation: ArrayLike, sigma: float) -> tuple[Array, Array]:
    """Mean error and root mean square error, both (...) rad, of the flipped elevation at a true
    elevation (...) rad.

    Closed form: between the flips, on ((m - 1/2) pi, (m + 1/2) pi), the flipped angle is (-1)^m (y
    - m pi).
    """
    b = np.asarray(elevation, dtype=float)[..., None]
    m = np.arange(-2 * _turns(sigma), 2 * _turns(sigma) + 1)
    s = np.where(m % 2 == 0, 1.0, -1.0)
    lo, hi = ((m - 0.5) * np.pi - b) / sigma, ((m + 0.5) * np.pi - b) / sigma
    pdf_lo, pdf_hi = (np.exp(-0.5 * t**2) / np.sqrt(2 * np.pi) for t in (lo, hi))
    m0 = special.ndtr(hi) - special.ndtr(lo)
    m1 = pdf_lo - pdf_hi
    m2 = m0 + lo * pdf_lo - hi * pdf_hi
    shift = b - m * np.pi - s * b  # flipped error = s (sigma t + shift), t standard normal
    mean = np.sum(s * (sigma * m1 + shift * m0), axis=-1)
    square = np.sum(sigma**2 * m2 + 2 * sigma * shift * m1 + shift**2 * m0, axis=-1)
    return mean, np.sqrt(square)


def _turns(sigma: float) -> int:
    """Number of full turns that contain a normal of deviation sigma rad up to ten deviations."""
    return int(np.ceil(10.0 * sigma / (2 * np.pi))) + 1
