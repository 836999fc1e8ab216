"""Azimuth-elevation (AE) measurement models: nominal, fitted and adaptive deviations [Nurminen
2018, (4), IV-A].

Components in anchor order: azimuth and elevation of anchor 1, of anchor 2, ... in rad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from functools import lru_cache

import numpy as np

from aoabench.errors import BadValue
from aoabench.maths.directional import flipped_azimuth_std, flipped_elevation_moments
from aoabench.maths.geometry import Array, in_frames, rotations_for, to_azel, wrap
from aoabench.models.components import (
    interleave,
    into_state,
    over_measured,
    per_step,
    stated_deviations,
    unstated_param,
    with_quality,
)
from aoabench.params import param
from aoabench.roles import Measurement, Noise
from aoabench.types import Anchors, Batch, Calibration

_RHO2_FLOOR = 1e-12  # m^2: guards the azimuth's derivative on the pole axis, where it is undefined


@dataclass(frozen=True)
class AzEl(Measurement):
    """AE model with constant deviations."""

    sigma_deg: float | None = param(
        None,
        "standard deviation of both angles; null: the measurements' stated deviations",
        unit="deg",
        above=0,
        most=180,
    )
    _: KW_ONLY
    unstated_deg: Sequence[float] = unstated_param()
    kernel = "azel"

    @property
    def uses(self) -> frozenset[str]:  # type: ignore[override]
        return frozenset({"elevation"} | ({"stated_sigma"} if self.sigmas() is None else set()))

    def sigmas(self) -> tuple[float, float] | None:
        """Deviations (azimuth, elevation) in rad, or None for the measurements' own."""
        return None if self.sigma_deg is None else (math.radians(self.sigma_deg),) * 2

    def deviations(self, batch: Batch) -> tuple[Array, Array]:
        """Nominal deviations (R|1, T|1, B) rad of azimuths and elevations."""
        own = self.sigmas()
        if own is not None:
            azimuth, elevation = np.tile(np.reshape(own, (2, 1, 1, 1)), batch.azimuth.shape[2])
            return azimuth, elevation
        return stated_deviations(batch, self.unstated_deg)

    def observe(self, batch: Batch) -> tuple[Array, Array]:
        """Azimuths and elevations (R, T, 2B) rad with their nominal variances (R, T, 2B) rad^2."""
        y = interleave((batch.azimuth, batch.elevation))
        return with_quality(y, interleave(self.deviations(batch)) ** 2)

    def predict(self, x: Array, anchors: Anchors) -> Array:
        """Azimuths and elevations (R, ..., 2B) rad of positions x (R, ..., n)."""
        return interleave(to_azel(*in_frames(x[..., :3], *anchors.frames)))

    def residual(self, y: Array, expected: Array) -> Array:
        """y - expected (..., 2B) rad, the azimuths wrapped into (-pi, pi]."""
        d = y - expected
        d[..., 0::2] = wrap(d[..., 0::2])
        return d

    def jacobian(self, x: Array, anchors: Anchors) -> Array:
        """Derivatives (R, ..., 2B, n) rad/m, with rho^2 kept above 1e-12 m^2 at the poles."""
        position, rotation = anchors.frames
        px, py, pz = in_frames(x[..., :3], position, rotation)
        rho2 = np.maximum(px * px + py * py, _RHO2_FLOOR)
        rho, r2 = np.sqrt(rho2), rho2 + pz * pz
        along = pz / (rho * r2)
        local = np.zeros((*px.shape, 2, 3))
        local[..., 0, 0], local[..., 0, 1] = -py / rho2, px / rho2
        local[..., 1, 0], local[..., 1, 1], local[..., 1, 2] = -px * along, -py * along, rho / r2
        return into_state(local @ rotations_for(x, rotation), x.shape[-1])

    def covariance(self, x: Array, anchors: Anchors, quality: Array) -> Array:
        """Nominal variances (R, ..., 2B) rad^2, independent of x."""
        return self.covariance_of(self.predict(x, anchors), per_step(quality, x))

    def covariance_of(self, expected: Array, quality: Array) -> Array:
        """Variances (R, ..., 2B) rad^2 at angles `expected` (R, ..., 2B) rad from `predict`."""
        return quality

    def loglik(self, x: Array, anchors: Anchors, y: Array, quality: Array) -> Array:
        """Log likelihood (R, ...) of independent normals of the wrapped residuals; NaN components
        are left out.
        """
        expected = self.predict(x, anchors)
        r = self.covariance_of(expected, per_step(quality, x))
        return over_measured(
            -0.5 * (self.residual(per_step(y, x), expected) ** 2 / r + np.log(2 * np.pi * r)), y, x
        )


