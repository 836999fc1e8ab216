"""Measurements of a tile: those of each replication alone, and of a plain rewrite in loops."""

import math

import numpy as np
import pytest

from aoabench.config.compose import compose_cells
from aoabench.maths.geometry import LIGHT
from aoabench.maths.places import at_anchors
from aoabench.noise import ofdm
from aoabench.noise.ofdm import OfdmCrlb

PLACES = {
    "route": ["scenario=indoor_map", "scenario.dt=15"],
    "model": ["scenario=indoor_map_model", "scenario.steps=20", "scenario.dt=1"],
    "few": ["scenario=indoor_map", "scenario.dt=40", "scenario.nearest=null"],
    "track": ["scenario=square_track", "scenario.steps=9"],
    "room": ["scenario=ble_room", "scenario.packets=3"],
}
NOISES = ("ae_flip", "ae_normal", "vmf", "ofdm_crlb", "ble_multipath")
R = 5


def world(place, noise, *words):
    group = "estimator=[ls_lines]" if place == "room" else "filter=[ekf_aoa]"
    rest = ["filter=[]"] if place == "room" else []
    cell = compose_cells([*PLACES[place], f"noise={noise}", *words, group, *rest])[0]
    truth = np.stack([cell.scenario.truth(np.random.default_rng(i)) for i in range(R)])
    return cell.scenario, cell.noise, truth


def rngs():
    return [np.random.default_rng((3, i)) for i in range(R)]


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("place", PLACES)
def test_a_tile_has_the_bits_of_each_replication(place, noise):
    scenario, model, truth = world(place, noise)
    tile, count = model.sample_tile(rngs(), scenario, truth), scenario.true_anchors.count
    numbers = tile.anchor_id
    few = place in ("route", "model", "few") and noise != "ble_multipath"
    assert (numbers is None) == (not few)
    for i, rng in enumerate(rngs()):
        alone = model.sample(rng, scenario, truth[i])
        assert tile.arrays.keys() == alone.arrays.keys()
        heard = scenario.hears(truth[i, :, :3])
        for name, array in tile.arrays.items():
            found = array if numbers is None else at_anchors(array, numbers, count)
            np.testing.assert_array_equal(found[i], alone.arrays[name], name)
            if heard is not None and noise != "ble_multipath":
                assert np.array_equal(np.isfinite(found[i]), heard), name
    if numbers is not None:  # the empty places
        for array in tile.arrays.values():
            empty = np.broadcast_to(numbers < 0, array.shape)
            assert np.array_equal(np.isnan(array), empty)


@pytest.mark.parametrize("place", ["route", "model", "few", "track"])
def test_ofdm_in_loops(place, monkeypatch):
    """The module's formulas, link by link; shadowing is drawn first, then three numbers a link."""
    monkeypatch.setattr(ofdm, "_AT_ONCE", 300)  # replications in parts
    scenario, noise, truth = world(place, "ofdm_crlb")
    noise = OfdmCrlb(an_sigma_m=0.5, clock_ns=3.0, shadowing_m=7.0)
    tile, anchors = noise.sample_tile(rngs(), scenario, truth), scenario.true_anchors
    T, count = truth.shape[1], anchors.count
    for i, rng in enumerate(rngs()):
        points = truth[i, :, :3]
        e = rng.standard_normal(T)
        for k in range(1, T):
            keep = math.exp(-math.dist(points[k], points[k - 1]) / 7.0)
            e[k] = keep * e[k - 1] + math.sqrt(1 - keep**2) * e[k]
        heard = scenario.hears(points)
        heard = np.ones((T, count), dtype=bool) if heard is None else heard
        drawn = rng.standard_normal((3, int(heard.sum())))
        for n, (k, b) in enumerate(zip(*np.nonzero(heard))):
            x, y, z = anchors.rotation[0, 0, b] @ (points[k] - anchors.position[0, 0, b])
            d = math.sqrt(x * x + y * y + z * z)
            angles = math.atan2(y, x), math.atan2(z, math.hypot(x, y))
            rss = noise.rss(d, 3.0 * e[k])
            sigma = [float(noise.angle_sigma(rss, angle)) for angle in angles]
            sigma.append(math.hypot(noise.delay_sigma(rss), 3e-9))
            true = (*angles, d / LIGHT)
            noisy = [t + s * own for t, s, own in zip(true, sigma, drawn[:, n])]
            noisy[0] = math.remainder(noisy[0], 2 * math.pi)
            place_of = b if tile.anchor_id is None else None
            if place_of is None:
                own = tile.anchor_id[i if len(tile.anchor_id) > 1 else 0, k]
                place_of = own.tolist().index(b)
            found = [array[i, k, place_of] for array in tile.arrays.values()]
            assert np.allclose(found, [*noisy, rss, *sigma], rtol=1e-11, atol=1e-16)


def test_points_and_places_are_not_mixed_up():
    """Tiles of two scenarios and of two sets of points in turn are those of each alone."""
    cases = [world("route", "vmf"), world("few", "vmf"), world("route", "vmf", "scenario.dt=14")]
    cases += [(cases[0][0], cases[0][1], cases[0][2] + 0.01)]
    first = [noise.sample_tile(rngs(), scenario, truth) for scenario, noise, truth in cases]
    again = [noise.sample_tile(rngs(), scenario, truth) for scenario, noise, truth in cases[::-1]]
    for one, other in zip(first, again[::-1]):
        assert np.array_equal(one.azimuth, other.azimuth, equal_nan=True)
    assert not np.array_equal(first[0].azimuth, first[3].azimuth, equal_nan=True)
