"""Fixes without a measurement and imprecise fixes against plain slow rewrites, and reasons."""

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from aoabench.config.compose import compose_cells
from aoabench.engine import metrics
from aoabench.engine.block import run_block
from aoabench.engine.inputs import Inputs
from aoabench.engine.tiles import checked
from aoabench.errors import UserError
from aoabench.roles import Estimator
from aoabench.types import Anchors, Batch, Estimates, Outcome, Reason


def batch(position, shape, **arrays):
    B = np.shape(position)[-2]
    rotation = np.broadcast_to(np.eye(3), (*np.shape(position)[:-1], 3, 3))
    angles = {name: np.zeros((*shape, B)) for name in ("azimuth", "elevation")}
    return Batch(**(angles | arrays), anchors=Anchors(np.asarray(position, float), rotation))


def slow_imprecise(fix, P, outcome, anchors):
    """The definition, one fix at a time."""
    if outcome in (Outcome.FAILED, Outcome.REJECTED):
        return False
    axes = [0, 1] if np.isnan(fix[2]) or np.isnan(P[2, 2]) else [0, 1, 2]
    P = P[np.ix_(axes, axes)]
    if np.isinf(P).any():
        return True
    if np.isnan(P).any():
        return False
    extent = max((np.linalg.norm(a - b) for a, b in combinations(anchors, 2)), default=0.0)
    away = fix - anchors.mean(axis=0)
    away = np.linalg.norm(away[:2] if np.isnan(away[2]) else away)
    largest = linalg.eigh(P, eigvals_only=True)[-1]
    return np.sqrt(max(largest, 0.0)) > max(extent, away)


@pytest.mark.parametrize("B", [1, 4])
def test_imprecise_is_its_definition(B, rng):
    R, T = 6, 40
    anchors = rng.normal(0, 2, (R, 1, B, 3))
    A = rng.normal(0, 1, (R, T, 3, 3)) * np.exp(rng.uniform(-3, 4, (R, T, 1, 1)))
    P = A @ A.swapaxes(-1, -2)
    position = rng.normal(0, 3, (R, T, 3))
    position[rng.random((R, T)) < 0.3, 2] = np.nan
    for value, entry in ((np.nan, (0, 0)), (np.nan, (2, 2)), (np.inf, (1, 1)), (np.inf, (2, 2))):
        P[rng.random((R, T)) < 0.1, *entry] = value
    outcome = rng.integers(0, 5, (R, T)).astype(np.int8)
    found = Inputs.of(batch(anchors, (R, T))).imprecise(Estimates(position, P, None, outcome))
    wanted = [
        [slow_imprecise(position[r, t], P[r, t], outcome[r, t], anchors[r, 0]) for t in range(T)]
        for r in range(R)
    ]
    assert np.array_equal(found, wanted)
    assert 0.1 < found.mean() < 0.9


def test_imprecise_where_a_covariance_is_not_positive_definite_and_without_any():
    """The norm of such a covariance exceeds its largest eigenvalue."""
    inputs = Inputs.of(batch([[0, 0, 0], [4.0, 0, 0]], (1, 2)))
    P = np.array([[np.diag([-400.0, 1, 1]), np.diag([-1.0, 17, 0])]])
    estimates = Estimates(np.ones((1, 2, 3)), P, None, np.zeros((1, 2), dtype=np.int8))
    assert inputs.imprecise(estimates).tolist() == [[False, True]]
    assert not inputs.imprecise(replace(estimates, covariance=None)).any()


def test_imprecise_is_the_same_in_a_national_grid_and_in_other_units(rng):
    """Positions are multiples of 1/64 m, which a shift by 2^22 m keeps."""
    anchors, P = rng.normal(0, 0.5, (1, 1, 3, 3)), np.tile(np.diag([9.0, 1, 1]), (1, 50, 1, 1))
    anchors = np.round(anchors * 64) / 64
    position = np.round(rng.normal(0, 3, (1, 50, 3)) * 64) / 64
    outcome = np.zeros((1, 50), dtype=np.int8)
    results = []
    for shift, scale in ((0.0, 1.0), (2.0**22, 1.0), (0.0, 1024.0)):
        inputs = Inputs.of(batch(scale * anchors + shift, (1, 50)))
        moved = Estimates(scale * position + shift, scale**2 * P, None, outcome)
        results.append(inputs.imprecise(moved).tolist())
    assert results[0] == results[1] == results[2]
    assert 0 < np.mean(results[0]) < 1


def test_a_fix_is_unmeasured_without_an_angle_and_a_delay_of_any_anchor():
    nothing = np.full((1, 4, 2), np.nan)
    azimuth, elevation, delay, rssi = (nothing.copy() for _ in range(4))
    azimuth[0, 0, 1] = elevation[0, 1, 0] = delay[0, 2, 0] = rssi[0, 3, 1] = 1.0
    given = {"azimuth": azimuth, "elevation": elevation, "rssi": rssi}
    anchors = np.zeros((2, 3))
    both = [Inputs.of(batch(anchors, (1, 4), **given, **d)) for d in ({}, {"delay": delay})]
    assert both[0].unmeasured.tolist() == [[False, False, True, True]]
    assert both[1].unmeasured.tolist() == [[False, False, False, True]]


