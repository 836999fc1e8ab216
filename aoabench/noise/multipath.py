"""Angles and signal strengths of a Bluetooth room with multipath: a campaign's channel, then its
packets.

No published recording tells what made the errors of [Boquet 2024, 6.3]; this is a model with as
many parameters as that section has symptoms, each in YAML. In the order in which they act on the
true direction from an anchor:

- wall images: a share of the packets of a day finds the channel `disturbed`, for all anchors at
  once; each direction is then pulled towards that of the node's mirror image in one of the room's
  walls, by an exponential fraction. Which wall, and how strongly, varies over the floor with the
  correlation length, for each anchor in its own way;
- a systematic elevation error: directions far from the anchor's pole come out too steep;
- a bias field over the floor for each anchor and angle, Gaussian with a squared-exponential
  correlation;
- an offset for each anchor, angle and day;
- noise, whose azimuth part grows towards the pole, as that of a planar array does; and Laplace
  outliers.

Channel means: fields and offsets are drawn once for a replication, a campaign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from aoabench.errors import BadValue, check_array, check_number
from aoabench.maths.directional import flip
from aoabench.maths.geometry import Array, to_azel
from aoabench.noise.mounting import MountedNoise
from aoabench.roles import Scenario
from aoabench.types import Measurements

_WAVES = 32  # plane waves that make up a field


class _Channel(NamedTuple):
    """What is drawn once for a campaign over P points, B anchors and D days."""

    bias: Array  # (P, B, 2) rad, of azimuth and elevation
    walls: Array  # (P, B, 4): the largest says which wall mirrors
    shade: Array  # (P, B), shadowing in units of its deviation
    force: Array  # (P, B), logarithm of the pull in units of its spread
    offset: Array  # (D, B, 2) rad, of azimuth and elevation


@dataclass(frozen=True)
class BleMultipath(MountedNoise):
    """What each parameter means stands beside it in configs/noise/ble_multipath.yaml; angles in
    deg, lengths in m.
    """

    azimuth_noise_deg: float = 3.0
    elevation_noise_deg: float = 3.0
    pole_floor: float = 0.3
    steep_deg: float = 12.0
    steep_power: float = 2.0
    azimuth_bias_deg: float = 5.0
    elevation_bias_deg: float = 5.0
    correlation_m: float = 1.5
    bias_scale: Sequence[float] = (1.0,)
    azimuth_day_deg: float = 1.0
    elevation_day_deg: float = 1.0
    disturbed: Sequence[float] = (0.3, 0.1)
    pull: Sequence[float] = (0.3,)
    pull_spread: float = 1.0
    outliers: float = 0.02
    outlier_deg: float = 20.0
    lost: float = 0.0334
    rssi_1m_dbm: float = -45.0
    rssi_exponent: float = 2.0
    shadowing_db: float = 4.0
    fading_db: float = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("azimuth_noise_deg", "elevation_noise_deg", "correlation_m"):
            check_number(key, getattr(self, key), above=0)
        for key in (
            "steep_deg",
            "azimuth_bias_deg",
            "elevation_bias_deg",
            "azimuth_day_deg",
            "elevation_day_deg",
        ):
            check_number(key, getattr(self, key), least=0, most=180)
        for key in (
            "steep_power",
            "pull_spread",
            "outlier_deg",
            "rssi_exponent",
            "shadowing_db",
            "fading_db",
        ):
            check_number(key, getattr(self, key), least=0)
        for key in ("outliers", "lost", "pole_floor"):
            check_number(key, getattr(self, key), least=0, most=1)
        check_number("rssi_1m_dbm", self.rssi_1m_dbm)
        for key in ("bias_scale", "pull"):
            if not np.all(check_array(key, getattr(self, key), (None,)) >= 0):
                raise BadValue(
                    key, list(getattr(self, key)), "a list of numbers >= 0, one for each anchor"
                )
        share = check_array("disturbed", self.disturbed, (None,))
        if not np.all((share >= 0) & (share <= 1)):
            raise BadValue(
                "disturbed", list(self.disturbed), "a list of shares from 0 to 1, one for each day"
            )

    def offers(self) -> frozenset[str]:
        """Elevations, signal strengths and the deviations of the angles."""
        return frozenset({"elevation", "rssi", "stated_sigma"})

    def sample(self, rng: np.random.Generator, scenario: Scenario, truth: Array) -> Measurements:
        """Azimuth, elevation (T, B) rad and rssi (T, B) dBm of true states (T, n).

        The scenario's `day_of` says which day a step belongs to. Days beyond the list of
        `disturbed`, and anchors beyond those of `bias_scale` and `pull`, take the last one's.
        """
        point, seat = np.unique(truth[:, :3], axis=0, return_inverse=True)
        seat, day = seat.ravel(), scenario.day_of(len(truth))
        T, B = len(truth), scenario.true_anchors.count
        # every draw is made whatever the parameters are, so that two settings are paired
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
        """Gaussian fields (P, *shape) of variance 1 at points (P, 3) m, correlated over the floor:
        sums of waves.
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


def _each(values: Sequence[float], count: int) -> Array:
    """The values of `count` days or anchors; those beyond the list take its last."""
    return np.array([values[min(i, len(values) - 1)] for i in range(count)])
