"""Angular noise: normal azimuth and elevation, the same flipped over the poles (Model I), von
Mises-Fisher (Model II).

Each class returns its own deviations for the AE filters: `sigma` (nominal) and `fitted()` (over
uniform directions).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from aoabench import bounds
from aoabench.errors import BadValue
from aoabench.maths.directional import (
    flip,
    flipped_azimuth_std,
    flipped_elevation_moments,
    sigma_from_kappa,
    vmf_turned,
)
from aoabench.maths.geometry import Array, to_azel, to_unit, wrap
from aoabench.maths.places import at_anchors
from aoabench.noise.links import links_of, shared
from aoabench.noise.mounting import MountedNoise
from aoabench.params import param
from aoabench.roles import Scenario
from aoabench.types import Anchors, Calibration, Measurements


@dataclass(frozen=True)
class _Angular(MountedNoise):
    """Angular noise with a nominal deviation sigma or a concentration kappa = 1 / sigma^2.

    Each is derived from the other [Nurminen 2018, (7)]. Raises BadValue if both are given.
    """

    sigma_deg: float | None = param(
        None, "nominal standard deviation", unit="deg", above=0, least=1e-5, most=180
    )
    kappa: float | None = param(
        None,
        "nominal concentration, instead of sigma_deg: sigma = 1 / sqrt(kappa) rad",
        above=0,
        least=1e-6,
        most=1e12,
    )
    default_sigma_deg: float = param(
        10.0,
        "nominal standard deviation if neither sigma_deg nor kappa is given",
        unit="deg",
        above=0,
        least=1e-5,
        most=180,
    )
    # fitted (azimuth, elevation) at sigma = 10 deg, if a paper prints them
    printed_fit_deg: ClassVar[tuple[float, float] | None] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sigma_deg is not None and self.kappa is not None:
            raise BadValue(
                "kappa",
                self.kappa,
                f"null, because sigma_deg={self.sigma_deg:g} is given; or set sigma_deg=null",
            )

    @property
    def sigma(self) -> float:
        """Nominal standard deviation in rad."""
        if self.kappa is not None:
            return float(sigma_from_kappa(self.kappa))
        return math.radians(self.default_sigma_deg if self.sigma_deg is None else self.sigma_deg)

    @property
    def concentration(self) -> float:
        """Nominal concentration kappa = 1 / sigma^2."""
        return 1.0 / self.sigma**2 if self.kappa is None else float(self.kappa)

    def draws(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """The random numbers (2, *shape) of measurements (*shape)."""
        return rng.standard_normal((2, *shape))

    def perturbed(self, e: Array, azimuth: Array, elevation: Array) -> tuple[Array, Array]:
        """Noisy azimuth and elevation (...) rad from random numbers e (2, ...) and true azimuth and
        elevation (...) rad.
        """
        raise NotImplementedError

    def perturb(
        self, rng: np.random.Generator, azimuth: Array, elevation: Array
    ) -> tuple[Array, Array]:
        """Noisy azimuth and elevation (...) rad from true azimuth and elevation (...) rad."""
        return self.perturbed(self.draws(rng, azimuth.shape), azimuth, elevation)

    def sample(self, rng: np.random.Generator, scenario: Scenario, truth: Array) -> Measurements:
        """Measurements (T, B) of true states (T, n), seen from the scenario's anchors."""
        tile, count = self.sample_tile([rng], scenario, truth[None]), scenario.true_anchors.count
        numbers, arrays = tile.anchor_id, tile.arrays
        if numbers is not None:
            arrays = {name: at_anchors(a, numbers, count) for name, a in arrays.items()}
        return Measurements(**{name: array[0] for name, array in arrays.items()})

    def sample_tile(
        self, rngs: Sequence[np.random.Generator], scenario: Scenario, truth: Array
    ) -> Measurements:
        """Measurements (R, T, K) of true states (R, T, n), seen from the anchors that measure."""
        shape, count = truth.shape[:2], scenario.true_anchors.count
        links = links_of(scenario, shared(truth[..., :3]))
        every, free = links.numbers.shape[2] == count, links.numbers < 0
        e = np.empty((2, *shape, links.numbers.shape[2]))
        for i, rng in enumerate(rngs):
            drawn = self.draws(rng, (shape[1], count))
            own = links.numbers[i if len(links.numbers) > 1 else 0]
            e[:, i] = drawn if every else np.take_along_axis(drawn, np.maximum(own, 0)[None], 2)
        azimuth, elevation = self.perturbed(e, links.azimuth, links.elevation)
        quality = np.full(azimuth.shape, self.sigma)
        if free.any():
            azimuth, elevation = (np.where(free, np.nan, a) for a in (azimuth, elevation))
            quality = quality if every else np.where(free, np.nan, quality)
        return Measurements(
            azimuth,
            elevation,
            azimuth_sigma=quality,
            elevation_sigma=quality,
            anchor_id=None if every else links.numbers,
        )

    @property
    def calibration(self) -> Calibration:
        """The nominal and the fitted deviations."""
        return Calibration(self.sigma, self.fitted, self.printed_fit_deg)

    def offers(self) -> frozenset[str]:
        """Elevations, and the deviations of both angles."""
        return frozenset({"elevation", "stated_sigma"})

    def fitted(self) -> tuple[float, float]:
        """Root mean square residuals (azimuth, elevation) in rad over uniformly distributed
        directions.

        These are the maximum-likelihood deviations of the AE model [Nurminen 2018, IV-A], computed
        by quadrature.
        """
        return _fitted(self)

    def residual_rms(self, elevation: Array) -> tuple[Array, Array]:
        """Root mean square residuals (azimuth, elevation), each (N,) rad, at true elevations (N,)
        rad.
        """
        raise NotImplementedError

    def information(self, point: Array, anchors: Anchors) -> Array:
        """Fisher information (..., 3, 3) 1/m^2 of one set of measurements at points (..., 3) m.

        The angles are taken as independent normals. Wrapping and flipping are neglected, which is
        valid if sigma is small compared with pi and with the angle to the pole.
        """
        return bounds.azel_information(point, anchors, self.sigma, self.sigma)


