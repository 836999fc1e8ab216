"""Time and angles of arrival of OFDM pilots at antenna arrays, at their Cramér-Rao bounds [Lu 2019,
II].

    RSS [dBm]    P_T - PL(d) + S + G_R                                                (1)
                 PL = 32.4 + 17.3 log10(d / m) + 20 log10(f_c / GHz)                  InH LoS
    time         sigma^2 = 3 P_n / (8 pi^2 f_sc^2 P_r M (M + 1) (2 M + 1))            (4)
                 M = (N_u - 1) / 2
    angle        sigma^2 = 6 P_n / (L (L^2 - 1) P_e (pi cos a)^2)                     (8)

with P_r the received power after beamforming and P_e = P_r / G_R the power at one element, because
(8) already contains the array's gain (erratum U6). The angle a off broadside is the azimuth in the
azimuth's deviation and the elevation in the elevation's deviation (U5).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aoabench.maths.geometry import LIGHT, Array, wrap
from aoabench.maths.places import at_anchors
from aoabench.noise.links import Links, links_of, shared
from aoabench.noise.mounting import MountedNoise
from aoabench.params import param
from aoabench.roles import Scenario
from aoabench.types import Anchors, Measurements

PRINTED = ("gain",)  # errata that can be run as printed
NEAREST = 1.0  # m; the least distance of the path loss model


_AT_ONCE = 1 << 15  # measurements whose arrays stay in the cache
_MEASURED = (
    "azimuth", "elevation", "delay", "rssi", "azimuth_sigma", "elevation_sigma", "delay_sigma",
)  # fmt: skip


def _level(default: float, help: str, unit: str) -> Any:
    return param(default, help, unit=unit, least=-300, most=300)


def _length(default: float, help: str) -> Any:
    return param(default, help, unit="m", least=0, most=1e6)


@dataclass(frozen=True)
class OfdmCrlb(MountedNoise):
    """Measurements of a robot's pilots by access nodes (ANs) with errors of their known positions.

    An AN's frame has its array's broadside as x and up as z. Errors of the known positions are
    drawn once per replication.
    """

    carrier_ghz: float = param(39.0, "carrier frequency", unit="GHz", above=0, most=1e6)
    subcarrier_khz: float = param(120.0, "subcarrier spacing", unit="kHz", above=0, most=1e6)
    subcarriers: int = param(1024, "number of subcarriers", least=2, most=10_000_000)
    power_dbm: float = _level(27.0, "transmitted power", "dBm")
    array_gain_db: float = _level(20.0, "gain of receive beamforming", "dB")
    elements: int = param(10, "antenna elements along one side of the array", least=2, most=100_000)
    noise_dbm: float = _level(-84.0, "noise power over the bandwidth", "dBm")
    shadowing_db: float = param(
        3.0, "standard deviation of the shadowing", unit="dB", least=0, most=100
    )
    shadowing_m: float = _length(
        10.0, "correlation distance of the shadowing; 0: independent from step to step"
    )
    cosine_floor: float = param(
        0.02,
        "least cosine of the angle off broadside: the angles' bound is infinite along the array",
        above=0,
        most=1,
    )
    clock_ns: float = param(
        10.0,
        "standard deviation of each time of arrival due to the clocks",
        unit="ns",
        least=0,
        most=1e9,
    )
    an_sigma_m: float = _length(0.0, "standard deviation of an AN's known position in x and in y")
    an_beta: float = param(
        10.0, "an_sigma_m divided by the standard deviation in z", above=0, most=1e6
    )
    an_error: str = param(
        "independent",
        "errors of the known positions: independent for each AN, or one common to all",
        choices=("independent", "common"),
    )
    as_printed: Sequence[str] = param(
        (),
        "errata to run as printed: gain: (8) takes the beamforming gain a second time",
        choices=PRINTED,
    )

    # --- the link ---------------------------------------------------------------------------------

    def path_loss(self, distance: Array) -> Array:
        """Path loss (...) dB over distances (...) m: 3GPP indoor hotspot, line of sight [TR 38.900,
        table 7.4.1-1].
        """
        d = np.maximum(distance, NEAREST)
        return 32.4 + 17.3 * np.log10(d) + 20.0 * math.log10(self.carrier_ghz)

    def rss(self, distance: Array, shadowing: Array | float = 0.0) -> Array:
        """Received power (...) dBm after beamforming [(1)]."""
        return self.power(distance) + shadowing + self.array_gain_db

    def power(self, distance: Array) -> Array:
        """Received power (...) dBm at one antenna element without shadowing."""
        return self.power_dbm - self.path_loss(distance)

    def delay_sigma(self, rss: Array) -> Array:
        """Deviation (...) s of the time of arrival due to noise alone [(4)]."""
        M = 0.5 * (self.subcarriers - 1)
        snr = 10.0 ** (0.1 * (rss - self.noise_dbm))
        width = 8.0 * math.pi**2 * (1e3 * self.subcarrier_khz) ** 2 * M * (M + 1) * (2 * M + 1)
        return np.sqrt(3.0 / (width * snr))

    def angle_sigma(self, rss: Array, off_broadside: Array) -> Array:
        """Deviation (...) rad of an angle off broadside (...) rad [(8)]; its cosine is kept above
        `cosine_floor`.
        """
        return self.spread(rss) / self.aperture(off_broadside)

    def spread(self, rss: Array) -> Array:
        """Deviation (...) rad of the phase from element to element [(8)]."""
        element = rss if "gain" in self.as_printed else rss - self.array_gain_db
        snr = 10.0 ** (0.1 * (element - self.noise_dbm))
        L = self.elements
        return np.sqrt(6.0 / (L * (L**2 - 1) * snr))

    def aperture(self, off_broadside: Array) -> Array:
        """Change (...) of that phase per rad of an angle off broadside (...) rad."""
        return math.pi * np.maximum(np.abs(np.cos(off_broadside)), self.cosine_floor)

    def offers(self) -> frozenset[str]:
        """Elevations, times of arrival, signal strengths and all deviations."""
        return frozenset({"elevation", "delay", "rssi", "stated_sigma"})

    # --- measurements -----------------------------------------------------------------------------

    def sample(self, rng: np.random.Generator, scenario: Scenario, truth: Array) -> Measurements:
        """Measurements (T, B) of true states (T, n); NaN if the AN does not hear the target."""
        points, count = truth[None, :, :3], scenario.true_anchors.count
        links = links_of(scenario, points)
        found = self._measured([rng], links, points).items()
        return Measurements(**{n: at_anchors(a, links.numbers, count)[0] for n, a in found})

    def sample_tile(
        self, rngs: Sequence[np.random.Generator], scenario: Scenario, truth: Array
    ) -> Measurements:
        """Measurements (R, T, K) of the ANs that hear the target at true states (R, T, n)."""
        points = shared(truth[..., :3])
        links = links_of(scenario, points)
        every = links.numbers.shape[2] == scenario.true_anchors.count
        found = self._measured(rngs, links, points)
        return Measurements(**found, anchor_id=None if every else links.numbers)

    def _measured(
        self, rngs: Sequence[np.random.Generator], links: Links, points: Array
    ) -> dict[str, Array]:
        """The measured arrays (R, T, K) over `links` at points (R|1, T, 3) m."""
        shape = (len(rngs), *links.numbers.shape[1:])
        found = {name: np.empty(shape) for name in _MEASURED}
        given = (
            self._fading(rngs, points)[..., None], self.power(links.distance),
            links.azimuth, links.elevation, links.distance / LIGHT,
            self.aperture(links.azimuth), self.aperture(links.elevation),
        )  # fmt: skip
        some = max(_AT_ONCE // math.prod(shape[1:]), 1)
        for first in range(0, len(rngs), some):
            of = slice(first, first + some)
            e = links.normals(rngs[of], first)
            values = self._perturbed(e, *(a if len(a) == 1 else a[of] for a in given))
            for array, value in zip(found.values(), values):
                array[of] = value
        if (free := links.numbers < 0).any():
            for array in found.values():
                array[np.broadcast_to(free, shape)] = np.nan
        return found

    def _perturbed(self, e: Array, fading: Array, power: Array, *true: Array) -> tuple[Array, ...]:
        """The measured values (R, T, K) of `_MEASURED`, from normal numbers e (3, R, T, K), shadow
        fading dB, power dBm, the true angles rad and delay s, and the angles' apertures.
        """
        azimuth, elevation, delay, *apertures = true
        rss = power + fading + self.array_gain_db
        spread = self.spread(rss)
        azimuth_sigma, elevation_sigma = (spread / aperture for aperture in apertures)
        delay_sigma = np.hypot(self.delay_sigma(rss), 1e-9 * self.clock_ns)
        return (
            wrap(azimuth + azimuth_sigma * e[0]),
            elevation + elevation_sigma * e[1],
            delay + delay_sigma * e[2],
            rss,
            azimuth_sigma,
            elevation_sigma,
            delay_sigma,
        )

    def shadowing(self, rng: np.random.Generator, points: Array) -> Array:
        """Shadow fading (T,) dB at positions (T, 3) m: normal, with correlation exp(-distance /
        shadowing_m) from step to step.
        """
        found: Array = self._fading([rng], points[None])[0]
        return found

    def _fading(self, rngs: Sequence[np.random.Generator], points: Array) -> Array:
        """The shadow fading (R, T) dB of replications at positions (R|1, T, 3) m."""
        e = np.stack([rng.standard_normal(points.shape[1]) for rng in rngs], axis=1)  # (T, R)
        if self.shadowing_m > 0:
            apart = np.linalg.norm(np.diff(points, axis=1), axis=2).T
            keep = np.exp(-apart / self.shadowing_m)
            e[1:] *= np.sqrt(1.0 - keep**2)
            kept, before = np.empty(len(rngs)), e[0]
            for share, now in zip(keep, e[1:]):
                now += np.multiply(share, before, out=kept)
                before = now
        return self.shadowing_db * e.T

    def known_anchors(self, rng: np.random.Generator, scenario: Scenario) -> Anchors:
        """The ANs (1, 1, B, ...) as known to the filters: the true ANs with this replication's
        errors [(9), (10)].
        """
        true = scenario.true_anchors
        deviation = self.an_sigma_m * np.array([1.0, 1.0, 1.0 / self.an_beta])
        shape = (1, true.count, 3) if self.an_error == "independent" else (1, 1, 3)
        error = deviation * rng.standard_normal(shape)
        known = replace(
            true,
            position=true.position + error,
            position_sigma=np.broadcast_to(deviation, true.position.shape),
        )
        return self.mounted(rng, known)
