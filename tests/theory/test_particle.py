"""The particle filter against the exact posterior, the exact Kalman filter, and the arithmetic of
resampling.
"""

import numpy as np
import pytest
from scipy import stats

from aoabench.errors import BadValue
from aoabench.filters.particle import ParticleFilter, reweigh, systematic
from aoabench.models.azel import AzEl
from aoabench.models.unit_vector import UnitVector
from aoabench.roles import Scenario
from aoabench.streams import Streams
from aoabench.studies import study
from aoabench.types import Anchors, Batch, Outcome, Reason
from tests.theory.test_kalman import ANCHORS, ConstantVelocity, Line, Linear, exact_kalman

STUDY = study.load("nurminen2018")
ORIGIN = Anchors(np.zeros((1, 1, 3)), np.eye(3)[None, None])


# --- convergence ----------------------------------------------------------------------------------


class OneUpdate(Scenario):
    """Figure 2 as a scenario of one step: the prior, no motion to speak of, one measurement."""

    name, dt = "one update", 1.0

    class motion:
        @staticmethod
        def matrices(dt):
            return np.eye(3), 1e-18 * np.eye(3)


def one_update(h, particles, seed):
    one = np.ones((1, 1, 1))
    f = STUDY.numbers.FIG2
    batch = Batch(
        f["azimuth"] * one,
        f["elevation"] * one,
        ORIGIN,
        prior_mean=f["mean"][None],
        prior_cov=f["sigma_m"] ** 2 * np.eye(3),
    )
    return ParticleFilter(h, particles)(
        batch, OneUpdate(), Streams(seed, "one update", (0,))
    ).position[0, 0]


@pytest.mark.parametrize(
    "h", [UnitVector(kappa=(36 / np.pi) ** 2), AzEl(sigma_deg=5.0)], ids=["vmf", "ae"]
)
def test_converges_to_the_exact_posterior_at_the_rate_of_monte_carlo(h):
    """Error against Figure 2's exact mean falls as N^-1/2 from N = 300 to 300 000: slope -0.5
    within 0.1.

    Each point is the root mean square of 40 runs, so the slope over three decades scatters by 0.02.
    """
    exact = STUDY.numbers.exact_mean(h, 200)
    sizes = np.array([300, 3_000, 30_000, 300_000])
    rms = [
        np.sqrt(np.mean([np.sum((one_update(h, n, s) - exact) ** 2) for s in range(40)]))
        for n in sizes
    ]
    slope = np.polyfit(np.log(sizes), np.log(rms), 1)[0]
    assert slope == pytest.approx(-0.5, abs=0.1)
    assert rms[-1] < 0.02


class LinearLikelihood(Linear):
    """The linear Gaussian model with its likelihood."""

    def loglik(self, x, anchors, y, quality):
        d = y[:, None] - self.predict(x, anchors)
        return (-0.5 * (d**2 / quality[:, None] + np.log(2 * np.pi * quality[:, None]))).sum(
            axis=-1
        )


def test_linear_gaussian_model_equals_the_kalman_filter(rng):
    """200 000 particles, 6 dimensions, 8 steps: means within 0.05 posterior deviations, deviations
    within 5 %.
    """
    H, r = rng.normal(size=(2, 6)), (1.0, 2.0)
    h = LinearLikelihood(tuple(map(tuple, H)), r)
    y = rng.normal(size=(1, 8, 2))
    batch = Batch(y[..., :1], y[..., 1:], ANCHORS, prior_mean=np.zeros((1, 6)), prior_cov=np.eye(6))
    estimates = ParticleFilter(h, 200_000)(batch, Line(), Streams(3, "line", (0,)))
    mean, covariance = exact_kalman(h, batch, y, 0)
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert np.all(np.abs(estimates.position[0] - mean) < 0.05 * sigma)
    ours = np.sqrt(np.diagonal(estimates.covariance[0], axis1=1, axis2=2))
    assert np.allclose(ours, sigma, rtol=0.05)
    assert isinstance(Line().motion, ConstantVelocity)


