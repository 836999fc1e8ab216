"""The compiled particle filter: polynomials, random numbers, likelihoods, resampling and whole laps
against slow double precision; the machine code that it became."""

import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy import special, stats

from aoabench.config.compose import compose_cells
from aoabench.engine import block
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import estimate_tile
from aoabench.filters import particle as pf
from aoabench.filters import particle_inputs as inputs
from aoabench.filters.compiled import KINDS, kind_of
from aoabench.kernels.loading import load
from aoabench.loaded import source
from aoabench.maths.directional import vmf_log_peak
from aoabench.models.azel import AzEl, AzElAdaptive
from aoabench.models.unit_vector import UnitVector
from aoabench.noise.angular import FlippedAngles
from aoabench.roles import Scenario
from aoabench.store.definitions import parsed
from aoabench.store.reach import reach
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch
from tests.theory.assembly import assembly, vector_registers

numba = pytest.importorskip("numba")
K, LIKELIHOOD, RESAMPLING, PHILOX, SINGLE, SMALL = (
    load(f"kernels.{name}")
    for name in (
        "particle",
        "particle_likelihood",
        "particle_resampling",
        "philox",
        "single",
        "small",
    )
)
KEY = (0xA4093822, 0x299F31D0)


def u8(*words):
    return tuple(np.uint64(w) for w in words)


@numba.njit
def over(function, x, out):
    for i in range(len(x)):
        out[i] = function(x[i])


@numba.njit(forceinline=True)
def inverse_root(x):
    return SINGLE.inverse_root(x)


def single(function, x):
    out = np.empty(len(x), dtype=np.float32)
    over(function, x.astype(np.float32), out)
    return out.astype(float)


def spaced(low, high, n=1_000_003):
    """Numbers in [low, high] that float32 has, evenly spaced."""
    return np.linspace(low, high, n, dtype=np.float32)


# --- polynomials ----------------------------------------------------------------------------------


def test_arctan_over_its_whole_range():
    t = np.concatenate([spaced(0, 1), np.geomspace(1e-30, 1, 100_003).astype(np.float32)])
    exact = np.arctan(t.astype(float))
    assert np.all(np.abs(single(SINGLE.arctan, t) - exact) <= 2.5e-7 * exact)


def test_exponential_over_its_whole_range():
    x = spaced(-40, 0)[1:]
    exact = np.exp(x.astype(float))
    error = np.abs(single(SINGLE.exponential, x) / exact - 1)
    assert error.max() < 4e-6
    assert error[x > -1].max() < 3e-7
    assert np.all(single(SINGLE.exponential, np.array([-40.0, -40.001, -1e30, -np.inf])) == 0)


def test_precise_exponential_over_its_whole_range():
    x = spaced(-40, 0)[1:]
    exact = np.exp(x.astype(float))
    assert np.abs(single(SINGLE.precise_exponential, x) / exact - 1).max() < 3e-7
    beyond = np.array([-40.0, -40.001, -1e30, -np.inf, np.nan])
    assert np.all(single(SINGLE.precise_exponential, beyond) == 0)


def test_inverse_root_over_its_whole_range():
    x = np.geomspace(1e-30, 1e12, 1_000_003).astype(np.float32)
    error = single(inverse_root, x) * np.sqrt(x.astype(float)) - 1
    assert np.abs(error).max() < 4e-7


def test_logarithm_over_its_whole_range():
    x = np.concatenate(
        [spaced(2.0**-33, 1), np.geomspace(1e-12, 1e14, 1_000_003).astype(np.float32)]
    )
    exact = np.log(x.astype(float))
    error = np.abs(single(SINGLE.logarithm, x) - exact)
    assert np.all(error <= 2e-7 * np.maximum(np.abs(exact), 1))
    near = x[np.abs(x - 1) < 0.25]
    assert np.allclose(
        single(SINGLE.logarithm, near), np.log(near.astype(float)), rtol=4e-7, atol=0
    )