@dataclass(frozen=True)
class AzElFitted(AzEl):
    """AE model with deviations fitted to the noise over uniform directions.

    The paper prints a pair for sigma = 10 deg: 18 and 10 deg with Model I, 21 and 10 deg with Model
    II; erratum N12.
    """

    fit: str = param(
        "printed",
        "printed: the paper's deviations if it prints them, else computed; own: computed",
        choices=("printed", "own"),
    )
    noise: Noise | None = param(None, "noise to which the deviations are fitted", kind=Noise)
    kernel = "azel"

    def __post_init__(self) -> None:
        super().__post_init__()
        _calibration_of(self.noise)

    def sigmas(self) -> tuple[float, float]:
        """Deviations (azimuth, elevation) in rad."""
        if self.sigma_deg is not None:
            return math.radians(self.sigma_deg), math.radians(self.sigma_deg)
        known = _calibration_of(self.noise)
        printed = known.printed_fit_deg
        if self.fit == "printed" and printed and math.isclose(known.sigma, math.radians(10)):
            return math.radians(printed[0]), math.radians(printed[1])
        return known.fitted()


def _calibration_of(noise: Noise | None) -> Calibration:
    """Return the calibration of a noise; raises BadValue if it has none."""
    found = noise.calibration if isinstance(noise, Noise) else None
    if found is None:
        raise BadValue("noise", type(noise).__name__, "an angular noise: ae_flip, ae_normal or vmf")
    return found


@lru_cache(maxsize=32)
def adaptive_table(sigma: float, about: str = "truth") -> tuple[Array, Array]:
    """Deviations (azimuth, elevation), each (181,) rad, of Model I at -90, -89 ... 90 degrees
    [Nurminen 2018, Fig. 1].

    `sigma` is the nominal deviation in rad. Both results are root mean square errors; about the
    "mean", that of the elevation is its standard deviation (the azimuth's mean error is 0).
    """
    grid = np.deg2rad(np.arange(-90.0, 91.0))
    bias, elevation = flipped_elevation_moments(grid, sigma)
    if about == "mean":
        elevation = np.sqrt(np.maximum(elevation**2 - bias**2, 0.0))
    return flipped_azimuth_std(grid, sigma), elevation


@dataclass(frozen=True)
class AzElAdaptive(AzEl):
    """AE model with Model I's deviations at the expected elevation.

    The deviations are looked up in a table with steps of one degree.
    """

    noise: Noise | None = param(
        None, "noise whose nominal deviation the table of Model I is computed for", kind=Noise
    )
    adaptive_about: str = param(
        "truth",
        "deviations about the truth (root mean square errors), or about the mean",
        choices=("truth", "mean"),
    )
    kernel = "azel_adaptive"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.nominal()

    def nominal(self) -> float:
        """The nominal deviation in rad of the table."""
        if self.sigma_deg is not None:
            return math.radians(self.sigma_deg)
        return float(_calibration_of(self.noise).sigma)

    def sigmas(self) -> tuple[float, float]:
        """Nominal deviations (azimuth, elevation) in rad; `covariance` replaces them."""
        return self.nominal(), self.nominal()

    def covariance_of(self, expected: Array, quality: Array) -> Array:
        """Variances (R, ..., 2B) rad^2 at the nearest degree of the expected elevations; a NaN
        elevation counts as 0.
        """
        index = np.rint(np.rad2deg(expected[..., 1::2]) + 90.0)
        index = np.nan_to_num(index, nan=90.0).astype(np.intp)
        return interleave(tuple(table[index] for table in self._variances()))

    def variances(self) -> Array:
        """Table (181, 2) rad^2 of the variances of azimuth and elevation at -90, -89 ... 90
        degrees.
        """
        return np.stack(self._variances(), axis=-1)

    def _variances(self) -> tuple[Array, Array]:
        return _adaptive_variances(self.nominal(), self.adaptive_about)


@lru_cache(maxsize=32)
def _adaptive_variances(sigma: float, about: str) -> tuple[Array, Array]:
    azimuth, elevation = adaptive_table(sigma, about)
    return azimuth**2, elevation**2
