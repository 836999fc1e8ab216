"""Maximum likelihood of normal azimuths and elevations by Gauss-Newton, one fix at a time [Le 2021,
(20)-(29), Alg. 1].

    x <- x + (G^T C^-1 G)^-1 G^T C^-1 (y - f(x)),        G = df / dx

from the least-squares start, until a step is shorter than `tolerance_m`. The paper compares three
definitions of the azimuth's difference:

    arctan   f = arctan(y / x), the measurement folded into [-pi/2, pi/2)                   (b)
    atan2    both in [0, 2 pi), no correction                                               (c)
    kcorr    both in [0, 2 pi), and 2 pi k added to f, k = sign(y - f) where |y - f| >= pi  (d)

A fix diverges if |x| exceeds 1e9 m or becomes NaN, or if the normal matrix is not positive
definite. A fix oscillates if it has not converged after `updates` steps. Both return the start, as
in the paper. The number of updates is `iterations`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from aoabench.estimators.least_squares import KERNELS, by_kernel, measured, planes, rows_param
from aoabench.estimators.parameters import tolerance_param, updates_param
from aoabench.kernels.loading import Compiled, engine_param
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import solve
from aoabench.params import param
from aoabench.roles import Estimator, Scenario
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Estimates, Outcome

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
    kernels = KERNELS

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"elevation", "several_anchors"})

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """One position per fix, the number of updates, and the outcome of the iteration."""
        compiled = self.compiled(batch.anchors)
        if compiled is not None:
            variant = (
                AZIMUTHS.index(self.azimuth),
                0 if self.as_printed is None else 1 + PRINTED.index(self.as_printed),
            )
            found = by_kernel(compiled, batch, self.start, *variant, self.tolerance_m, self.updates)
            return Estimates(found[0], None, found[2], found[1])
        start = planes(batch, self.start)
        x, outcome, iterations = (
            start.copy(),
            np.full(start.shape[:2], int(Outcome.OK)),
            np.zeros(start.shape[:2]),
        )
        for i, y in enumerate(zip(*measured(batch))):
            x[i], outcome[i], iterations[i] = self.iterate(start[i], *y, batch.anchors.of(i))
        return Estimates(x, None, iterations, outcome.astype(np.int8))

    def iterate(
        self, start: Array, azimuth: Array, elevation: Array, wa: Array, we: Array, anchors: Anchors
    ) -> tuple[Array, np.ndarray, np.ndarray]:
        """Positions (T, 3), outcomes (T,) and updates (T,) from starts (T, 3) and measurements (T,
        B).
        """
        x, count = start.copy(), np.zeros(len(start))
        outcome = np.where(np.isfinite(start).all(-1), Outcome.OSCILLATED, Outcome.FAILED).astype(
            int
        )
        active = np.flatnonzero(outcome == Outcome.OSCILLATED)
        for _ in range(self.updates):
            if not len(active):
                break
            y = azimuth[active], elevation[active], wa[active], we[active]
            A, g = self.normal_equations(x[active], *y, anchors.at(active))
            step = solve(A, g)
            count[active] += 1
            with np.errstate(invalid="ignore"):
                x[active] += step
                length = np.linalg.norm(step, axis=-1)
                lost = ~(np.linalg.norm(x[active], axis=-1) <= 1e9)
            outcome[active[lost]] = Outcome.DIVERGED
            outcome[active[~lost & (length < self.tolerance_m)]] = Outcome.OK
            active = active[~lost & (length >= self.tolerance_m)]
        back = (outcome == Outcome.DIVERGED) | (outcome == Outcome.OSCILLATED)
        x[back] = start[back]
        return x, outcome, count

    def normal_equations(
        self, x: Array, azimuth: Array, elevation: Array, wa: Array, we: Array, anchors: Anchors
    ) -> tuple[Array, Array]:
        """G^T C^-1 G (N, 3, 3) and G^T C^-1 (y - f) (N, 3) at positions (N, 3)."""
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
        return A, np.einsum("nb,nbi->ni", wa * da, ga) + np.einsum("nb,nbi->ni", we * de, ge)

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