# --- random numbers -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("counter", "key", "words"),
    [
        ((0,) * 4, (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((2**32 - 1,) * 4, (2**32 - 1,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            KEY,
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_philox_gives_the_published_words(counter, key, words):
    """Known answers of Philox4x32-10, from its authors' test vectors."""
    assert PHILOX.philox(*u8(*counter), *u8(*key)) == words


def slow_normals(n, step, replication, key):
    """Philox and Box-Muller in NumPy and double precision: normals (3, n), and the radius behind
    each.

    Three counters make the three normals of four particles, a quarter of a tile apart.
    """
    c = [np.arange(3 * n // 4, dtype=np.uint64)]
    c += [np.full(len(c[0]), w, dtype=np.uint64) for w in (step, replication, 0)]
    k, low, shift = list(u8(*key)), np.uint64(2**32 - 1), np.uint64(32)
    for _ in range(10):
        p, q = np.uint64(0xD2511F53) * c[0], np.uint64(0xCD9E8D57) * c[2]
        c = [(q >> shift) ^ c[1] ^ k[0], q & low, (p >> shift) ^ c[3] ^ k[1], p & low]
        k = [(k[0] + np.uint64(0x9E3779B9)) & low, (k[1] + np.uint64(0xBB67AE85)) & low]
    a, b, d, e = (w.astype(float) for w in c)
    r, r2 = (np.sqrt(-2 * np.log((w + 0.5) / 2.0**32)) for w in (a, d))
    turn, turn2 = (2 * np.pi * w / 2.0**32 - np.pi / 4 for w in (b, e))
    found = np.stack(
        [r * np.sin(turn), r * np.cos(turn), r2 * np.sin(turn2), r2 * np.cos(turn2)], axis=-1
    )

    def placed(four):  # (tile, particle in its quarter, quarter, component)
        return np.moveaxis(four.reshape(-1, PHILOX.QUARTER, 4, 3), 1, 2).reshape(n, 3).T

    return placed(found), placed(np.stack([r, r, r2, r2], axis=-1))


def test_normals_equal_those_computed_slowly():
    out = np.empty((3, 40 * K.TILE), dtype=np.float32)
    K.normals(out, 7, 123, *KEY)
    exact, radius = slow_normals(out.shape[1], 7, 123, KEY)
    # near radius 0, 1 - u is lost in single precision: up to 3e-4 off there, 5e-6 elsewhere
    assert np.abs(out - exact)[radius > 0.1].max() < 5e-6
    assert np.abs(out - exact).max() < 4e-4


def test_ten_million_normals():
    """KS, the first six moments, independence of components, steps, replications and neighbours.

    Each of the tests raises a false alarm with probability 1e-4 at most.
    """
    n = 3_333_376  # a multiple of the tile; three components
    planes = np.empty((3, n), dtype=np.float32)
    K.normals(planes, 1, 5, *KEY)
    z = np.sort(planes.ravel().astype(float))
    share, rank = special.ndtr(z), np.arange(len(z) + 1) / len(z)
    distance = max((rank[1:] - share).max(), (share - rank[:-1]).max())
    assert stats.kstwo.sf(distance, len(z)) > 1e-4
    power_of_z = np.ones(len(z))
    for power, expected, variance in [
        (1, 0, 1),
        (2, 1, 2),
        (3, 0, 15),
        (4, 3, 96),
        (5, 0, 945),
        (6, 15, 10170),
    ]:
        power_of_z *= z
        assert abs(power_of_z.mean() - expected) < 3.9 * np.sqrt(variance / len(z)), power
    for beyond in (3, 4, 5):  # tails
        expected = len(z) * 2 * stats.norm.sf(beyond)
        assert (
            stats.binomtest(int((np.abs(z) > beyond).sum()), len(z), expected / len(z)).pvalue
            > 1e-4
        )
    other, later = np.empty_like(planes), np.empty_like(planes)
    K.normals(later, 2, 5, *KEY)
    K.normals(other, 1, 6, *KEY)
    # of mean 0 and variance 1 by the tests above, so that the mean product is the correlation
    for f in (lambda v: v.astype(float), lambda v: (np.square(v.astype(float)) - 1) / np.sqrt(2)):
        x, after, elsewhere = f(planes), f(later[0]), f(other[0])
        pairs = [(x[0], x[1]), (x[0], x[2]), (x[1], x[2]), (x[0], after), (x[0], elsewhere)]
        pairs += [(x[0, :-1], x[0, 1:])]
        pairs += [
            (x[i, : -PHILOX.QUARTER], x[j, PHILOX.QUARTER :]) for i in range(3) for j in range(3)
        ]
        for a, b in pairs:
            assert abs(a @ b / len(a)) < 3.9 / np.sqrt(n)


def test_normals_do_not_depend_on_how_many_are_drawn():
    few, many = (np.empty((3, tiles * K.TILE), dtype=np.float32) for tiles in (2, 9))
    for out in (few, many):
        K.normals(out, 3, 4, *KEY)
    assert np.array_equal(few, many[:, : few.shape[1]])


def test_turns_are_uniform():
    """KS over 10 000 steps; false alarm 1e-4."""
    u = np.array([PHILOX.turn(k, 9, *KEY) for k in range(10_000)])
    assert u.min() >= 0
    assert u.max() < 1
    assert stats.kstest(u, "uniform").pvalue > 1e-4


# --- likelihoods ----------------------------------------------------------------------------------


def rotations(rng, B):
    return np.linalg.qr(rng.normal(size=(B, 3, 3)))[0]


def models(sigma_deg):
    kappa = 1 / np.deg2rad(sigma_deg) ** 2
    return [
        UnitVector(kappa),
        AzEl(sigma_deg),
        AzElAdaptive(sigma_deg, noise=FlippedAngles(sigma_deg)),
    ]


def coefficients(which, y, r, anchors):
    """The terms of one step for measurements (1, m) and their variances."""
    return inputs.terms(which, y[None], r[None], anchors, np.zeros((1, 3)))[0, 0]


@pytest.mark.parametrize("sigma_deg", [30.0, 10.0, 1.8118])  # the last one: kappa = 1000
@pytest.mark.parametrize("which", range(3), ids=KINDS)
@pytest.mark.parametrize("B", [1, 4, 9])
def test_log_weights_of_one_step(sigma_deg, which, B, rng):
    """Within 1e-4 of double precision, on 10 240 particles, whatever the noise drew and whatever
    lies in between.

    Compared where the weight is more than 1e-20 of the largest one (the kernel itself stops at
    4e-18). Angles: below 60 degrees of elevation (towards the pole the rounding of the position
    itself moves the azimuth) and, for the adaptive model, where rounding does not decide between
    two rows of the table.
    """
    h, M = models(sigma_deg)[which], 40 * K.TILE
    for centre, spread in [((0, 0, 0), 0.5), ((4, -3, 1), 0.05), ((30, 10, -5), 2.0)]:
        truth, position = np.array(centre, dtype=float), rng.uniform(-5, 5, (1, B, 3))
        rotation = np.stack([seen_low(rng, truth - s) for s in position[0]])[None]
        anchors = Anchors(position, rotation)
        particles = (truth + spread * rng.standard_normal((M, 3))).astype(np.float32).astype(float)
        y = h.predict(truth[None], anchors)
        y += np.deg2rad(sigma_deg) * rng.normal(size=y.shape)
        if which == 0:
            y = (y.reshape(B, 3) / np.linalg.norm(y.reshape(B, 3), axis=-1, keepdims=True)).reshape(
                1, -1
            )
        r = np.full(y.shape, np.deg2rad(sigma_deg) ** 2)
        exact = h.loglik(particles[None], anchors, y, r)[0]
        out = np.empty(M, dtype=np.float32)
        x = np.ascontiguousarray(particles.T.astype(np.float32))
        LIKELIHOOD.loglik(
            which,
            *x,
            coefficients(which, y, r, anchors),
            inputs.weights_table(h, which),
            out,
        )
        seen = exact > exact.max() - 46
        if which:
            degrees = np.rad2deg(AzEl(1.0).predict(particles[None], anchors)[0, :, 1::2])
            seen &= np.all(np.abs(degrees) < 60, axis=-1)
            seen &= np.all(np.abs(degrees - np.floor(degrees) - 0.5) > 1e-4, axis=-1) | (which == 1)
        # what is the same for all particles the kernel leaves out
        constant = {
            0: B * vmf_log_peak(1 / r[0, 0]),
            1: -B * np.log(2 * np.pi * r[0, 0]),
            2: -B * np.log(np.pi),
        }[which]
        assert seen.sum() > 100
        assert np.abs(out + constant - exact)[seen].max() < 1e-4


def seen_low(rng, direction):
    """A random rotation in whose frame the direction has less than 45 degrees of elevation."""
    while True:
        R = rotations(rng, 1)[0]
        if abs((R @ direction)[2]) < 0.7 * np.linalg.norm(direction):
            return R


@pytest.mark.parametrize("which", range(3), ids=KINDS)
def test_what_is_not_measured_is_left_out(which, rng):
    h, M = models(10.0)[which], K.TILE
    anchors = Anchors(rng.uniform(-5, 5, (1, 3, 3)), rotations(rng, 3)[None])
    particles = rng.standard_normal((M, 3)).astype(np.float32).astype(float)
    y = h.predict(rng.normal(size=(1, 3)), anchors)
    d = y.shape[1] // 3
    y[0, d : 2 * d] = np.nan
    if which:
        y[0, 0] = np.nan  # one azimuth only
    r = np.full(y.shape, np.deg2rad(10) ** 2)
    out = np.empty(M, dtype=np.float32)
    x = np.ascontiguousarray(particles.T.astype(np.float32))
    LIKELIHOOD.loglik(
        which, *x, coefficients(which, y, r, anchors), inputs.weights_table(h, which), out
    )
    difference = out - h.loglik(particles[None], anchors, y, r)[0]
    assert np.abs(difference - np.median(difference)).max() < (0.3 if which == 2 else 1e-4)


@pytest.mark.parametrize("which", range(3), ids=KINDS)
def test_a_particle_on_its_anchor_or_pole_is_finite(which):
    h, anchors = models(10.0)[which], Anchors(np.zeros((1, 1, 3)), np.eye(3)[None, None])
    y = h.predict(np.array([[1.0, 1.0, 1.0]]), anchors)
    x = np.zeros((3, K.TILE), dtype=np.float32)
    x[2, 1], x[2, 2] = 2.0, -2.0
    out = np.empty(K.TILE, dtype=np.float32)
    terms = coefficients(which, y, np.full(y.shape, 0.03), anchors)
    LIKELIHOOD.loglik(which, *x, terms, inputs.weights_table(h, which), out)
    assert np.all(np.isfinite(out))


# --- resampling -----------------------------------------------------------------------------------


@pytest.mark.parametrize("N", [1, 2, 100, 256, 257, 5000])
def test_resampling_chooses_the_same_ancestors_as_the_reference(N, rng):
    M = -(-N // K.TILE) * K.TILE
    scales = rng.uniform(0.01, 1, M // K.TILE)  # of each tile's weights
    for sharpness in (0.1, 3.0, 50.0):
        w = np.zeros(M, dtype=np.float32)
        w[:N] = np.exp(-sharpness * rng.exponential(size=N))
        w[: N // 3] = 0  # none of the first and of the last ones
        if N > 2:
            w[N - 1] = 0
        x, children = (
            np.tile(np.arange(M, dtype=np.float32), (3, 1)),
            np.zeros((3, M), dtype=np.float32),
        )
        scaled = w * np.repeat(scales, K.TILE)
        for uniform in (0.0, rng.random(), 1 - 2.0**-32):
            RESAMPLING.resample(w, scales, N, uniform, np.empty(M + 1, np.int32), x, children)
            exact = pf.systematic(scaled[:N] / scaled.sum(), uniform)
            ours = children[0, :N].astype(int)
            assert np.array_equal(children[0], children[2])
            # the sums' last bits may shift a border between neighbours by one
            assert (ours != exact).sum() <= max(1, N // 1000)
            assert np.all(w[ours] > 0)


# --- whole laps -----------------------------------------------------------------------------------

NAMES = [f"pf_{m}" for m in ("vmf", "ae_nominal", "ae_fitted", "ae_adaptive")]


def cell_with(name, *words):
    return compose_cells([f"filter=[{name}]", *words])[0]


def estimates(cell, engine, replication, **changes):
    estimator = replace(next(iter(cell.estimators.values())), engine=engine, **changes)
    return estimate_tile(Draws(cell.scenario, cell.noise, cell.seed), estimator, replication)[1]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("noise", ["vmf", "ae_flip"])
def test_a_lap_along_the_kernel_in_double_precision(name, noise):
    """20 laps of 300 particles: means and covariances differ by rounding, a few 1e-7 m in the
    median.

    The azimuth turns by rounding / rho close to a pole, where its likelihood is steep: AE up to
    some 2e-4 m. AE-adaptive more, where a particle within rounding of the border between two rows
    of its table takes the other row's weights.
    """
    most = {"pf_vmf": 1e-4, "pf_ae_nominal": 1e-3, "pf_ae_fitted": 1e-3, "pf_ae_adaptive": 0.02}[
        name
    ]
    cell = cell_with(name, f"noise={noise}")
    for r in range(20):
        fast, exact = (estimates(cell, engine, r, particles=300) for engine in ("auto", "double"))
        apart = np.abs(fast.position - exact.position).max(-1)[0]
        assert np.median(apart) < 1e-5
        assert apart.max() < most
        assert np.median(np.abs(fast.covariance - exact.covariance)) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_rmse_agrees_with_the_reference_on_200_paired_replications(name):
    """Draws of their own, 1000 particles: mean difference within 3.9 of its standard errors (false
    alarm 1e-4).
    """
    cell = cell_with(name, "noise=ae_flip")
    one = next(iter(cell.estimators.values()))
    both = {engine: replace(one, engine=engine, particles=1000) for engine in ("auto", "numpy")}
    blocks = block.run_block(cell.scenario, cell.noise, both, 1, 0, 200)
    d = blocks["auto"]["rows"]["rmse_3d_m"] - blocks["numpy"]["rows"]["rmse_3d_m"]
    assert abs(d.mean()) < 3.9 * d.std(ddof=1) / np.sqrt(len(d))
    assert d.std() > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_single_precision_is_not_seen_beside_the_monte_carlo_error(name):
    """RMSE of 100 replications of 1000 particles: the mean difference from double precision along
    the kernel, with three of its standard errors (false alarm 3e-3), is below a fiftieth of the
    RMSE's standard error at 1000 replications. Three standard errors are below a fiftieth of that.

    `make bench` measures it at 10 000 particles and 1000 replications, both data models.
    """
    cell = cell_with(name, "noise=ae_flip")
    one = next(iter(cell.estimators.values()))
    both = {engine: replace(one, engine=engine, particles=1000) for engine in ("auto", "double")}
    blocks = block.run_block(cell.scenario, cell.noise, both, 1, 0, 100)
    fast, exact = (blocks[engine]["rows"]["rmse_3d_m"] for engine in both)
    d = fast - exact
    assert abs(d.mean()) + 3 * d.std(ddof=1) / np.sqrt(100) < 0.02 * exact.std() / np.sqrt(1000)


class Still(Scenario):
    """Four steps of a target that hardly moves, seen from any number of anchors."""

    name, dt = "still", 1.0

    class motion:
        @staticmethod
        def matrices(dt):
            return np.eye(3) * 0.9, np.array(
                [[0.02, 0.01, 0.0], [0.01, 0.03, -0.01], [0.0, -0.01, 0.02]]
            )


@pytest.mark.parametrize("B", [1, 2, 3, 7, 40])
@pytest.mark.parametrize("N", [1, 100, 257, 1000])
@pytest.mark.parametrize("which", range(3), ids=KINDS)
def test_any_number_of_anchors_and_particles_and_any_linear_motion(B, N, which, rng):
    h = models(20.0)[which]
    anchors = Anchors(rng.uniform(-5, 5, (1, B, 3)), rotations(rng, B)[None])
    angles = AzEl(20.0).predict(rng.normal(size=(1, 1, 3)), anchors).reshape(
        1, 1, B, 2
    ) + 0.2 * rng.normal(size=(1, 4, B, 2))
    batch = Batch(
        angles[..., 0],
        angles[..., 1],
        anchors,
        prior_mean=np.array([[3.0, 1, -2]]),
        prior_cov=2 * np.eye(3),
    )
    streams = Streams(3, "still", (11,))
    fast, exact = (
        pf.ParticleFilter(h, N, 0.0, engine)(batch, Still(), streams)
        for engine in ("auto", "double")
    )
    tolerance = (
        {"atol": 2e-5} if which < 2 else {"atol": 2e-3}
    )  # a particle on a border of the table's rows
    assert np.allclose(fast.position, exact.position, **tolerance)
    assert np.allclose(fast.covariance, exact.covariance, **tolerance)


@pytest.mark.parametrize("which", range(3), ids=KINDS)
def test_anchors_of_each_step(which, rng):
    """Two replications whose anchors stand elsewhere at each step: as by the slow likelihood at
    those of each step.
    """
    R, T, B = 2, 4, 3
    h, turned = models(20.0)[which], rotations(rng, R * T * B).reshape(R, T, B, 3, 3)
    anchors = Anchors(rng.uniform(-5, 5, (R, T, B, 3)), turned)
    at = rng.normal(size=(R, T, 3))
    seen = [AzEl(20.0).predict(at[:, k], anchors.at(k)).reshape(R, B, 2) for k in range(T)]
    angles = np.stack(seen, axis=1) + 0.1 * rng.normal(size=(R, T, B, 2))
    mean, cov = np.array([[3.0, 1, -2], [0, 1, 2]]), 2 * np.eye(3)
    batch = Batch(angles[..., 0], angles[..., 1], anchors, prior_mean=mean, prior_cov=cov)
    fast, exact = (
        pf.ParticleFilter(h, 257, 0.3, engine)(batch, Still(), Streams(3, "still", (11, 12)))
        for engine in ("auto", "double")
    )
    tolerance = 2e-5 if which < 2 else 2e-3
    assert np.allclose(fast.position, exact.position, rtol=0, atol=tolerance)
    assert np.allclose(fast.covariance, exact.covariance, rtol=0, atol=tolerance)


@pytest.mark.parametrize(("particles", "tile"), [(100, 16), (1000, 16), (10_000, 4), (50_000, 1)])
def test_a_tile_has_the_bits_of_each_of_its_replications(particles, tile):
    cell = cell_with("pf_ae_adaptive", "noise=vmf")
    estimator = replace(next(iter(cell.estimators.values())), particles=particles)
    draws = Draws(cell.scenario, cell.noise, cell.seed)
    assert estimator.tile == tile
    together = estimate_tile(draws, estimator, 0)[1]
    _, batch = draws.tile(0, tile)
    for i in range(0, tile, 3):
        streams = Streams(cell.seed, cell.scenario.name, (i,))
        alone = estimator(batch.of(i), cell.scenario, streams)
        assert np.array_equal(together.position[i], alone.position[0])
        assert np.array_equal(together.covariance[i], alone.covariance[0])


@pytest.mark.parametrize("name", NAMES)
def test_the_same_bits_with_and_without_shared_normals(name, monkeypatch):
    cell = cell_with(name, "noise=vmf")
    shared = estimates(cell, "auto", 5, particles=500)
    monkeypatch.setattr(inputs, "SHARED_BYTES", 0)
    alone = estimates(cell, "auto", 5, particles=500)
    again = estimates(cell, "auto", 5, particles=500)
    for other in (alone, again):
        assert np.array_equal(shared.position, other.position)
        assert np.array_equal(shared.covariance, other.covariance)


# --- engines and files ----------------------------------------------------------------------------


class Shifted(UnitVector):
    """A subclass that changes the likelihood must not get its parent's kernel."""

    def loglik(self, x, anchors, y, quality):
        return super().loglik(x, anchors, y, quality) - 0.5 * x[..., 2] ** 2


def test_a_subclass_has_no_kernel_until_it_says_so():
    assert kind_of(UnitVector(1.0)) == 0
    assert kind_of(UnitVector(1.0), "numpy") is None
    assert kind_of(Shifted(1.0)) is None


def test_without_numba_everything_runs_and_one_line_says_so(tmp_path):
    script = (
        "import sys; sys.modules['numba'] = None\n"
        "from aoabench.cli.main import dispatch\n"
        f"dispatch(['run', 'filter=[pf_vmf,ekf_vmf]', 'filter.pf_vmf.particles=50', 'reps=2', 'runner.n_jobs=1', 'runner.out={tmp_path}'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert [line for line in done.stderr.splitlines() if "numba" in line] == [
        "numba is not installed: estimators run in NumPy, particle filters about 50 times slower; to install it: pip install numba"
    ]


def test_the_kernels_number_measurement_models_as_the_filters_do():
    assert [getattr(SMALL, name.upper()) for name in KINDS] == [0, 1, 2]


@pytest.mark.parametrize(
    ("module", "kernels_"),
    [
        (
            "filters.particle",
            (
                "particle",
                "particle_likelihood",
                "particle_resampling",
                "particle_sums",
                "philox",
                "single",
                "compile",
            ),
        ),
        ("filters.kalman", ("kalman", "square_root", "angles", "small", "compile")),
        ("filters.access_nodes", ("access_nodes", "square_root", "angles", "compile")),
        ("estimators.maximum_likelihood", ("snapshot", "angles", "small", "compile")),
        ("estimators.discrepancy", ("discrepancy", "ellipses", "angles", "small", "compile")),
    ],
)
def test_results_are_keyed_on_the_kernels_source(module, kernels_):
    """They are loaded by name, so the key of stored results must see them and what they share."""
    names = parsed(f"aoabench.{module}", source(f"aoabench.{module}")).names
    found = reach([(f"aoabench.{module}", name) for name in names])
    assert {f"aoabench.kernels.{name}" for name in kernels_} <= set(found.sources)


LIBM = re.compile(
    r"\$(?:atan2?|exp2?|expm1|log|log2|log10|log1p|sin|cos|sincos|tan|sqrt|floor|ceil|rint|pow|hypot)f?\b"
)


def test_the_machine_code_is_vectorised(tmp_path):
    """Loops over particles work on whole vector registers and call nothing, where the CPU has AVX2
    or better.
    """
    kernels = ("philox.normals", "particle_likelihood.loglik", "particle.lap")
    for name, text in assembly(kernels, tmp_path).items():
        arithmetic = r"\bv(?:f?n?m(?:add|sub)\w*|add|sub|mul|div|sqrt)"
        packed = len(re.findall(arithmetic + r"ps\s.*%[yz]mm", text))
        scalar = len(re.findall(arithmetic + r"ss\s", text))
        assert f"%{vector_registers()}" in text, name
        # each loop has its vector version; the scalar one beside it is for arrays that overlap
        assert packed >= max(scalar, 40), (name, packed, scalar)
        assert not LIBM.findall(text), name
        assert "gather" not in text, name  # several times slower than the loads that it replaces
    assert LIBM.findall("movabsq $atan2f, %rax")