def test_times_are_the_batchs_and_nan_where_it_has_none():
    given = batch(np.zeros((2, 3)), (2, 3), time=np.array([[0.5, 1.0, 4.0]]))
    assert Inputs.of(given).time.tolist() == [[0.5, 1.0, 4.0]] * 2
    assert np.isnan(Inputs.of(batch(np.zeros((2, 3)), (2, 3))).time).all()


def estimates(outcome, reason=None, position=0.0):
    outcome = np.asarray(outcome, dtype=np.int8)
    return Estimates(np.full((*outcome.shape, 3), position), None, None, outcome, reason=reason)


def test_every_fix_that_is_not_ok_has_a_reason():
    ok, rejected, failed = Outcome.OK, Outcome.REJECTED, Outcome.FAILED
    none = estimates([[ok, rejected, failed]])
    assert checked(none, (1, 3), "x").reason.tolist() == [[0, Reason.NOT_STATED, Reason.NOT_STATED]]
    stated = np.array([[Reason.BEHIND, Reason.BEHIND, Reason.NONE]])
    given = replace(none, reason=stated)
    assert checked(given, (1, 3), "x").reason.tolist() == [[0, Reason.BEHIND, Reason.NOT_STATED]]
    lost = checked(estimates([[ok, failed]], position=np.nan), (1, 2), "x")
    assert lost.outcome.tolist() == [[failed, failed]]
    assert lost.reason.tolist() == [[Reason.NOT_A_NUMBER, Reason.NOT_STATED]]


@pytest.mark.parametrize(("reason", "words"), [
    (np.zeros((1, 2)), "Estimates.reason must have the shape"),
    (np.full((1, 3), 99), "Estimates.reason must hold values of Reason"),
])  # fmt: skip
def test_reasons_of_a_plug_in_are_checked(reason, words):
    with pytest.raises(UserError, match=words):
        checked(estimates([[0, 0, 4]], reason), (1, 3), "mine")


@pytest.mark.parametrize("kind", [np.int8, np.int64, float])
@pytest.mark.parametrize("value", [-1, 5])
def test_outcomes_of_a_plug_in_are_checked(value, kind):
    given = replace(estimates([[0, 0, 4]]), outcome=np.array([[0, value, 4]], dtype=kind))
    with pytest.raises(UserError, match=r"Estimates\.outcome must hold values of Outcome"):
        checked(given, (1, 3), "mine")


def test_the_commonest_reason_of_a_replication_and_the_counts(rng):
    outcome = rng.choice([0, 1, 3, 4], size=(30, 12), p=[0.4, 0.2, 0.2, 0.2]).astype(np.int8)
    outcome[3] = 0
    reason = np.where(outcome > 0, rng.integers(1, 16, outcome.shape), 0)
    given = estimates(outcome, reason)
    names = metrics.per_replication(given, np.zeros((30, 12, 3)))["reason"]
    for row, name in zip(reason, names):
        count = np.bincount(row[row > 0], minlength=16)
        assert name == ("" if not count.any() else Reason(int(count.argmax())).name.lower())
    found = metrics.reason_counts(given)
    plain = {}
    for (r, t), o in np.ndenumerate(outcome):
        if o:
            key = r, Outcome(int(o)).name.lower(), Reason(int(reason[r, t])).name.lower()
            plain[key] = plain.get(key, 0) + 1
    keys = zip(found["replication"].tolist(), found["outcome"], found["reason"])
    assert dict(zip(keys, found["n"].tolist())) == plain
    assert all(len(v) == 0 for v in metrics.reason_counts(estimates([[0, 0]])).values())


@dataclass(frozen=True)
class Late(Estimator):
    """Raises in every tile from replication 8 on."""

    inner: Any
    tile = 8
    needs = frozenset()

    def __call__(self, batch, scenario, streams):
        if max(streams.replications) >= 8:
            raise ArithmeticError("late")
        return self.inner(batch, scenario, streams)


@pytest.mark.parametrize("start", [0, 4, 8])
def test_a_tile_whose_replications_all_raise_leaves_the_others_alone(start):
    """The EKF's covariance is missing in such a tile only."""
    cell = compose_cells(["filter=[ekf_vmf]"])[0]
    both = {"ekf": cell.estimators["ekf_vmf"], "late": Late(cell.estimators["ekf_vmf"])}
    block = run_block(cell.scenario, cell.noise, both, 1, start, 16, steps=True)
    rows, theirs = block["late"]["rows"], block["ekf"]["rows"]
    good = rows["replication"] < 8
    for name in ("rmse_3d_m", "nees"):
        assert np.array_equal(rows[name][good], theirs[name][good])
        assert np.isnan(rows[name][~good]).all()
    assert set(rows["reason"][~good]) == {"exception"}
    found = block["late"]["reasons"]
    assert found["replication"].tolist() == list(range(8, 16))
    assert set(zip(found["outcome"], found["reason"], found["n"])) == {("failed", "exception", 64)}
    assert "reasons" not in block["ekf"]
    steps = block["ekf"]["steps"]
    assert np.allclose(steps["sigma_x_m"] ** 2, steps["cov_xx_m2"])
    assert np.array_equal(steps["time_s"][:64], cell.scenario.times(64))
    assert {value for name in ("tag", "fix") for value in steps[name]} == {None}
    assert np.isnan(steps["score"]).all()
