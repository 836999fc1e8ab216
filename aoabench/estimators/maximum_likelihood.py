"""Maximum likelihood of normal azimuths and elevations by Gauss-Newton, one fix at a time [Le 2021,
(20)-(29), Alg. 1].

    x <- x + (G^T C^-1 G)^-1 G^T C^-1 (y - f(x)),        G = df / dx

from the least-squares start, until a step is shorter than `tolerance_m`. The paper compares three
definitions of the azimuth's difference:

    arctan   f = arctan(y / x), the measurement folded into [-pi/2, pi/2)                   (b)
    atan2    both in [0, 2 pi), no correction                                               (c)
    kcorr    both in [0, 2 pi), and 2 pi k added to f, k = sign(y - f) where |y - f| >= pi  (d)

A fix diverges if its distance from the anchors' centre exceeds FAR times their extent or becomes
NaN, or if the normal matrix is not positive definite. A fix oscillates if it has not converged
after `updates` steps. Both return the start, as in the paper. A fix that has converged behind an
anchor is DIVERGED too, and keeps its position. The number of updates is `iterations`.

An elevation of exactly +-90 deg leaves the azimuth undefined. Such an anchor's frame is turned, so
that its ray has azimuth and elevation 0 (`off_the_poles`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from aoabench.estimators.least_squares import (
    KERNELS,
    by_kernel,
    measured,
    planes,
    replaced,
    rows_param,
    stated,
    usable,
)
from aoabench.estimators.parameters import tolerance_param, updates_param
from aoabench.estimators.rays import (
    FAR,
    behind,
    extent,
    occupied,
    off_the_poles,
    rays,
    residual_variance,
    those,
)
from aoabench.kernels.loading import Compiled, engine_param
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import inverse, solve
from aoabench.params import param
from aoabench.roles import Estimator, Scenario
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Estimates, Outcome, Reason

AZIMUTHS = ("arctan", "atan2", "kcorr")
PRINTED = ("sign", "atan2")  # errata that can be run as printed: L1 and L2
TURN = 2.0 * math.pi


@dataclass(frozen=True)
class GaussNewton(Compiled, Estimator):
    """Gauss-Newton iterations from the least-squares start."""

    azimuth: str = param(
        "kcorr",
        "definition of azimuths: arctan, folded; atan2, in [0, 2 pi); or kcorr, atan2 with "
        "phase-jump correction",
        choices=AZIMUTHS,
    )
    start: str = rows_param()
    tolerance_m: float = tolerance_param(0.01)
    updates: int = updates_param(1000)
    as_printed: str | None = param(
        None,
        "erratum to run as printed: sign takes k = sign(f - y) [Algorithm 1, line 7; L1], "
        "atan2 swaps its arguments [(22); L2]",
        choices=PRINTED,
    )
    engine: str = engine_param()
    tile = 1
    by_replication = True
    heard_only = True
    per_step = True
    kernels = KERNELS
    uses = frozenset({"elevation", "stated_sigma"})

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"elevation", "several_anchors"})

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """One position per fix, the number of updates, and the outcome of the iteration.

        The covariance is the inverse Fisher information at the stated variances, or at one variance
        that the residuals give; that of a start is the start's.
        """
        compiled, batch = self.compiled(batch.anchors), occupied(batch)
        if compiled is None:
            return self.in_numpy(off_the_poles(batch)[0])
        printed = 0 if self.as_printed is None else 1 + PRINTED.index(self.as_printed)
        variant = AZIMUTHS.index(self.azimuth), printed
        found = by_kernel(compiled, batch, self.start, variant, self.tolerance_m, self.updates)
        turned, at_pole = off_the_poles(batch)
        if not at_pole.any():
            return found
        return replaced(found, self.in_numpy(those(turned, at_pole)), at_pole)

    def in_numpy(self, batch: Batch) -> Estimates:
        """The estimates of a tile in NumPy."""
        first, s = planes(batch, self.start), batch.anchors.position
        start, given = first.position, measured(batch)
        x, outcome, iterations = start.copy(), first.outcome.copy(), np.zeros(start.shape[:2])
        assert first.reason is not None
        assert first.covariance is not None
        reason, P = np.empty_like(outcome), first.covariance
        for i, y in enumerate(zip(*given)):
            found = self.iterate(start[i], *y, batch.anchors.of(i))
            x[i], outcome[i], reason[i], iterations[i] = found[:4]
            if not stated(batch):
                angles = (y[2] > 0).sum(axis=-1) + (y[3] > 0).sum(axis=-1)
                found[4][:] *= residual_variance(found[5], angles - 3)[:, None, None]
            P[i] = np.where((found[1] == Outcome.OK)[:, None, None], found[4], P[i])
        reason = np.where(outcome == Outcome.FAILED, first.reason, reason)
        ahead = rays(usable(batch, *given[2:])).ahead
        back = (outcome == Outcome.OK) & behind(ahead, s, x)
        outcome[back], reason[back] = Outcome.DIVERGED, Reason.BEHIND
        return Estimates(x, P, iterations, outcome, None, first.anchors_used, reason)

    def iterate(
        self, start: Array, azimuth: Array, elevation: Array, wa: Array, we: Array, anchors: Anchors
    ) -> tuple[Array, np.ndarray, np.ndarray, Array, Array, Array]:
        """Positions (T, 3), outcomes, reasons and updates (T,), inverse normal matrices (T, 3, 3)
        and sums of squared residuals (T,) from starts (T, 3) and measurements (T, B).
        """
        x, count, T = start.copy(), np.zeros(len(start)), len(start)
        started: np.ndarray = np.asarray(np.isfinite(start).all(-1))
        outcome = np.where(started, Outcome.OSCILLATED, Outcome.FAILED).astype(np.int8)
        reason = np.full(T, Reason.NO_CONVERGENCE, dtype=np.int8)
        P, squares = np.full((T, 3, 3), np.nan), np.full(T, np.nan)
        s = anchors.position[0]
        centre, far = np.broadcast_to(s.mean(axis=1), (T, 3)), FAR * extent(anchors.position)[0]
        far = np.broadcast_to(far, T)
        active = np.flatnonzero(started)
        for _ in range(self.updates):
            if not len(active):
                break
            y = azimuth[active], elevation[active], wa[active], we[active]
            A, g, q = self.normal_equations(x[active], *y, anchors.at(active))
            step = solve(A, g)
            count[active] += 1
            with np.errstate(invalid="ignore"):
                x[active] += step
                length = np.linalg.norm(step, axis=-1)
                lost = ~(np.linalg.norm(x[active] - centre[active], axis=-1) <= far[active])
            singular: np.ndarray = np.asarray(np.isnan(step).any(axis=-1))
            done = ~lost & (length < self.tolerance_m)
            outcome[active[lost]] = Outcome.DIVERGED
            reason[active[lost]] = np.where(singular[lost], Reason.NO_DESCENT, Reason.TOO_FAR)
            outcome[active[done]], reason[active[done]] = Outcome.OK, Reason.NONE
            P[active[done]] = inverse(A[done])
            squares[active[done]] = (q - (g * step).sum(axis=-1))[done]
            active = active[~lost & ~done]
        back = (outcome == Outcome.DIVERGED) | (outcome == Outcome.OSCILLATED)
        x[back] = start[back]
        return x, outcome, reason, count, P, squares

    def normal_equations(
        self, x: Array, azimuth: Array, elevation: Array, wa: Array, we: Array, anchors: Anchors
    ) -> tuple[Array, Array, Array]:
        """G^T C^-1 G (N, 3, 3), G^T C^-1 (y - f) (N, 3) and (y - f)^T C^-1 (y - f) (N,) at
        positions (N, 3).
        """
        R = anchors.rotation[0]
        local = (R @ (x[:, None] - anchors.position[0])[..., None])[..., 0]
        u, v, w = np.moveaxis(local, -1, 0)  # (N, B)
        with np.errstate(divide="ignore", invalid="ignore"):
            rho2 = u * u + v * v
            rho, r2 = np.sqrt(rho2), rho2 + w * w
            rows = [np.stack([-v, u, np.zeros_like(u)], axis=-1) / rho2[..., None]]
            rows += [np.stack([-u * w / rho, -v * w / rho, rho], axis=-1) / r2[..., None]]
            ga, ge = np.moveaxis(np.stack(rows, axis=-2) @ R, -2, 0)
            da, de = self.azimuth_difference(azimuth, u, v), elevation - np.arctan2(w, rho)
        if self.as_printed == "atan2":
            ga = -ga  # the derivative as printed
        A = np.einsum("nb,nbi,nbj->nij", wa, ga, ga) + np.einsum("nb,nbi,nbj->nij", we, ge, ge)
        g = np.einsum("nb,nbi->ni", wa * da, ga) + np.einsum("nb,nbi->ni", we * de, ge)
        return A, g, (wa * da**2 + we * de**2).sum(axis=-1)

    def azimuth_difference(self, measured: Array, u: Array, v: Array) -> Array:
        """Measured azimuth minus the azimuth of (u, v) in rad, by the chosen definition."""
        if self.azimuth == "arctan":
            folded = np.mod(measured + math.pi / 2, math.pi) - math.pi / 2
            return folded - np.arctan(v / u)
        f = np.mod(np.arctan2(u, v) if self.as_printed == "atan2" else np.arctan2(v, u), TURN)
        d = np.mod(measured, TURN) - f
        if self.azimuth == "atan2":
            return d
        k = np.where(np.abs(d) >= math.pi, np.sign(d), 0.0)
        return d - TURN * (-k if self.as_printed == "sign" else k)
