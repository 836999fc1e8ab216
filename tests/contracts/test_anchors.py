"""Every estimator honours anchors that differ from replication to replication and from step to step,
in position, orientation and stated deviation.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from aoabench.config.compose import compose_cells
from aoabench.config.presets import options
from aoabench.engine.tiles import Draws, call
from aoabench.roles import Noise
from aoabench.types import Anchors, Batch

ESTIMATORS = [("filter", n) for n in options("filter")] + [
    ("estimator", n) for n in options("estimator")
]
ROOM = ("anchor", "discrepancy")  # parts of the names of those that need a known height
TIMES = ("toa", "wcg")  # of those that need times of arrival
R = 3


@dataclass(frozen=True)
class Uneven(Noise):
    """A noise whose anchors are known differently in each replication, in every field."""

    inner: Noise

    def offers(self):
        return self.inner.offers()

    def sample(self, rng, scenario, truth):
        return self.inner.sample(rng, scenario, truth)

    def known_anchors(self, rng, scenario):
        known = self.inner.known_anchors(rng, scenario)
        shift = 0.2 * rng.standard_normal(known.position.shape)
        sigma = np.broadcast_to(rng.uniform(0.05, 0.5), known.position.shape)
        return Anchors(known.position + shift, known.rotation, sigma)


def setting(group, name):
    words = [f"{group}=[{name}]"]
    if any(part in name for part in ROOM):
        words += ["scenario=ble_room", "noise=ble_multipath", "scenario.packets=2"]
    elif any(part in name for part in TIMES):
        words += ["scenario=square_track", "noise=ofdm_crlb"]
    else:
        words += ["scenario=square_track_upright", "noise=vmf"]
    cell = compose_cells(words)[0]
    estimator = cell.estimators[name]
    if name.startswith("pf_"):
        estimator = replace(estimator, particles=200)
    turned = replace(cell.noise, mounting_yaw_deg=10.0, mounting_pitch_deg=5.0)
    draws = Draws(cell.scenario, Uneven(turned), 1)
    truth, batch = draws.tile(0, R)
    return estimator, draws, truth, batch


def close(one, other):
    """Equal up to rounding, which a fix that wanders multiplies: 1e-6 m is far below any error."""
    assert np.array_equal(one.outcome, other.outcome)
    assert np.allclose(one.position, other.position, rtol=1e-9, atol=1e-6, equal_nan=True)
    if one.covariance is not None:
        assert np.allclose(one.covariance, other.covariance, rtol=1e-5, atol=1e-12, equal_nan=True)


@pytest.mark.parametrize(("group", "name"), ESTIMATORS)
def test_each_replication_has_its_own_anchors(group, name):
    estimator, draws, truth, batch = setting(group, name)
    for array in batch.anchors.arrays.values():
        assert len(array) == R
        assert not np.allclose(array[0], array[1], atol=1e-3)
    together = call(estimator, batch, draws, (0, 1, 2), truth)
    for i in range(R):
        alone = call(estimator, batch.of(i), draws, (i,), truth[i : i + 1])
        close(replace_rows(together, i), alone)


def replace_rows(estimates, i):
    fields = ("position", "covariance", "outcome")
    rows = {f: getattr(estimates, f) for f in fields}
    return replace(estimates, **{f: a if a is None else a[i : i + 1] for f, a in rows.items()})


@pytest.mark.parametrize(("group", "name"), ESTIMATORS)
def test_anchors_may_move_from_step_to_step(group, name):
    """Anchors repeated for every step are the anchors that stay; a snapshot estimator with other
    anchors at each step is that of each step alone.
    """
    estimator, draws, truth, batch = setting(group, name)
    T = 12
    short = shortened(batch, T)
    still = {n: np.repeat(array, T, axis=1) for n, array in short.anchors.arrays.items()}
    repeated = replace(short, anchors=Anchors(**still))
    numbers, truth = (0, 1, 2), truth[:, :T]
    close(
        call(estimator, repeated, draws, numbers, truth),
        call(estimator, short, draws, numbers, truth),
    )
    if group == "filter":
        return
    rng = np.random.default_rng(3)
    shift = 0.1 * rng.standard_normal((R, T, *still["position"].shape[2:]))
    moving = replace(short, anchors=Anchors(**still | {"position": still["position"] + shift}))
    whole = call(estimator, moving, draws, numbers, truth)
    for k in (0, 5, T - 1):
        one = replace(shortened(moving, T, k), anchors=moving.anchors.at(k))
        alone = call(estimator, one, draws, numbers, truth[:, k : k + 1])
        assert np.array_equal(whole.outcome[:, k], alone.outcome[:, 0])
        assert np.allclose(
            whole.position[:, k], alone.position[:, 0], rtol=1e-9, atol=1e-6, equal_nan=True
        )


def shortened(batch, T, k=None):
    """The first T steps of a batch, or the k-th alone."""
    of = slice(0, T) if k is None else slice(k, k + 1)
    measured = {
        name: array if array is None else array[:, of]
        for name in Batch.__dataclass_fields__
        if name not in ("anchors", "prior_mean", "prior_cov", "time", "anchor_id")
        for array in [getattr(batch, name)]
    }
    return replace(batch, time=None, **measured)
