"""EKF on times and angles of arrival at access nodes (ANs) whose own positions are uncertain [Lu
2019, (15)-(26)].

All measurements depend on the state through the position alone, so that an update needs 3 x 3
matrices only. For one AN, v (3,) is the innovation of (c delay, azimuth, elevation), H (3, 3) their
derivatives by the target's position, -H those by the AN's position, q (3,) their variances, and C
the covariance of the AN's known position. An update needs

    S = diag(q) + H C H^T,    A = sum H^T S^-1 H,    g = sum H^T S^-1 v,

with sums over the ANs, because the errors of different ANs are independent (errata U3, U4). As
printed in (23) and (24), one error is common to all ANs. It is then an additional error of the
target's position: S is without C, and A (I + C A)^-1 and (I + A C)^-1 g replace A and g.

The filter stores a square root B of its covariance, P = B B^T. With A = sum c c^T and g = sum u c,
A and g are equivalent to three scalar measurements u = c^T (position error) + e, e ~ N(0, 1).
`roots.absorb` processes these one after the other. With p for the position's rows and columns, the
result is

    x+ = x + P_:p (I + A P_pp)^-1 g,    P+ = P - P_:p (I + A P_pp)^-1 A P_p:,

which equals the update by the gain K = P H^T (H P H^T + R)^-1 with R block-diagonal over the ANs.
P+ is positive definite for any variances of the measurements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, NamedTuple

import numpy as np

from aoabench.errors import Unfit
from aoabench.filters.belief import Belief, believed
from aoabench.filters.divergence import Filtered
from aoabench.filters.heard import heard_alone
from aoabench.filters.recursion import GaussianFilter, Recursion
from aoabench.filters.roots import EPS, absorb, covariance, moved, near, predicted, prior_root
from aoabench.filters.trace import innovations
from aoabench.kernels.limits import ROUNDED
from aoabench.kernels.loading import Compiled, engine_param
from aoabench.maths.geometry import LIGHT, Array, wrap
from aoabench.maths.places import at_anchors
from aoabench.models.components import LEAST_VARIANCE, unstated_param, with_deviations
from aoabench.params import param
from aoabench.roles import NEEDS, Scenario
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch

KERNELS = "kernels.access_nodes"
PRINTED = ("jacobian", "wrap", "shared", "cross")
LOST = 32 * EPS  # eigenvalue of A scaled to a diagonal of 1, below which it is rounding error
RHO2_FLOOR = 1e-12  # m^2: guards the azimuth's derivative above and below an AN


@dataclass(frozen=True)
class AccessNodeEKF(Compiled, GaussianFilter):
    """EKF with times and angles of arrival, or angles alone.

    An AN on the predicted mean, or nearer than 0.001 of its standard deviation, has no meaningful
    derivatives and is left out at that step. `Anchors.position_sigma` holds the standard deviations
    of the ANs' positions; None: exact.
    """

    toa: bool = param(True, "whether times of arrival are used beside the angles")
    as_printed: Sequence[str] = param(
        (),
        "errata to run as printed: jacobian (21), (26) [U1, U2]; wrap: the azimuth's difference "
        "is not wrapped [U8]; shared (23), (24): one error for all ANs [U3]; cross (22): no "
        "covariance between time and angles of an AN [U4]",
        choices=PRINTED,
    )
    _: KW_ONLY
    unstated_deg: Sequence[float] = unstated_param()
    engine: str = engine_param()
    tile = 32
    by_replication = True
    heard_only = True
    kernels = KERNELS
    per_step = True

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"motion", "prior"} | ({"delay"} if self.toa else set()))

    @property
    def uses(self) -> frozenset[str]:  # type: ignore[override]
        return frozenset({"elevation", "stated_sigma"} | ({"delay"} if self.toa else set()))

    def recursion(self, batch: Batch, scenario: Scenario, whole: bool = False) -> Recursion:
        belief = believed(batch, scenario)
        if self.toa and (batch.delay is None or batch.delay_sigma is None):
            raise Unfit(*NEEDS["delay"])
        batch = with_deviations(batch, self.unstated_deg)
        size = belief.size if whole else 3
        return self.filtered(heard_alone(batch), belief, size), belief

    def filtered(self, batch: Batch, belief: Belief, size: int = 3) -> Filtered:
        """The recursion, in the kernel if there is one; of the state, the first `size`
        components.
        """
        compiled = self.compiled(batch.anchors)
        belief = belief._replace(covariance=prior_root(belief.covariance))
        if compiled is None:
            return self._recursion(belief, *self.measured(batch), batch.anchors, size=size)
        flags = tuple(name in self.as_printed for name in PRINTED)
        return Filtered(*compiled.run(belief, batch, self.toa, flags, size))

    def trace(self, batch: Batch, scenario: Scenario, streams: Streams) -> dict[str, Array]:
        """Innovations (R, T) at the predicted mean, by access node and component; NaN where the
        access node was not heard.
        """
        belief, seen = believed(batch, scenario), list[Array]()
        belief = belief._replace(covariance=prior_root(belief.covariance))
        batch = heard_alone(with_deviations(batch, self.unstated_deg))
        y, q = self.measured(batch)
        self._recursion(belief, y, q, batch.anchors, seen)
        values, count = np.stack(seen, axis=1), batch.layout.count
        if batch.known is not None and batch.anchor_id is not None:
            each = [at_anchors(values[..., i], batch.anchor_id, count) for i in range(3)]
            values = np.stack(each, axis=-1)
        names = ("range_m", "azimuth_rad", "elevation_rad")
        return innovations(values.reshape(*values.shape[:2], -1), count, names)

    def measured(self, batch: Batch) -> tuple[Array, Array]:
        """Measurements (c delay, azimuth, elevation) (R, T, B, 3) in m and rad, NaN = not measured,
        and their variances.
        """
        pairs: list[Any] = [
            (batch.delay, batch.delay_sigma, LIGHT) if self.toa else (None, None, 1.0),
            (batch.azimuth, batch.azimuth_sigma, 1.0),
            (batch.elevation, batch.elevation_sigma, 1.0),
        ]
        y = np.full((*batch.azimuth.shape, 3), np.nan)
        q = np.ones_like(y)
        for i, (value, sigma, scale) in enumerate(pairs):
            if value is not None and sigma is not None:
                with np.errstate(over="ignore"):  # not measured
                    variance = (scale * sigma) ** 2
                usable = np.isfinite(variance) & (variance > 0)
                y[..., i] = np.where(usable, scale * value, np.nan)
                q[..., i] = np.maximum(np.where(usable, variance, 1.0), LEAST_VARIANCE)
        return y, q

    def _recursion(
        self,
        belief: Belief,
        y: Array,
        q: Array,
        anchors: Anchors,
        seen: list[Array] | None = None,
        size: int = 3,
    ) -> Filtered:
        """The kernel's recursion in NumPy, over the results of `measured`, with the first `size`
        components of the state; the covariance of `belief` is a square root, and innovations
        (R, K, 3) are appended to `seen`.
        """
        mean, root = belief.mean, belief.covariance
        flags = tuple(name in self.as_printed for name in PRINTED)
        x, B = np.asarray(mean), np.broadcast_to(root, (*mean.shape, mean.shape[1]))
        means, covariances, nis = [], [], []
        with np.errstate(
            all="ignore"
        ):  # a replication that overflows becomes NaN and is counted as failed
            for k in range(y.shape[1]):
                F, Q = belief.at(k)
                x, B = moved(x, F), predicted(B, F, Q)
                those = anchors.at(k)
                if seen is not None:
                    v = y[:, k] - expected(x[:, :3], those, flags[0])[0]
                    v[..., 1] = wrap(v[..., 1])
                    seen.append(v)
                used = np.where(near(x, B, those)[..., None], np.nan, y[:, k])
                A, g, squares = information(
                    x[:, :3], used, q[:, k], those, _variances(those), flags
                )
                c, u = columns(A, g)
                f = np.swapaxes(B[:, :3], -1, -2) @ c
                x, B, squared = absorb(x, B, f, u, np.ones_like(u))
                means.append(x[:, :size])
                covariances.append(covariance(B[:, :size]))
                nis.append((1 - ROUNDED) * (squares - (u * u).sum(-1)) + squared)
        P, squared = np.stack(covariances, axis=1), np.stack(nis, axis=1)
        return Filtered(np.stack(means, axis=1), P, squared, np.isfinite(y).sum(axis=(2, 3)))


def _variances(anchors: Anchors) -> Array:
    """Variances (R|1, B, 3) m^2 of the ANs' positions at one step; 0 where they are exact."""
    sigma = anchors.position_sigma
    return np.zeros((1, anchors.count, 3)) if sigma is None else np.square(sigma[:, 0])