# --- resampling -----------------------------------------------------------------------------------


def test_resampling_is_unbiased():
    """Each particle's mean number of children is N w_i, over 1e5 draws of 20 particles.

    A count is floor(N w_i) or one more, so its variance is frac (1 - frac); neighbours are
    correlated, so each number is judged by itself: z within 5 (20 numbers, 1e-5). The chi-square
    test follows below.
    """
    rng = np.random.default_rng(12)
    w = rng.gamma(0.7, size=20)
    w /= w.sum()
    draws = 100_000
    total = np.zeros(20)
    for turn in rng.random(draws):
        total += np.bincount(systematic(w, turn), minlength=20)
    expected = 20 * w
    fraction = expected % 1
    z = (total / draws - expected) / np.sqrt(np.maximum(fraction * (1 - fraction), 1e-12) / draws)
    assert np.all(np.abs(z) < 5)


def test_ancestors_by_chi_square():
    """One ancestor drawn at random from each of 1e5 resamplings is distributed as w: chi-square,
    false alarm 1e-4.
    """
    rng = np.random.default_rng(13)
    w = rng.gamma(1.0, size=30)
    w /= w.sum()
    picked = np.array(
        [
            systematic(w, turn)[j]
            for turn, j in zip(rng.random(100_000), rng.integers(0, 30, 100_000))
        ]
    )
    assert stats.chisquare(np.bincount(picked, minlength=30), 100_000 * w).pvalue > 1e-4


@pytest.mark.parametrize("turn", [0.0, 0.3, 0.999999, np.nextafter(1.0, 0.0)])
def test_resampling_keeps_the_number_and_each_particles_share(turn, rng):
    for N in (1, 2, 7, 1000):
        for w in (np.full(N, 1 / N), np.eye(N)[0], np.eye(N)[-1], rng.dirichlet(np.full(N, 0.1))):
            ancestors = systematic(w, turn)
            assert len(ancestors) == N
            assert np.all(np.diff(ancestors) >= 0)
            counts = np.bincount(ancestors, minlength=N)
            assert np.all(np.abs(counts - N * w) < 1 + 1e-9)


def test_equal_weights_keep_every_particle():
    for turn in (0.01, 0.5, 0.99):
        assert np.array_equal(systematic(np.full(1000, 1e-3), turn), np.arange(1000))


@pytest.mark.parametrize("engine", ["numpy", "auto"])
def test_particles_are_resampled_where_the_effective_number_is_below_the_threshold(engine, track):
    """Just above the first step's share of effective particles the threshold changes the second
    step, just below it does not. Without resampling next to nothing is left after a lap.
    """
    _, batch = track_batch(track, R=1)

    def effective(resample_below):
        h = ParticleFilter(UnitVector(), 2000, resample_below, engine)
        return h.trace(batch, track, Streams(1, "square_track", (0,)))["ess"][0]

    never, always = effective(0.0), effective(1.0)
    assert never[-1] < 20 < 100 < always[-1]
    share = never[0] / 2000
    for resample_below in (0.5 * share, 0.999 * share):
        assert np.array_equal(effective(resample_below)[:2], never[:2])
    for resample_below in (1.001 * share, 1.0):
        first, second = effective(resample_below)[:2]
        assert first == never[0]
        assert second != never[1]


# --- weights --------------------------------------------------------------------------------------


def test_weights_neither_overflow_nor_underflow():
    with np.errstate(all="raise", under="ignore"):
        log_w, w, informed = reweigh(np.full(3, -np.log(3)), np.array([-1e9, -1e9 + 1, -2e9]))
    assert informed
    assert w == pytest.approx([1 / (1 + np.e), np.e / (1 + np.e), 0.0], rel=1e-9, abs=0)
    assert np.exp(log_w[:2]) == pytest.approx(w[:2])


