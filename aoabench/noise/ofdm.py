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

from aoabench.maths.geometry import LIGHT, Array, in_frames, to_azel, wrap
from aoabench.noise.mounting import MountedNoise
from aoabench.params import param
from aoabench.roles import Scenario
from aoabench.types import Anchors, Measurements

PRINTED = ("gain",)  # errata that can be run as printed
NEAREST = 1.0  # m; the least distance of the path loss model


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
        return self.power_dbm - self.path_loss(distance) + shadowing + self.array_gain_db

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
        element = rss if "gain" in self.as_printed else rss - self.array_gain_db
        snr = 10.0 ** (0.1 * (element - self.noise_dbm))
        cosine = np.maximum(np.abs(np.cos(off_broadside)), self.cosine_floor)
        L = self.elements
        return np.sqrt(6.0 / (L * (L**2 - 1) * snr)) / (math.pi * cosine)

    def offers(self) -> frozenset[str]:
        """Elevations, times of arrival, signal strengths and all deviations."""
        return frozenset({"elevation", "delay", "rssi", "stated_sigma"})

    # --- one replication --------------------------------------------------------------------------

    def sample(self, rng: np.random.Generator, scenario: Scenario, truth: Array) -> Measurements:
        """Measurements (T, B) of true states (T, n); NaN if the AN does not hear the target."""
        anchors, points = scenario.true_anchors, truth[:, :3]
        shape = (len(points), anchors.count)
        heard = scenario.hears(points)
        step, b = np.nonzero(np.ones(shape, dtype=bool) if heard is None else heard)
        position, rotation = (
            np.broadcast_to(a[0], (*shape, *a.shape[3:]))[step, b][:, None]
            for a in (anchors.position, anchors.rotation)
        )
        local = (a[:, 0] for a in in_frames(points[step], position, rotation))
        x, y, z = local
        distance = np.sqrt(x * x + y * y + z * z)
        azimuth, elevation = to_azel(x, y, z)
        rss = self.rss(distance, self.shadowing(rng, points)[step])
        sigma = [self.angle_sigma(rss, azimuth), self.angle_sigma(rss, elevation)]
        clock = 1e-9 * self.clock_ns
        sigma.append(np.hypot(self.delay_sigma(rss), clock))
        e = rng.standard_normal((3, len(step)))
        values = {
            "azimuth": wrap(azimuth + sigma[0] * e[0]), "elevation": elevation + sigma[1] * e[1],
            "delay": distance / LIGHT + sigma[2] * e[2], "rssi": rss,
            "azimuth_sigma": sigma[0], "elevation_sigma": sigma[1], "delay_sigma": sigma[2],
        }  # fmt: skip
        dense = {}
        for name, value in values.items():
            dense[name] = np.full(shape, np.nan)
            dense[name][step, b] = value
        return Measurements(**dense)

    def shadowing(self, rng: np.random.Generator, points: Array) -> Array:
        """Shadow fading (T,) dB at positions (T, 3) m: normal, with correlation exp(-distance /
        shadowing_m) from step to step.
        """
        e = rng.standard_normal(len(points))
        if self.shadowing_m > 0:
            apart = np.linalg.norm(np.diff(points, axis=0), axis=1)
            keep = np.exp(-apart / self.shadowing_m)
            fresh = np.sqrt(1.0 - keep**2)
            for k in range(1, len(e)):
                e[k] = keep[k - 1] * e[k - 1] + fresh[k - 1] * e[k]
        return self.shadowing_db * e

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
