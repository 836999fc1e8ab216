"""A good estimator, and what breaks single rules."""

import os
from dataclasses import dataclass, field, replace
from itertools import count

import numpy as np

from aoabench import Estimates, Estimator, KalmanFilter, Outcome
from aoabench.maths.geometry import to_unit


@dataclass(frozen=True)
class Lines(Estimator):
    """The point nearest to all lines of sight, by least squares."""

    uses = frozenset({"elevation"})

    @property
    def needs(self):
        return frozenset({"elevation"})

    def __call__(self, batch, scenario, streams):
        s = batch.anchors.position
        centre = s.mean(axis=2)
        u = to_unit(batch.azimuth, batch.elevation)
        u = np.einsum("...ji,...j->...i", batch.anchors.rotation, u)
        P = np.eye(3) - u[..., :, None] * u[..., None, :]
        P = np.where(np.isnan(P), 0.0, P)
        A = P.sum(axis=2)
        g = (P @ (s - centre[:, :, None])[..., None]).sum(axis=2)
        good = np.linalg.eigvalsh(A)[..., 0] > 1e-3
        p = np.linalg.solve(np.where(good[..., None, None], A, np.eye(3)), g)[..., 0] + centre
        p = np.where(good[..., None], p, np.nan)
        return Estimates(p, None, None, np.where(good, Outcome.OK, Outcome.FAILED))


def changed(**how):
    """The class of `Lines` whose estimates a function of (self, found, batch, scenario, streams)
    changes, or whose members are others.
    """
    after = how.pop("after", None)

    def call(self, batch, scenario, streams):
        found = Lines.__call__(self, batch, scenario, streams)
        return found if after is None else after(self, found, batch, scenario, streams)

    return type("Changed", (Lines,), {"__module__": __name__, "__call__": call, **how})()


def moved(found, by):
    return replace(found, position=found.position + by)


def covariance(matrix):
    def after(self, found, batch, scenario, streams):
        return replace(found, covariance=np.broadcast_to(matrix, (*found.outcome.shape, 3, 3)))

    return after


def in_place(self, found, batch, scenario, streams):
    if batch.azimuth.flags.writeable:
        batch.azimuth[:] = 0.0
    return found


def in_first_order(self, found, batch, scenario, streams):
    return moved(found, 0.01 * np.nan_to_num(batch.azimuth[..., :1]))


def of_neighbour(self, found, batch, scenario, streams):
    return moved(found, 1e-3 * np.nansum(found.position))


def smoothed(self, found, batch, scenario, streams):
    return moved(found, 0.01 * np.nan_to_num(found.position[:, -1:]))


def with_truth(self, found, batch, scenario, streams):
    scenario.truth(np.random.default_rng(1))
    return found


def with_true_anchors(self, found, batch, scenario, streams):
    return moved(
        found,
        0.1 * scenario.true_anchors.position.mean(axis=2)
        - 0.1 * batch.anchors.position.mean(axis=2),
    )


def still(self, found, batch, scenario, streams):
    """Uses the first step's anchors."""
    first = replace(batch, anchors=batch.anchors.at(0))
    return Lines.__call__(self, first, scenario, streams)


def first_rotations(self, found, batch, scenario, streams):
    """Uses the rotations of the first replication for all."""
    at = batch.anchors
    rotation = np.repeat(at.rotation[:1], len(at.rotation), axis=0)
    position = np.repeat(at.position[:1], len(at.position), axis=0)
    return Lines.__call__(
        self,
        replace(batch, anchors=replace(at, rotation=rotation, position=position)),
        scenario,
        streams,
    )


def claims(self, found, batch, scenario, streams):
    return replace(found, outcome=np.zeros_like(found.outcome))


def middle(self, found, batch, scenario, streams):
    """Answers the middle of the anchors where it knows nothing."""
    nothing = np.isnan(batch.azimuth).all(axis=2)
    p = np.where(nothing[..., None], batch.anchors.position.mean(axis=2), found.position)
    return replace(found, position=p, outcome=np.where(nothing, 0, found.outcome))


def brittle(self, found, batch, scenario, streams):
    if np.isnan(batch.azimuth).any():
        raise ValueError("array must not contain infs or NaNs")
    return found


