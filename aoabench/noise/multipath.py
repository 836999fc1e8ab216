"""Angles and signal strengths of a Bluetooth room with multipath: a campaign's channel, then its
packets.

No published recording shows the causes of the errors of [Boquet 2024, 6.3]. This model has one
parameter in YAML for each effect described in that section. The effects act in this order on the
true direction from an anchor:

- wall images: a share of the packets of a day is `disturbed`, for all anchors at once; each
  direction is then pulled towards the node's mirror image in one of the room's walls, by an
  exponential fraction. The wall and the strength vary over the floor with the correlation length,
  independently for each anchor;
- a systematic elevation error: directions far from the anchor's pole are measured too steep;
- a bias field over the floor for each anchor and angle, Gaussian with a squared-exponential
  correlation;
- an offset for each anchor, angle and day;
- noise, whose azimuth part grows towards the pole as with a planar array, and Laplace outliers.

A replication is one campaign: fields and offsets are drawn once per replication.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from aoabench.maths.directional import flip
from aoabench.maths.geometry import Array, to_azel
from aoabench.noise.links import shared
from aoabench.noise.mounting import MountedNoise
from aoabench.params import param
from aoabench.roles import Scenario
from aoabench.types import Measurements

_WAVES = 32  # number of plane waves in the sum of a field


def _angle(default: float, help: str) -> Any:
    return param(default, help, unit="deg", least=0, most=180)


def _each_anchor(default: tuple[float, ...], help: str) -> Any:
    allowed = "a list of numbers >= 0, one for each anchor"
    return param(default, help, shape=(None,), least=0, allowed=allowed)


class _Channel(NamedTuple):
    """Draws of one campaign over P points, B anchors and D days."""

    bias: Array  # (P, B, 2) rad, of azimuth and elevation
    walls: Array  # (P, B, 4): the wall with the largest value gives the image
    shade: Array  # (P, B), shadowing in units of its deviation
    force: Array  # (P, B), logarithm of the pull in units of its deviation
    offset: Array  # (D, B, 2) rad, of azimuth and elevation


@dataclass(frozen=True)
class BleMultipath(MountedNoise):
    """Angles and signal strengths of a Bluetooth room with multipath.

    Anchors and days beyond the end of a list take its last number.
    """

    azimuth_noise_deg: float = param(
        3.0,
        "standard deviation of the azimuth's normal noise, which is divided by the cosine of the "
        "elevation",
        unit="deg",
        above=0,
    )
    elevation_noise_deg: float = param(
        3.0, "standard deviation of the elevation's normal noise", unit="deg", above=0
    )
    pole_floor: float = param(
        0.3, "lower limit of the cosine that divides the azimuth's noise", least=0, most=1
    )
    steep_deg: float = _angle(
        12.0, "error of an elevation at the horizon, which is measured too steep"
    )
    steep_power: float = param(
        2.0, "power of (angle from the pole / 90 deg), a factor on that error", least=0
    )
    azimuth_bias_deg: float = _angle(
        5.0, "standard deviation over the floor of each anchor's azimuth bias"
    )
    elevation_bias_deg: float = _angle(
        5.0, "standard deviation over the floor of each anchor's elevation bias"
    )
    correlation_m: float = param(
        1.5, "correlation length of all fields over the floor", unit="m", above=0
    )
    bias_scale: Sequence[float] = _each_anchor((1.0,), "factor on the bias fields of each anchor")
    azimuth_day_deg: float = _angle(
        1.0, "standard deviation of each anchor's azimuth offset of a day"
    )
    elevation_day_deg: float = _angle(
        1.0, "standard deviation of each anchor's elevation offset of a day"
    )
    disturbed: Sequence[float] = param(
        (0.3, 0.1),
        "share of each day's packets that are disturbed, at all anchors at once",
        shape=(None,),
        least=0,
        most=1,
        allowed="a list of shares from 0 to 1, one for each day",
    )
    pull: Sequence[float] = _each_anchor(
        (0.3,),
        "strength s of each anchor's wall images: a direction is pulled to its image by the "
        "fraction 1 - exp(-s e), e exponential with mean 1",
    )
    pull_spread: float = param(
        1.0, "standard deviation over the floor of ln s, whose mean is ln(pull)", least=0
    )
    outliers: float = param(
        0.02, "share of measurements with an additional Laplace error", least=0, most=1
    )
    outlier_deg: float = param(20.0, "scale of the Laplace errors", unit="deg", least=0)
    lost: float = param(0.0334, "share of measurements that are lost", least=0, most=1)
    rssi_1m_dbm: float = param(-45.0, "signal strength at 1 m", unit="dBm")
    rssi_exponent: float = param(2.0, "path loss exponent", least=0)
    shadowing_db: float = param(
        4.0,
        "standard deviation over the floor of each anchor's shadowing",
        unit="dB",
        least=0,
        most=100,
    )
    fading_db: float = param(
        4.0, "standard deviation of the signal strength from packet to packet", unit="dB", least=0
    )

    def offers(self) -> frozenset[str]:
        """Elevations, signal strengths and the deviations of the angles."""
        return frozenset({"elevation", "rssi", "stated_sigma"})

    def sample(self, rng: np.random.Generator, scenario: Scenario, truth: Array) -> Measurements:
        """Azimuth, elevation (T, B) rad and rssi (T, B) dBm of true states (T, n).

        The scenario's `day_of` gives the day of each step. Days beyond the list `disturbed`, and
        anchors beyond the lists `bias_scale` and `pull`, take the last number.
        """
        return self._sampled(rng, scenario, truth, *_places(truth))

    def sample_tile(
        self, rngs: Sequence[np.random.Generator], scenario: Scenario, truth: Array
    ) -> Measurements:
        """Measurements (R, T, B) of true states (R, T, n)."""
        if len(shared(truth[..., :3])) > 1:
            return super().sample_tile(rngs, scenario, truth)
        places = _places(truth[0])
        each = [self._sampled(rng, scenario, truth[0], *places) for rng in rngs]
        return Measurements.stacked(each)

    def _sampled(
        self,
        rng: np.random.Generator,
        scenario: Scenario,
        truth: Array,
        point: Array,
        seat: np.ndarray,
    ) -> Measurements:
        """`sample` of true states (T, n) at points (P, 3) m, `seat` (T,) being their indices."""
        day = scenario.day_of(len(truth))
        T, B = len(truth), scenario.true_anchors.count
        # the draws do not depend on the parameters, so that runs with other parameters are paired
        channel = self._channel(rng, point, B, int(day.max()) + 1)
        hit = rng.random(T) < _each(self.disturbed, len(channel.offset))[day]
        spread = np.exp(self.pull_spread * channel.force)[seat]
        strength = _each(self.pull, B) * spread * rng.exponential(size=(T, B))
        fraction = np.where(hit[:, None], 1.0 - np.exp(-strength), 0.0)
        noise, laplace = rng.standard_normal((2, T, B)), rng.laplace(size=(2, T, B))
        outlier, lost = rng.random((T, B)) < self.outliers, rng.random((T, B)) < self.lost
        fading = rng.standard_normal((T, B))
        heard = scenario.hears(truth[:, :3])
        lost |= False if heard is None else ~heard

        distance, to_node, to_image = self._directions(scenario, point, channel.walls)
        v = (1 - fraction)[..., None] * to_node[seat] + fraction[..., None] * to_image[seat]
        azimuth, elevation = to_azel(v[..., 0], v[..., 1], v[..., 2])
        flat = 1.0 - np.abs(elevation) / (np.pi / 2)
        steeper = np.deg2rad(self.steep_deg) * flat**self.steep_power
        elevation = elevation + np.copysign(steeper, elevation)
        e = channel.bias[seat] + channel.offset[day]
        wide = np.maximum(np.cos(elevation), self.pole_floor)
        azimuth = azimuth + e[..., 0] + np.deg2rad(self.azimuth_noise_deg) / wide * noise[0]
        elevation = elevation + e[..., 1] + np.deg2rad(self.elevation_noise_deg) * noise[1]
        scale = np.deg2rad(self.outlier_deg)
        more = [np.where(outlier, scale * one, 0.0) for one in laplace]
        azimuth, elevation = flip(azimuth + more[0], elevation + more[1])
        rssi = self.rssi_1m_dbm - 10 * self.rssi_exponent * np.log10(np.maximum(distance, 0.01))
        rssi = (rssi + self.shadowing_db * channel.shade)[seat] + self.fading_db * fading
        deviations = np.deg2rad([self.azimuth_noise_deg, self.elevation_noise_deg])
        stated = [np.full((T, B), deviation) for deviation in deviations]
        azimuth, elevation, rssi = (np.where(lost, np.nan, y) for y in (azimuth, elevation, rssi))
        return Measurements(azimuth, elevation, None, rssi, *stated)

    def _channel(self, rng: np.random.Generator, point: Array, B: int, days: int) -> _Channel:
        """The channel of one campaign over points (P, 3) m."""
        bias = np.deg2rad([self.azimuth_bias_deg, self.elevation_bias_deg])
        bias = bias * self._fields(rng, point, (B, 2))
        bias = bias * _each(self.bias_scale, B)[:, None]
        walls = self._fields(rng, point, (B, 4))
        shade, force = np.moveaxis(self._fields(rng, point, (B, 2)), -1, 0)
        offset = np.deg2rad([self.azimuth_day_deg, self.elevation_day_deg])
        return _Channel(bias, walls, shade, force, offset * rng.standard_normal((days, B, 2)))

    def _directions(
        self, scenario: Scenario, point: Array, walls: Array
    ) -> tuple[Array, Array, Array]:
        """Distances (P, B) m of points (P, 3) m from the anchors, and unit vectors (P, B, 3) in
        their frames to the points and to their mirror images.
        """
        position, rotation = (a[0] for a in scenario.true_anchors.frames)
        seen = [x - position for x in (point[:, None], self._images(scenario, point, walls))]
        lengths = [np.linalg.norm(v, axis=-1, keepdims=True) for v in seen]
        node, image = (
            np.einsum("bij,pbj->pbi", rotation, v / np.maximum(length, 1e-9))
            for v, length in zip(seen, lengths)
        )
        return lengths[0][..., 0], node, image

    def _fields(self, rng: np.random.Generator, point: Array, shape: tuple[int, int]) -> Array:
        """Gaussian fields (P, *shape) of variance 1 at points (P, 3) m, correlated over the floor,
        as sums of plane waves.
        """
        wave = rng.standard_normal((*shape, 2, _WAVES)) / self.correlation_m
        phase = rng.uniform(0, 2 * np.pi, (*shape, 1, _WAVES))
        return np.sqrt(2 / _WAVES) * np.cos(point[:, None, None, None, :2] @ wave + phase).sum(
            axis=(-2, -1)
        )

    def _images(self, scenario: Scenario, point: Array, walls: Array) -> Array:
        """Mirror images (P, B, 3) m of points (P, 3) m, each in the wall whose field (P, B, 4) is
        the largest.

        The walls are the sides of the scenario's `bounds_m`, or of the box around its points and
        anchors.
        """
        everything = np.concatenate([point[:, :2], scenario.true_anchors.frames[0][0, :, :2]])
        box = (everything.min(axis=0), everything.max(axis=0))
        low, high = box if scenario.bounds_m is None else np.asarray(scenario.bounds_m)
        mirror = np.broadcast_to(point[:, None, None], (*walls.shape, 3)).copy()
        for i, (axis, side) in enumerate(((0, low[0]), (0, high[0]), (1, low[1]), (1, high[1]))):
            mirror[:, :, i, axis] = 2 * side - mirror[:, :, i, axis]
        return np.take_along_axis(mirror, walls.argmax(axis=-1)[..., None, None], axis=2)[:, :, 0]


def _places(truth: Array) -> tuple[Array, np.ndarray]:
    """The different points (P, 3) m of true states (T, n), and the index (T,) of each state's."""
    point, seat = np.unique(truth[:, :3], axis=0, return_inverse=True)
    return point, seat.ravel()


def _each(values: Sequence[float], count: int) -> Array:
    """The values (count,) of days or anchors; beyond the list its last value."""
    return np.array([values[min(i, len(values) - 1)] for i in range(count)])
