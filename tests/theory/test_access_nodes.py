"""EKF at access nodes and weighted centroid: the textbook's update, finite differences, kernel and
NumPy, errata.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.linalg import block_diag

from aoabench.errors import BadValue, Unfit
from aoabench.estimators.centroid import WeightedCentroid
from aoabench.filters import access_nodes as an
from aoabench.filters.belief import believed
from aoabench.filters.heard import heard_alone
from aoabench.kernels.access_nodes import LEAST_VARIANCE
from aoabench.maths.geometry import LIGHT, wrap
from aoabench.models import components
from aoabench.models.motion import ConstantAcceleration
from aoabench.types import Anchors, Batch, Outcome
from tests.helpers import Place
from tests.theory.rounding import equal_but_for_rounding, moved_by_rounding

B = 7
SUBSETS = [s for n in range(5) for s in combinations(an.PRINTED, n)]


def upright(rng, n):
    turn = rng.uniform(-np.pi, np.pi, n)
    c, s, zero, one = np.cos(turn), np.sin(turn), np.zeros(n), np.ones(n)
    return np.stack(
        [np.stack(r, -1) for r in ((c, s, zero), (-s, c, zero), (zero, zero, one))], axis=-2
    )


@pytest.fixture
def anchors(rng):
    position = np.concatenate(
        [rng.uniform(-10, 10, (1, B, 2)), rng.uniform(2, 3, (1, B, 1))], axis=-1
    )
    return Anchors(position, upright(rng, B)[None], np.broadcast_to([0.5, 0.5, 0.05], (1, B, 3)))


def test_derivatives_are_finite_differences(anchors, rng):
    """Of range, azimuth and elevation by the position; by the AN's own position they are the
    opposite.
    """
    x, e = rng.uniform(-5, 5, (4, 3)), 1e-6
    _, H = an.expected(x, anchors)
    for q, step in enumerate(e * np.eye(3)):
        for sign, (a, b) in {
            1: ((x + step, anchors), (x - step, anchors)),
            -1: (
                (x, Anchors(anchors.position + step, anchors.rotation)),
                (x, Anchors(anchors.position - step, anchors.rotation)),
            ),
        }.items():
            d = an.expected(*a)[0] - an.expected(*b)[0]
            d[..., 1] = wrap(d[..., 1])
            assert np.allclose(d / (2 * e), sign * H[..., q], rtol=1e-5, atol=1e-7)


def test_printed_derivatives_differ_by_their_denominators(anchors, rng):
    """U1: by d / d_2D for the elevation squared, by d_2D for the azimuth."""
    x = rng.uniform(-5, 5, (4, 3))
    h, H = an.expected(x, anchors)
    _, P = an.expected(x, anchors, printed=True)
    rho, d = h[..., 0] * np.cos(h[..., 2]), h[..., 0]
    assert np.allclose(P[..., 1, :], H[..., 1, :] * rho[..., None])
    assert np.allclose(P[..., 2, 2], H[..., 2, 2] * (d / rho) ** 2)
    assert np.allclose(P[..., 0, :], H[..., 0, :])


def textbook(x, y, q, anchors, C, flags):
    """Stacked H, residual and the whole R, missing rows left out [(18), (20)-(24)]."""
    jacobian, unwrapped, shared, apart = flags
    h, H = (a[0] for a in an.expected(x[None], anchors, jacobian))
    v = y - h
    if unwrapped:
        turn = np.arctan2(anchors.rotation[0, 0, :, 0, 1], anchors.rotation[0, 0, :, 0, 0])
        v[:, 1] = wrap(y[:, 1] + turn) - wrap(h[:, 1] + turn)
    else:
        v[:, 1] = wrap(v[:, 1])
    rows = [(b, i) for b in range(len(y)) for i in range(3) if np.isfinite(y[b, i])]
    R = np.diag([q[b, i] for b, i in rows])
    for m, (a, i) in enumerate(rows):
        for n, (b, j) in enumerate(rows):
            time_and_angle = (i == 0) != (j == 0)
            if (shared or a == b) and not (apart and time_and_angle):
                R[m, n] += H[a, i] @ (C[b] * H[b, j])
    return np.array([H[b, i] for b, i in rows]), np.array([v[b, i] for b, i in rows]), R


@pytest.mark.parametrize("printed", SUBSETS, ids="-".join)
def test_update_is_the_textbooks(printed, anchors, rng):
    """One step of the filter against K = P H^T (H P H^T + R)^-1 with stacked matrices, any errata
    as printed.
    """
    flags = tuple(name in printed for name in an.PRINTED)
    C = np.tile([0.25, 0.25, 0.0025], (B, 1))
    x = np.concatenate([rng.uniform(-3, 3, (1, 3)), rng.normal(size=(1, 6))], axis=-1)
    L = rng.normal(size=(9, 9))
    P = 0.1 * L @ L.T
    h, _ = an.expected(x[:, :3], anchors)
    y = h[0] + rng.normal(size=(B, 3)) * [1.0, 0.05, 0.05]
    y[:, 1] = wrap(y[:, 1])
    y[1, 0] = y[2, 1] = np.nan
    y[3] = np.nan
    q = rng.uniform(0.5, 2, (B, 3)) * [9.0, 1e-3, 1e-3]
    H, v, R = textbook(x[0, :3], y, q, anchors, C, flags)
    G = np.concatenate([H, np.zeros((len(H), 6))], axis=1)
    K = np.linalg.solve(G @ P @ G.T + R, G @ P).T
    mean, cov = x[0] + K @ v, P - K @ G @ P
    A, g, _ = an.information(x[:, :3], y[None], q[None], anchors, C[None], flags)
    W = np.linalg.solve(np.eye(3) + A[0] @ P[:3, :3], np.column_stack([A[0], g[0]]))
    assert np.allclose(x[0] + P[:, :3] @ W[:, 3], mean, atol=1e-9)
    assert np.allclose(P - P[:, :3] @ W[:, :3] @ P[:3], cov, atol=1e-9)


def track(rng, anchors, R=11, T=40, missing=0.3):
    """A straight walk among the anchors, their measurements and what a filter starts from."""
    F, _ = ConstantAcceleration(0.1).matrices(0.1)
    x = np.zeros((R, T, 9))
    x[:, 0, :3], x[:, 0, 3:6] = (
        rng.uniform(-3, 3, (R, 3)) * [1, 1, 0.1],
        rng.uniform(-1, 1, (R, 3)) * [1, 1, 0.1],
    )
    for k in range(1, T):
        x[:, k] = x[:, k - 1] @ F.T
    h, _ = an.expected(x[..., :3].reshape(-1, 3), Anchors(anchors.position, anchors.rotation))
    sigma = np.array([3.0, 0.01, 0.01])
    y = h.reshape(R, T, B, 3) + sigma * rng.normal(size=(R, T, B, 3))
    y[rng.random((R, T, B)) < missing] = np.nan
    y[:, 5] = np.nan  # a step without any
    known = anchors.position + anchors.position_sigma * rng.normal(size=(R, 1, B, 3))
    batch = Batch(
        wrap(y[..., 1]), y[..., 2], Anchors(known, anchors.rotation, anchors.position_sigma), delay=y[..., 0] / LIGHT,
        azimuth_sigma=np.full((R, T, B), sigma[1]), elevation_sigma=np.full((R, T, B), sigma[2]),
        delay_sigma=np.full((R, T, B), sigma[0] / LIGHT),
        prior_mean=x[:, 0] + rng.normal(size=(R, 9)) * ([1, 1, 0.1] + [0.3] * 6),
        prior_cov=np.diag([1, 1, 0.01] + [0.09] * 6),
    )  # fmt: skip
    return x, batch, Place(anchors, motion=ConstantAcceleration(0.1), dt=0.1)


@pytest.mark.parametrize("toa", [True, False])
@pytest.mark.parametrize("printed", SUBSETS, ids="-".join)
def test_the_kernel_equals_numpy(toa, printed, anchors, rng):
    """A full tile of replications and one that is not, a step without any measurement."""
    _, batch, scenario = track(rng, anchors, R=33, T=12)
    fast, slow = (
        an.AccessNodeEKF(toa, printed, engine=e)(batch, scenario, None) for e in ("auto", "numpy")
    )
    moved = moved_by_rounding(lambda b: an.AccessNodeEKF(toa, printed)(b, scenario, None), batch)
    equal_but_for_rounding(fast, slow, moved)
    assert np.array_equal(fast.outcome, slow.outcome)


def moving(rng, anchors, R, T, each):
    """The anchors with positions, rotations and deviations of each step; with `each`, of each
    replication as well.
    """
    shape = (R if each else 1, T, B)
    position = anchors.position[:1] + 0.3 * rng.normal(size=(*shape, 3))
    rotation = upright(rng, shape)
    return Anchors(position, rotation, rng.uniform(0.1, 0.6, (*shape, 3)))


@pytest.mark.parametrize("each", [True, False])
@pytest.mark.parametrize("printed", [(), ("wrap",), ("cross", "shared")], ids="-".join)
def test_the_kernel_equals_numpy_for_anchors_that_move(printed, each, anchors, rng):
    _, batch, scenario = track(rng, anchors, R=5, T=12)
    batch = replace(batch, anchors=moving(rng, anchors, 5, 12, each))
    fast, slow = (
        an.AccessNodeEKF(True, printed, engine=e)(batch, scenario, None) for e in ("auto", "numpy")
    )
    moved = moved_by_rounding(lambda b: an.AccessNodeEKF(True, printed)(b, scenario, None), batch)
    equal_but_for_rounding(fast, slow, moved)
    still = replace(batch, anchors=batch.anchors.at(0).of(0))
    other = an.AccessNodeEKF(True, printed)(still, scenario, None)
    assert not np.allclose(fast.position, other.position, atol=1e-3)


@pytest.mark.parametrize("engine", ["auto", "numpy"])
def test_anchors_of_each_step_are_those_of_the_step(engine, anchors, rng):
    """A replication with anchors that move equals, step by step, filters of the anchors that stand
    where it has them, begun from the belief before the step.
    """
    T = 6
    _, batch, scenario = track(rng, anchors, R=1, T=T)
    batch = replace(batch, anchors=moving(rng, anchors, 1, T, False))
    filters = an.AccessNodeEKF(engine=engine)
    whole = filters(batch, scenario, None)
    for k in range(T):  # all steps up to k with the anchors of step k: step 0 alone is the same
        at = replace(batch, anchors=batch.anchors.at(k))
        same = np.array_equal(filters(at, scenario, None).position[:, 0], whole.position[:, 0])
        assert same == (k == 0)


@pytest.mark.parametrize("engine", ["auto", "numpy"])
@pytest.mark.parametrize("printed", [(), ("shared",), ("wrap", "cross")], ids="-".join)
def test_batches_of_heard_nodes_give_the_bits_of_those_of_all(printed, engine, anchors, rng):
    """Each step hears two or three of the seven, node 0 hardly ever; outcomes, trace and
    innovations' degrees of freedom are the same.
    """
    _, batch, scenario = track(rng, anchors, R=3, T=20, missing=0.0)
    heard = np.stack([np.isin(np.arange(B), rng.choice(B, 2 + k % 2, False)) for k in range(20)])
    arrays = {
        n: np.where(heard, getattr(batch, n), np.nan) for n in ("azimuth", "elevation", "delay")
    }
    whole = replace(batch, **arrays)
    few = heard_alone(whole)
    assert few.azimuth.shape[2] == 3
    assert few.layout is whole.anchors
    assert heard_alone(few) is few
    filters = an.AccessNodeEKF(
        True, printed, engine=engine, innovation_tail=0.1, innovation_steps=1
    )
    found, other = filters(few, scenario, None), filters(whole, scenario, None)
    all_seven = filters.filtered(whole, believed(whole, scenario))  # no place is left out
    assert np.array_equal(found.position, all_seven.position)
    assert np.array_equal(found.covariance, all_seven.covariance)
    three = filters.filtered(few, believed(few, scenario))
    assert np.allclose(three.nis, all_seven.nis, rtol=1e-12, atol=0)  # NumPy adds in pairs
    assert np.array_equal(three.measured, all_seven.measured)
    assert np.array_equal(found.position, other.position)
    assert np.array_equal(found.outcome, other.outcome)
    assert (found.outcome == Outcome.DIVERGED).any()
    traces = [filters.trace(b, scenario, None) for b in (few, whole)]
    assert len(traces[0]) == 3 * B
    for name, values in traces[0].items():
        assert np.array_equal(values, traces[1][name], equal_nan=True)


def test_unusable_deviations_are_not_measured(anchors, rng):
    """Of 0, infinite, negative, NaN, or too small to square; and the least variance is kept."""
    _, batch, scenario = track(rng, anchors, R=5, T=8)
    for name, bad in zip(("azimuth", "elevation", "delay"), (0.0, np.inf, np.nan)):
        getattr(batch, f"{name}_sigma")[0, 3, :2] = bad
        getattr(batch, f"{name}_sigma")[1, 2, 2] = 1e-180
    batch.azimuth_sigma[2, 4, 1] = 1e-17
    without = replace(batch, **{
        name: np.where(batch_usable(getattr(batch, f"{name}_sigma")), getattr(batch, name), np.nan)
        for name in ("azimuth", "elevation", "delay")
    })  # fmt: skip
    assert batch_usable(batch.azimuth_sigma)[2, 4, 1]
    for engine in ("auto", "numpy"):
        filters = an.AccessNodeEKF(engine=engine)
        found, expected = filters(batch, scenario, None), filters(without, scenario, None)
        assert np.isfinite(found.position).all()
        assert np.array_equal(found.position, expected.position)
    assert LEAST_VARIANCE == components.LEAST_VARIANCE


def batch_usable(sigma):
    with np.errstate(invalid="ignore"):
        return (sigma > 1e-160) & (sigma < np.inf)


def seen(x, s, R):
    """Range, azimuth and elevation (3,) of a position x (3,) from an access node at s with rotation R."""
    u, v, w = R @ (x - s)
    return np.array(
        [np.sqrt(u * u + v * v + w * w), np.arctan2(v, u), np.arctan2(w, np.hypot(u, v))]
    )


def slopes(x, s, R, step=1e-5):
    """Derivatives (3, 3) of `seen` by the position, central differences."""
    columns = [seen(x + e, s, R) - seen(x - e, s, R) for e in step * np.eye(3)]
    for column in columns:
        column[1] = wrap(column[1])
    return np.stack(columns, axis=-1) / (2 * step)


def plain_ekf(batch, scenario, i, toa):
    """Replication i by the textbook's EKF: K = P H^T (H P H^T + R)^-1 over everything measured.

    R holds the measurements' variances and, node by node, H C H^T of the position's own [(18),
    (20)-(24), errata applied].
    """
    F, Q = scenario.motion.matrices(scenario.dt)
    x, P, known = batch.prior_mean[i], batch.prior_cov, batch.anchors
    found = []
    for k in range(batch.azimuth.shape[1]):
        x, P = F @ x, F @ P @ F.T + Q
        rows, v, blocks = [], [], []
        for b in range(batch.azimuth.shape[2]):
            s, R = known.position[i, 0, b], known.rotation[0, 0, b]
            y = np.array(
                [LIGHT * batch.delay[i, k, b], batch.azimuth[i, k, b], batch.elevation[i, k, b]]
            )
            sigma = np.array([LIGHT * batch.delay_sigma[i, k, b], batch.azimuth_sigma[i, k, b], batch.elevation_sigma[i, k, b]])  # fmt: skip
            use = np.isfinite(y) & (toa | (np.arange(3) > 0))
            H, d = slopes(x[:3], s, R), y - seen(x[:3], s, R)
            d[1] = wrap(d[1])
            full = np.diag(sigma**2) + H @ np.diag(known.position_sigma[0, 0, b] ** 2) @ H.T
            rows.append(H[use])
            v.append(d[use])
            blocks.append(full[np.ix_(use, use)])
        if sum(map(len, v)):
            H = np.concatenate(rows)
            H = np.concatenate([H, np.zeros((len(H), len(x) - 3))], axis=1)
            K = np.linalg.solve(H @ P @ H.T + block_diag(*blocks), H @ P).T
            x, P = x + K @ np.concatenate(v), P - K @ H @ P
        found.append((x[:3], P[:3, :3]))
    return tuple(np.array(a) for a in zip(*found))


@pytest.mark.parametrize("engine", ["auto", "numpy"])
@pytest.mark.parametrize("toa", [True, False])
def test_the_filter_is_a_plain_ekf_that_knows_of_the_nodes_uncertainty(toa, engine, rng):
    """Each node with deviations of its own; the same filter told of exact nodes is another one.

    Two nodes have their backs to the walk: azimuths jump between -pi and pi.
    """
    position = np.concatenate([rng.uniform(-10, 10, (1, B, 2)), rng.uniform(2, 3, (1, B, 1))], -1)
    position[0, :2, :2] = [[0.0, 12.0], [12.0, 0.0]]
    rotation, sigma = upright(rng, B), rng.uniform(0.1, 1.0, (1, B, 3))
    rotation[:2] = [[[0, 1, 0], [-1, 0, 0], [0, 0, 1]], np.eye(3)]
    _, batch, scenario = track(rng, Anchors(position, rotation[None], sigma), R=3, T=12)
    assert np.nanmin(batch.azimuth[..., :2]) < -3 < 3 < np.nanmax(batch.azimuth[..., :2])
    found = an.AccessNodeEKF(toa, engine=engine)(batch, scenario, None)
    for i in range(3):
        mean, covariance = plain_ekf(batch, scenario, i, toa)
        assert np.allclose(found.position[i], mean, rtol=0, atol=1e-6)
        assert np.allclose(found.covariance[i], covariance, rtol=1e-5, atol=1e-7)
    exact = replace(batch, anchors=replace(batch.anchors, position_sigma=None))
    sure = an.AccessNodeEKF(toa, engine=engine)(exact, scenario, None)
    trace, less = (np.trace(e.covariance, axis1=-2, axis2=-1) for e in (found, sure))
    assert np.all(less[:, 1:] < 0.9 * trace[:, 1:])


def test_the_filter_follows_the_walk_and_knows_how_well(anchors, rng):
    """Mean error below a metre, and smaller with times than without; positive covariances."""
    x, batch, scenario = track(rng, anchors, R=64)
    rmse = {}
    for toa in (True, False):
        found = an.AccessNodeEKF(toa)(batch, scenario, None)
        assert np.all(found.outcome == Outcome.OK)
        assert np.linalg.eigvalsh(found.covariance).min() > 0
        rmse[toa] = np.sqrt(((found.position - x[..., :3])[:, 20:] ** 2).sum(-1).mean())
    assert rmse[True] < rmse[False] < 1.0


@pytest.mark.parametrize("engine", ["auto", "numpy"])
def test_angles_without_stated_deviations_have_those_of_the_filter(engine, anchors, rng):
    _, batch, scenario = track(rng, anchors, R=3, T=6)
    method = an.AccessNodeEKF(toa=False, unstated_deg=(4.0, 9.0), engine=engine)
    each = np.ones_like(batch.azimuth)
    sigmas = {"azimuth_sigma": np.deg2rad(4) * each, "elevation_sigma": np.deg2rad(9) * each}
    stated = method(replace(batch, **sigmas), scenario, None)
    bare = method(replace(batch, **dict.fromkeys(sigmas)), scenario, None)
    assert np.array_equal(bare.position, stated.position)
    assert np.array_equal(bare.covariance, stated.covariance)


def test_bad_input_is_named(anchors, rng):
    _, batch, scenario = track(rng, anchors)
    for bad in (
        {"toa": "yes"},
        {"as_printed": "wrap"},
        {"as_printed": ["wrong"]},
        {"engine": "fast"},
    ):
        with pytest.raises(BadValue):
            an.AccessNodeEKF(**bad)
    without = Batch(
        batch.azimuth,
        batch.elevation,
        batch.anchors,
        prior_mean=batch.prior_mean,
        prior_cov=batch.prior_cov,
    )
    with pytest.raises(Unfit, match="ofdm_crlb"):
        an.AccessNodeEKF()(without, scenario, None)
    with pytest.raises(Unfit, match="ofdm_crlb"):
        WeightedCentroid()(without, scenario, None)


def test_centroid_of_exact_measurements_is_the_position_and_of_others_the_weighted_mean(
    anchors, rng
):
    x = rng.uniform(-3, 3, (2, 5, 3))
    h, _ = an.expected(x.reshape(-1, 3), anchors)
    h = h.reshape(2, 5, B, 3)
    sigma = rng.uniform(1e-9, 1e-8, (2, 5, B))
    exact = Batch(h[..., 1], h[..., 2], anchors, delay=h[..., 0] / LIGHT, delay_sigma=sigma)
    assert np.allclose(WeightedCentroid()(exact, None, None).position, x)
    delay = exact.delay + sigma * rng.normal(size=sigma.shape)
    delay[0, 0], delay[1, 2, :4] = np.nan, np.nan
    found = WeightedCentroid()(
        Batch(h[..., 1], h[..., 2], anchors, delay=delay, delay_sigma=sigma), None, None
    )
    assert (found.outcome == Outcome.FAILED).sum() == 1
    assert found.outcome[0, 0] == Outcome.FAILED
    slow = np.zeros(3)
    for b in range(4, B):  # (12) with the azimuth of the wall subtracted, (13), (14)
        R, (_, a, e) = anchors.rotation[0, 0, b], h[1, 2, b]
        theta = a + np.arctan2(R[0, 1], R[0, 0])
        r = LIGHT * delay[1, 2, b]
        one = anchors.position[0, 0, b] + r * np.array(
            [np.cos(e) * np.cos(theta), np.cos(e) * np.sin(theta), np.sin(e)]
        )
        slow += one / sigma[1, 2, b] ** 2
    assert np.allclose(found.position[1, 2], slow / (1 / sigma[1, 2, 4:] ** 2).sum())
    assert not np.allclose(
        WeightedCentroid(as_printed=True)(exact, None, None).position, x, atol=0.1
    )