def afraid_of_poles(self, found, batch, scenario, streams):
    if (np.abs(batch.elevation) > 1.57).any():
        raise ZeroDivisionError("division by zero")
    return found


def mean_azimuth(self, found, batch, scenario, streams):
    """Averages azimuths without regard to their jump."""
    return moved(found, 0.01 * np.nanmean(np.nan_to_num(batch.azimuth) ** 2, axis=2)[..., None])


_calls = count()


def counting(self, found, batch, scenario, streams):
    return moved(found, 0.01 * next(_calls))


def towards_x(self, found, batch, scenario, streams):
    return moved(found, [0.1, 0, 0])


def up(self, found, batch, scenario, streams):
    return moved(found, [0, 0, 0.1])


def origin(self, found, batch, scenario, streams):
    return replace(found, position=0.99 * found.position)


def flattened(self, found, batch, scenario, streams):
    return replace(found, position=found.position[..., :2])


def weighted_by_strength(self, found, batch, scenario, streams):
    return found if batch.rssi is None else moved(found, 0.01 * batch.rssi.mean())


class Process(Lines):
    """Knows in which process it was made."""

    def __init__(self):
        object.__setattr__(self, "pid", [lambda: os.getpid()])


FAULTY = [  # rule, plug-in, words
    ("members", changed(causal="yes"), "causal is 'yes', which is not True or False"),
    ("members", changed(files="walls.csv"), "files is 'walls.csv', which is not a tuple of paths"),
    ("members", changed(uses=frozenset({"elevations"})), "among delay, elevation, rssi, stated_sigma"),
    ("values", changed(after=flattened), r"position must have the shape \(3, 16, 3\), not \(3, 16, 2\)"),
    ("covariances", changed(after=covariance(np.triu(np.ones((3, 3))))), "is not symmetric"),
    ("covariances", changed(after=covariance(np.diag([1.0, 1, -1]))), "negative eigenvalue -1 m"),
    ("missing", changed(after=brittle), "anchor that measures nothing, it raises ValueError: array must"),
    ("missing", changed(after=claims), "fixes claim a position and give NaN"),
    ("nothing", changed(after=middle), "48 of 48 such fixes have a position"),
    ("repeatable", changed(after=counting), "a second call with the same batch"),
    ("untouched", changed(after=in_place), "it changes batch.azimuth in place"),
    ("uninformed", changed(after=with_truth), "it calls scenario.truth"),
    ("uninformed", changed(after=with_true_anchors), "scenario.true_anchors, which differ .* up to 0.0374 m"),
    ("unused", changed(uses=frozenset()), "uses leaves out 'elevation', and another one changes the outcome"),
    ("unused", changed(after=weighted_by_strength, uses=frozenset({"elevation"})), "leaves out 'rssi'"),
    ("replications", changed(after=of_neighbour), "one replication alone .* changes the position"),
    ("replications", changed(after=first_rotations), "one replication alone"),
    ("moving_anchors", changed(after=still), "a step alone instead of in a track with anchors that move"),
    ("causal", changed(after=smoothed), "the second half of a track changes the position"),
    ("sendable", Process(), "it raises"),
    ("permuted", changed(after=in_first_order), "permuting the anchors changes the position by up to 0.0[0-9]+ m"),
    ("shifted", changed(after=origin), "moving the world by .* changes the position"),
    ("turned", changed(after=towards_x), "turning the world about the vertical changes the position by up to 0.178 m"),
    ("rotated", changed(after=up), "rotating the world in space changes the position by up to 0.[0-9]+ m"),
    ("azimuths", changed(after=mean_azimuth), "azimuths jump from 180 to -180 deg changes the position"),
    ("poles", changed(after=afraid_of_poles), r"elevation at \+-90 deg, it raises ZeroDivisionError"),
]  # fmt: skip


@dataclass(frozen=True)
class DenseOnly(KalmanFilter):
    """A filter that says that it takes batches of the anchors heard, and does not."""

    seen: tuple = field(default=())

    def update(self, prior, y, r, anchors):
        h, x = self.measurement, prior.mean
        v = h.residual(y, h.predict(x, anchors))
        found = prior.given(v, h.jacobian(x, anchors), h.covariance(x, anchors, r))
        return found._replace(mean=found.mean + 0.01 * anchors.count)