@lru_cache(maxsize=64)
def _fitted(noise: _Angular) -> tuple[float, float]:
    # uniform directions have density cos(elevation); near the pole the residuals change on the
    # scale of sigma, so the panels of the quadrature end at 0, 1, 2 ... sigma from the pole
    edges = np.pi / 2 - noise.sigma * np.array([0.0, 0.5, 1, 1.5, 2, 3, 4, 5, 6, 8, 10, 14])
    edges = np.concatenate([[0.0], edges[edges > 0][::-1]])
    node, weight = np.polynomial.legendre.leggauss(24)
    half = 0.5 * np.diff(edges)[:, None]
    elevation = (edges[:-1, None] + half * (node + 1)).ravel()
    share = (half * weight).ravel() * np.cos(elevation)
    azimuth_rms, elevation_rms = noise.residual_rms(elevation)
    return float(np.sqrt(share @ azimuth_rms**2)), float(np.sqrt(share @ elevation_rms**2))


@dataclass(frozen=True)
class NormalAngles(_Angular):
    """Independent normal errors of azimuth (wrapped) and elevation (not flipped) [Nurminen 2018,
    (4)].
    """

    def perturbed(self, e: Array, azimuth: Array, elevation: Array) -> tuple[Array, Array]:
        e = self.sigma * e
        return wrap(azimuth + e[0]), elevation + e[1]

    def residual_rms(self, elevation: Array) -> tuple[Array, Array]:
        straight = flipped_azimuth_std(np.zeros_like(elevation), self.sigma, 1e-9)
        return straight, np.full(elevation.shape, self.sigma)


@dataclass(frozen=True)
class FlippedAngles(_Angular):
    """Model I: normal errors of azimuth and elevation, flipped over the poles so that each
    direction has one representation.
    """

    printed_fit_deg: ClassVar = (18.0, 10.0)  # [Nurminen 2018, Table I]

    def perturbed(self, e: Array, azimuth: Array, elevation: Array) -> tuple[Array, Array]:
        e = self.sigma * e
        return flip(azimuth + e[0], elevation + e[1])

    def residual_rms(self, elevation: Array) -> tuple[Array, Array]:
        return flipped_azimuth_std(elevation, self.sigma), flipped_elevation_moments(
            elevation, self.sigma
        )[1]


@dataclass(frozen=True)
class VonMisesFisher(_Angular):
    """Model II: the measured direction is von Mises-Fisher around the true one [Nurminen 2018,
    (5)].
    """

    printed_fit_deg: ClassVar = (21.0, 10.0)  # samples give other deviations: erratum N12

    def draws(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        return rng.random((2, *shape))

    def perturbed(self, e: Array, azimuth: Array, elevation: Array) -> tuple[Array, Array]:
        u = vmf_turned(e, to_unit(azimuth, elevation), self.concentration)
        return to_azel(u[..., 0], u[..., 1], u[..., 2])

    def information(self, point: Array, anchors: Anchors) -> Array:
        return bounds.direction_information(point, anchors, self.concentration)

    def residual_rms(self, elevation: Array) -> tuple[Array, Array]:
        return _vmf_residual_rms(self.concentration, tuple(np.asarray(elevation).tolist()))


def _vmf_residual_rms(kappa: float, elevation: tuple[float, ...]) -> tuple[Array, Array]:
    """Root mean square residuals (azimuth, elevation), each (N,) rad, at elevations (N,) rad.

    Quadrature over the angle from the mean direction (by its distribution function) and the
    rotation about the mean direction.
    """
    v, wv = np.polynomial.legendre.leggauss(200)
    v, wv = 0.5 * (v + 1.0), 0.5 * wv
    one_minus_cos = np.clip(-np.log1p(v * np.expm1(-2.0 * kappa)) / kappa, 0.0, 2.0)[:, None]
    sine = np.sqrt(one_minus_cos * (2.0 - one_minus_cos))
    turn = (np.arange(400) + 0.5) * 2 * np.pi / 400
    rms = np.empty((2, len(elevation)))
    for i, b in enumerate(elevation):
        # frame: mean (cos b, 0, sin b), tangents north (-sin b, 0, cos b) and east (0, 1, 0)
        north, east, ahead = sine * np.cos(turn), sine * np.sin(turn), 1.0 - one_minus_cos
        azimuth, up = to_azel(
            ahead * np.cos(b) - north * np.sin(b), east, ahead * np.sin(b) + north * np.cos(b)
        )
        rms[:, i] = [np.sqrt(wv @ np.mean(f**2, axis=1)) for f in (azimuth, up - b)]
    return rms[0], rms[1]
