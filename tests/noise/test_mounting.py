"""Anchors that are mounted otherwise than is known: what is measured, what is known, what is drawn."""

from dataclasses import replace

import numpy as np
import pytest

from aoabench.engine.draws import Draws
from aoabench.errors import BadValue
from aoabench.maths.geometry import facing, in_frames, to_azel, wrap
from aoabench.models.motion import RandomWalk
from aoabench.noise.angular import FlippedAngles, NormalAngles, VonMisesFisher
from aoabench.noise.multipath import BleMultipath
from aoabench.noise.ofdm import OfdmCrlb
from aoabench.scenarios.layout import AnchorLayout
from aoabench.scenarios.square_track import SquareTrack

NOISES = [
    NormalAngles(sigma_deg=1.0),
    FlippedAngles(sigma_deg=1.0),
    VonMisesFisher(sigma_deg=1.0),
    OfdmCrlb(an_sigma_m=0.3),
    BleMultipath(),
]
IDS = [type(noise).__name__ for noise in NOISES]


def level_track():
    """Anchors whose poles look up, a target well below none of them."""
    layout = AnchorLayout([[-1, 0, 2], [6, 0, 2], [6, 5, 2], [-1, 5, 2]])
    return SquareTrack("square_track", layout, RandomWalk())


@pytest.mark.parametrize("noise", NOISES, ids=IDS)
def test_mounting_changes_only_the_known_rotations(noise):
    track = level_track()
    wrong = replace(noise, mounting_yaw_deg=4.0, mounting_pitch_deg=2.0, mounting_roll_deg=1.0)
    truth, right_batch = Draws(track, noise, 3).tile(0, 5)
    truth_too, batch = Draws(track, wrong, 3).tile(0, 5)
    assert np.array_equal(truth, truth_too)
    for name in ("azimuth", "elevation", "delay", "rssi", "azimuth_sigma"):
        one, other = getattr(right_batch, name), getattr(batch, name)
        assert (one is None and other is None) or np.array_equal(one, other, equal_nan=True)
    assert np.array_equal(
        np.broadcast_to(right_batch.anchors.position, batch.anchors.position.shape),
        batch.anchors.position,
    ), "position errors are drawn first: mounting errors leave their bits alone"
    assert len(right_batch.anchors.rotation) == 1
    R = batch.anchors.rotation
    assert R.shape == (5, 1, 4, 3, 3)
    assert np.allclose(R @ np.swapaxes(R, -1, -2), np.eye(3), atol=1e-12)
    assert not np.allclose(R[0], R[1], atol=1e-3), "each replication has errors of its own"


@pytest.mark.parametrize("noise", NOISES, ids=IDS)
def test_without_deviations_nothing_is_drawn(noise):
    track, rng = level_track(), np.random.default_rng(1)
    noise.known_anchors(rng, track)
    plain = np.random.default_rng(1)
    if isinstance(noise, OfdmCrlb):
        plain.standard_normal((1, 4, 3))
    assert rng.random() == plain.random()


def test_a_yaw_error_is_an_azimuth_error():
    """Seen from the frame that is believed, exact azimuths are off by the yaw, elevations not."""
    noise = replace(NormalAngles(sigma_deg=1e-5), mounting_yaw_deg=5.0)
    truth, batch = Draws(level_track(), noise, 1).tile(0, 40)
    anchors = batch.anchors
    azimuth, elevation = to_azel(*in_frames(truth, anchors.position, anchors.rotation))
    off = np.rad2deg(wrap(batch.azimuth - azimuth))
    assert np.allclose(off, off[:, :1], atol=1e-3), "the same at every step"
    assert np.allclose(batch.elevation, elevation, atol=1e-5)
    yaw = off[:, 0].ravel()
    # 160 normals of 5 deg: their root mean square is within 25 % but for 1 in 10^5 seeds
    assert np.sqrt((yaw**2).mean()) == pytest.approx(5.0, rel=0.25)


@pytest.mark.parametrize(("axis", "turned"), [("pitch", 1), ("roll", 0)])
def test_pitch_and_roll_turn_about_their_own_axes(axis, turned):
    """The axis of rotation, in the anchor's own frame, stays where it is."""
    noise = replace(NormalAngles(sigma_deg=1.0), **{f"mounting_{axis}_deg": 8.0})
    layout = AnchorLayout([[0, 0, 0], [9, 0, 0]], [[1.0, 2.0, 0.5], [0.0, -1.0, 0.3]])
    track = SquareTrack("square_track", layout, RandomWalk())
    _, batch = Draws(track, noise, 1).tile(0, 3)
    true = facing(np.array(layout.facing))
    known = batch.anchors.rotation[:, 0]
    assert np.allclose(known[..., turned, :], true[None, :, turned, :], atol=1e-12)
    other = 1 - turned
    assert not np.allclose(known[..., other, :], true[None, :, other, :], atol=1e-3)


@pytest.mark.parametrize("value", [-1.0, 200.0, True, "much", float("nan")])
@pytest.mark.parametrize("noise", NOISES, ids=IDS)
def test_bad_deviations_are_refused(noise, value):
    with pytest.raises(BadValue, match="mounting_pitch_deg"):
        replace(noise, mounting_pitch_deg=value)