class Information(NamedTuple):
    """A (R, 3, 3) and g (R, 3) of a step's measurements, and their v^T S^-1 v (R,)."""

    A: Array
    g: Array
    squares: Array


def columns(A: Array, g: Array) -> tuple[Array, Array]:
    """c (R, 3, 3) and u (R, 3) with A = c c^T and g = c u, for A (R, 3, 3) >= 0 and g (R, 3).

    The columns of c come from the eigenvectors of A scaled to a diagonal of 1. An eigenvalue below
    the rounding error of A carries no information, and its column is 0.
    """
    diagonal = np.diagonal(A, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    finite = np.asarray(np.isfinite(A).all((-1, -2)))[:, None]
    A = np.where(finite[..., None], A / (scale[:, :, None] * scale[:, None, :]), 0.0)
    values, vectors = np.linalg.eigh(A)
    root = np.sqrt(np.where(values > LOST, values, 0.0))
    u = np.swapaxes(vectors, -1, -2) @ (g / scale)[..., None]
    c = np.where(finite[..., None], scale[:, :, None] * vectors * root[:, None, :], np.nan)
    return c, np.where(root > 0, u[..., 0] / root, 0.0)


def information(
    x: Array, y: Array, q: Array, anchors: Anchors, C: Array, flags: tuple[bool, ...] = (False,) * 4
) -> Information:
    """The information of one step's measurements y with variances q (R, B, 3) at positions x (R, 3)
    m.

    C (R|1, B, 3) m^2: variances of the ANs' positions; anchors are those of one step.
    """
    jacobian, unwrapped, shared, apart = flags
    rotation = anchors.frames[1]
    h, H = expected(x, anchors, jacobian)
    v = y - h
    if unwrapped:
        turn = np.arctan2(rotation[..., 0, 1], rotation[..., 0, 0])  # the broadside's direction
        v[..., 1] = wrap(y[..., 1] + turn) - wrap(h[..., 1] + turn)
    else:
        v[..., 1] = wrap(v[..., 1])
    known = ~np.isnan(v)
    v, H = np.where(known, v, 0.0), np.where(known[..., None], H, 0.0)
    S = np.zeros((*q.shape, 3))
    S[..., range(3), range(3)] = np.where(known, q, 1.0)
    if shared:
        groups = (np.array([1.0, 0, 0]), np.array([0, 1.0, 1])) if apart else (np.ones(3),)
        found = [common(*gather(H * group[:, None], v * group, S), C[:, 0]) for group in groups]
        return Information(*(np.sum(each, axis=0) for each in zip(*found)))
    S += (H * C[:, :, None, :]) @ np.swapaxes(H, -1, -2)
    if apart:
        S[..., 0, 1:] = S[..., 1:, 0] = 0.0
    return gather(H, v, S)


def common(A: Array, g: Array, squares: Array, C: Array) -> Information:
    """A (I + C A)^-1, (I + A C)^-1 g and `squares` - g^T C (I + A C)^-1 g for an additional error
    of the position with variances C (R|1, 3) m^2.

    With A = c c^T, g = c u and sqrt(C) c = f, the first two are c M M^T c^T and c M M^T u, where M
    is the root of (I + f^T f)^-1.
    """
    c, u = columns(A, g)
    rows = np.concatenate([c, u[:, None]], axis=1)
    f = np.swapaxes(np.sqrt(C)[..., :, None] * c, -1, -2)
    _, rows, _ = absorb(np.zeros(rows.shape[:2]), rows, f, np.zeros_like(u), np.ones_like(u))
    c, u = rows[:, :3], rows[:, 3]
    left = (c @ u[..., None])[..., 0]
    return Information(c @ np.swapaxes(c, -1, -2), left, squares - (g * C * left).sum(-1))


def gather(H: Array, v: Array, S: Array) -> Information:
    """Sums over the ANs of H^T S^-1 H, H^T S^-1 v and v^T S^-1 v, from H and S (R, B, 3, 3) and v
    (R, B, 3).
    """
    solved = np.linalg.solve(S, np.concatenate([H, v[..., None]], axis=-1))
    both = (np.swapaxes(H, -1, -2) @ solved).sum(axis=1)
    return Information(both[..., :3], both[..., 3], (v * solved[..., 3]).sum((1, 2)))


def expected(x: Array, anchors: Anchors, printed: bool = False) -> tuple[Array, Array]:
    """(Range, azimuth, elevation) (R, B, 3) in m and rad at positions x (R, 3) m, and their
    derivatives (R, B, 3, 3).

    `printed` uses the denominators of (21): d_2D^2 in place of d_2D d^2 and of d^2 in the
    elevation's row, and d_2D in place of d_2D^2 in the azimuth's.
    """
    position, R = anchors.frames
    local = (R @ (x[:, None] - position)[..., None])[..., 0]  # (R, B, 3)
    u, v, w = np.moveaxis(local, -1, 0)
    rho2 = np.maximum(u * u + v * v, RHO2_FLOOR)
    rho, d2 = np.sqrt(rho2), rho2 + w * w
    d, zero = np.sqrt(d2), np.zeros_like(u)
    rows = [np.stack([u, v, w], axis=-1) / d[..., None]]
    rows += [np.stack([-v, u, zero], axis=-1) / (rho if printed else rho2)[..., None]]
    if printed:
        rows += [np.stack([-u * w, -v * w, rho], axis=-1) / rho2[..., None]]
    else:
        rows += [np.stack([-u * w / rho, -v * w / rho, rho], axis=-1) / d2[..., None]]
    return np.stack([d, np.arctan2(v, u), np.arctan2(w, rho)], axis=-1), np.stack(rows, axis=-2) @ R
