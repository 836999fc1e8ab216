"""Path loss, RSS, both bounds, clocks, shadowing and access nodes' errors against hand numbers and
samples.
"""

import numpy as np
import pytest
from scipy import stats

from aoabench.errors import BadValue
from aoabench.maths.geometry import LIGHT
from aoabench.noise.ofdm import OfdmCrlb
from aoabench.types import Anchors
from tests.helpers import Place

NOISE = OfdmCrlb()


def scenario(B=5):
    position = np.array(
        [[[10.0 * np.cos(t), 10.0 * np.sin(t), 3.0] for t in np.linspace(0.3, 5.9, B)]]
    )
    turn = np.linspace(0.3, 5.9, B) + np.pi  # broadside towards the middle
    c, s, o, i = np.cos(turn), np.sin(turn), np.zeros(B), np.ones(B)
    R = np.stack([np.stack(r, -1) for r in ((c, s, o), (-s, c, o), (o, o, i))], axis=-2)
    return Place(Anchors(position, R[None]))


def test_path_loss_and_rss_by_hand():
    """At 10 m and 39 GHz: 32.4 + 17.3 + 20 log10 39 = 81.521 dB, so 27 - 81.521 + 20 = -34.521 dBm
    [(1)].
    """
    assert NOISE.path_loss(10.0) == pytest.approx(32.4 + 17.3 + 31.8213, abs=1e-4)
    assert NOISE.rss(10.0) == pytest.approx(-34.5213, abs=1e-4)
    assert NOISE.rss(10.0, 3.0) == pytest.approx(-31.5213, abs=1e-4)
    assert NOISE.path_loss(100.0) - NOISE.path_loss(10.0) == pytest.approx(17.3)
    assert NOISE.path_loss(0.0) == NOISE.path_loss(1.0)


def test_time_bound_by_hand():
    """Signal to noise 10^5, M = 511.5, M (M + 1) (2 M + 1) = 2.6844e8: 9.83e-26 s^2 [(4)]."""
    M = 511.5
    assert abs(M * (M + 1) * (2 * M + 1) / 2.684352e8 - 1) < 1e-4
    variance = 3 / (8 * np.pi**2 * 120e3**2 * 1e5 * M * (M + 1) * (2 * M + 1))
    assert variance == pytest.approx(9.829e-26, rel=1e-3, abs=0)
    ours = NOISE.delay_sigma(NOISE.noise_dbm + 50.0)
    assert ours == pytest.approx(np.sqrt(variance), rel=1e-9, abs=0)


def bound_by_fisher_information(signal, at, step, snr):
    """Standard deviation of the Cramér-Rao bound on the one parameter of a complex signal (N,).

    Its elements arrive with power `snr` in independent circular noise of power 1, so that the
    information is 2 snr sum |ds / dp|^2; the derivative is a central difference.
    """
    slope = (signal(at + step) - signal(at - step)) / (2 * step)
    return 1 / np.sqrt(2 * snr * np.sum(np.abs(slope) ** 2))


@pytest.mark.parametrize("subcarriers", [2, 33, 1024])
def test_time_bound_is_the_fisher_information_of_the_pilots(subcarriers):
    """Equal pilots on carriers around the centre, delayed by tau: phases -2 pi k f_sc tau [(4)].

    With each carrier's share of signal and noise the signal to noise ratio is that of the whole.
    """
    noise = OfdmCrlb(subcarriers=subcarriers, subcarrier_khz=60.0)
    k = np.arange(subcarriers) - 0.5 * (subcarriers - 1)

    def pilots(tau):
        return np.exp(-2j * np.pi * k * 60e3 * tau)

    for snr_db in (-10.0, 50.0):
        bound = bound_by_fisher_information(pilots, 3e-8, 1e-12, 10 ** (0.1 * snr_db))
        ours = noise.delay_sigma(noise.noise_dbm + snr_db)
        assert ours == pytest.approx(bound, rel=1e-6, abs=0)


@pytest.mark.parametrize("elements", [2, 7, 10])
@pytest.mark.parametrize("angle", [-1.2, 0.0, 0.7])
def test_angle_bound_is_the_fisher_information_of_the_array(elements, angle):
    """Elements half a wavelength apart, seen at `angle` off broadside: phases pi n sin a [(8)]."""
    noise = OfdmCrlb(elements=elements)
    n = np.arange(elements) - 0.5 * (elements - 1)

    def array(a):
        return np.exp(1j * np.pi * n * np.sin(a))

    bound = bound_by_fisher_information(array, angle, 1e-6, 10**3.0)
    rss = noise.noise_dbm + noise.array_gain_db + 30.0  # of one element: 30 dB
    assert noise.angle_sigma(rss, angle) == pytest.approx(bound, rel=1e-6, abs=0)