def test_degenerate_weights():
    inf = np.inf
    _, w, informed = reweigh(np.full(4, -np.log(4)), np.array([-inf, -inf, -3.0, -inf]))
    assert informed
    assert list(w) == [0, 0, 1, 0]
    _, w, informed = reweigh(np.full(4, -np.log(4)), np.full(4, -7.0))
    assert informed
    assert np.allclose(w, 0.25)
    for nothing in (np.full(4, -inf), np.full(4, np.nan)):
        before = np.log([0.1, 0.2, 0.3, 0.4])
        log_w, w, informed = reweigh(before, nothing)
        assert not informed
        assert np.allclose(w, [0.1, 0.2, 0.3, 0.4])
        assert np.allclose(log_w, before)
    _, w, informed = reweigh(np.full(2, -np.log(2)), np.array([np.nan, -1.0]))
    assert informed
    assert list(w) == [0, 1]


def track_batch(track, noise_seed=5, R=2):
    from dataclasses import replace

    from aoabench.engine.draws import Draws
    from aoabench.noise.angular import VonMisesFisher

    truth, batch = Draws(track, VonMisesFisher(10.0), noise_seed).tile(0, R)
    return truth, replace(batch, azimuth=batch.azimuth.copy(), elevation=batch.elevation.copy())


@pytest.mark.parametrize("h", [UnitVector(), AzEl()], ids=["vmf", "ae"])
def test_an_anchor_without_a_measurement_is_not_used(h, track):
    """The filter with NaN from two anchors equals, bit for bit, the filter that never heard of
    them.
    """
    from dataclasses import replace

    _, batch = track_batch(track)
    for field in (batch.azimuth, batch.elevation):
        field[:, :, [1, 3]] = np.nan
    keep = [0, 2]
    fewer = replace(
        batch,
        azimuth=batch.azimuth[..., keep], elevation=batch.elevation[..., keep],
        azimuth_sigma=batch.azimuth_sigma[..., keep], elevation_sigma=batch.elevation_sigma[..., keep],
        anchors=batch.anchors.those(keep),
    )  # fmt: skip
    streams = Streams(1, "square_track", (0, 1))
    a, b = (ParticleFilter(h, 500)(x, track, streams) for x in (batch, fewer))
    assert np.allclose(a.position, b.position, atol=1e-9)
    assert np.array_equal(a.reason, b.reason)
    few = a.reason == Reason.COVARIANCE  # two or three of 500 particles have all the weight
    assert np.all((a.outcome == Outcome.OK) | few)


def test_a_step_without_any_measurement_only_moves_the_particles(track):
    _, batch = track_batch(track, R=1)
    batch.azimuth[:, 3] = np.nan
    batch.elevation[:, 3] = np.nan
    estimates = ParticleFilter(UnitVector(), 2000)(batch, track, Streams(1, "square_track", (0,)))
    assert np.all(estimates.outcome == Outcome.OK)
    spread = np.trace(estimates.covariance[0], axis1=1, axis2=2)
    assert spread[3] > spread[2]


def test_huge_kappa_and_few_particles_give_positions(track):
    _, batch = track_batch(track)
    estimates = ParticleFilter(UnitVector(kappa=1e6), 50)(
        batch, track, Streams(1, "square_track", (0, 1))
    )
    assert np.all(np.isfinite(estimates.position))


def test_all_particle_filters_of_a_replication_share_their_noise(track):
    """Two models that are equal give equal results, and so do two filters run in another order."""
    _, batch = track_batch(track)
    streams = Streams(1, "square_track", (0, 1))
    first = ParticleFilter(UnitVector(), 300)(batch, track, streams)
    ParticleFilter(AzEl(), 300)(batch, track, streams)
    again = ParticleFilter(UnitVector(kappa=1 / np.deg2rad(10) ** 2), 300)(batch, track, streams)
    assert np.allclose(first.position, again.position, atol=1e-9)


@pytest.mark.parametrize(
    ("key", "value"),
    [("particles", 0), ("particles", 2.5), ("resample_below", -0.1), ("resample_below", 1.1)],
)
def test_bad_parameters_are_named(key, value):
    with pytest.raises(BadValue, match=key):
        ParticleFilter(AzEl(), **{key: value})