def test_angle_bound_by_hand():
    """L = 10, element's signal to noise 10^3: 6 / (10 x 99 x 1000 x pi^2) = 6.141e-7 rad^2, 0.0449
    deg at broadside [(8)].
    """
    rss = NOISE.noise_dbm + NOISE.array_gain_db + 30.0
    assert np.rad2deg(NOISE.angle_sigma(rss, 0.0)) == pytest.approx(0.04490, abs=1e-5)
    assert NOISE.angle_sigma(rss, np.pi / 3) == pytest.approx(2 * NOISE.angle_sigma(rss, 0.0))
    assert NOISE.angle_sigma(rss, np.pi / 2) == pytest.approx(NOISE.angle_sigma(rss, 0.0) / 0.02)
    assert NOISE.angle_sigma(rss, 2.0) == pytest.approx(NOISE.angle_sigma(rss, np.pi - 2.0))


def test_gain_as_printed_counts_twice():
    """U6: 20 dB make the angles ten times as good."""
    printed = OfdmCrlb(as_printed=("gain",))
    assert NOISE.angle_sigma(-40.0, 0.3) == pytest.approx(10 * printed.angle_sigma(-40.0, 0.3))


def test_samples_have_the_stated_deviations():
    """Residuals over stated deviations are standard normal: KS with a false-alarm rate of 1e-4
    each.
    """
    world, rng = scenario(), np.random.default_rng(5)
    truth = rng.uniform(-4, 4, (4000, 3)) * [1, 1, 0.1]
    m = NOISE.sample(rng, world, truth)
    offset = truth[:, None] - world.true_anchors.position[0, 0]
    local = (world.true_anchors.rotation[0, 0] @ offset[..., None])[..., 0]
    d = np.linalg.norm(local, axis=-1)
    for name, exact in (
        ("azimuth", np.arctan2(local[..., 1], local[..., 0])),
        ("elevation", np.arcsin(local[..., 2] / d)),
        ("delay", d / LIGHT),
    ):
        z = (getattr(m, name) - exact) / getattr(m, f"{name}_sigma")
        assert stats.kstest(z.ravel(), "norm").pvalue > 1e-4, name
    assert m.delay_sigma.min() > 10e-9
    assert m.delay_sigma.max() < 10.1e-9  # the clock is nearly all of it


def test_shadowing_is_common_to_the_anchors_and_correlated_along_the_way():
    rng, world = np.random.default_rng(8), scenario()
    truth = np.stack([np.linspace(-4, 4, 81), np.zeros(81), np.full(81, 1.5)], axis=-1)
    drawn = np.array([NOISE.shadowing(rng, truth) for _ in range(4000)])
    assert drawn.std() == pytest.approx(3.0, rel=0.03)
    correlation = np.corrcoef(drawn[:, 0], drawn[:, 50])[0, 1]
    assert correlation == pytest.approx(
        np.exp(-5.0 / 10.0), abs=4 * (1 - np.exp(-1.0)) / np.sqrt(4000)
    )
    m = NOISE.sample(rng, world, truth)
    d = np.linalg.norm(truth[:, None] - world.true_anchors.position[0, 0], axis=-1)
    fade = m.rssi - NOISE.rss(d)
    assert np.allclose(fade, fade[:, :1])
    free = np.array([OfdmCrlb(shadowing_m=0).shadowing(rng, truth) for _ in range(2000)])
    assert abs(np.corrcoef(free[:, 0], free[:, 1])[0, 1]) < 4 / np.sqrt(2000)


@pytest.mark.parametrize("error", ["independent", "common"])
def test_access_nodes_errors(error):
    """Deviations sigma, sigma, sigma / beta [(10)], within 4 standard errors of 4000 draws; common
    is one for all.
    """
    noise, rng, world = (
        OfdmCrlb(an_sigma_m=2.0, an_error=error),
        np.random.default_rng(4),
        scenario(),
    )
    known = [noise.known_anchors(rng, world) for _ in range(4000)]
    e = (np.concatenate([k.position for k in known]) - world.true_anchors.position)[:, 0]
    spread = e.std(axis=0)
    assert np.allclose(spread, [2.0, 2.0, 0.2], rtol=4 / np.sqrt(8000))
    assert np.allclose(known[0].position_sigma, [2.0, 2.0, 0.2])
    together = np.corrcoef(e[:, 0, 0], e[:, 1, 0])[0, 1]
    assert (
        together == pytest.approx(1.0) if error == "common" else abs(together) < 4 / np.sqrt(4000)
    )
    exact = OfdmCrlb().known_anchors(rng, world)
    assert np.array_equal(exact.position, world.true_anchors.position)


@pytest.mark.parametrize("bad", [
    {"carrier_ghz": 0}, {"subcarriers": 1}, {"subcarriers": 10.5}, {"elements": 1}, {"cosine_floor": 0}, {"clock_ns": -1},
    {"an_sigma_m": -0.1}, {"an_beta": 0}, {"an_error": "shared"}, {"as_printed": ["gains"]}, {"as_printed": "gain"},
    {"shadowing_db": -1}, {"noise_dbm": float("nan")},
])  # fmt: skip
def test_bad_parameters_are_named(bad):
    with pytest.raises(BadValue) as error:
        OfdmCrlb(**bad)
    assert error.value.key == next(iter(bad))
