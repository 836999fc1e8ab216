"""Robust maximum likelihood of azimuths, elevations and ranges.

    f(p) = 1/2 sum_i [rho(da_i^2 / sigma_a^2) + rho(de_i^2 / sigma_e^2) + rho(dr_i^2 / sigma_r^2)]

over the anchors that measure an azimuth, with the differences of measured and expected angles
(da, de, wrapped) and ranges (dr). `Loss` has the choices of rho. A Gauss-Newton step weighs each
measurement with rho' (iteratively reweighted least squares). It starts from the best of these
points: the one nearest to all measured lines, those where one ray meets the plane of a known
height, those nearest to two lines, and those on a ray at its range. One of them comes from good
anchors alone, as long as two anchors are good.

A robust loss needs two measurements more than unknowns: with one, it cannot tell which is wrong.
Several packets of an anchor count once, as they share what is wrong with it, unless the anchor has
moved by more than SAME_M between them. A fix with fewer, such
as one of three azimuths alone, is the point nearest to the lines, or with ranges the minimum of the
loss `normal`; with elevations, three anchors and even two at a known height have the redundancy.
The loss `normal` has no such rule.

Ranges (`Batch.delay` times the speed of light) need a positive deviation, and elevations or a known
height: a range without both says nothing about how far a target of unknown height is in the plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np

from aoabench.errors import Unfit
from aoabench.estimators.losses import Loss
from aoabench.estimators.parameters import clip_param, tolerance_param, updates_param
from aoabench.estimators.places import places
from aoabench.estimators.plane import clipped
from aoabench.estimators.rays import POLE, is_deviation, off_the_poles
from aoabench.estimators.robust_reference import Found, fixes
from aoabench.kernels.loading import Compiled, engine_param
from aoabench.maths.geometry import LIGHT, Array
from aoabench.params import param
from aoabench.roles import NEEDS, Estimator, Noise, Scenario
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Estimates

FREE = "free"
LOSSES = ("normal", "student", "huber", "truncated")
LIMITS = {"huber": 1.345, "truncated": 3.0}  # deviations
STATED = "stated"
# angles, 1 / variance of both, ranges and theirs, each (R, T, B); the last two (R, T, 0) for none
Measured = tuple[Array, Array, Array, Array, Array, Array]


@dataclass(frozen=True)
class RobustLikelihood(Compiled, Estimator):
    """Maximum likelihood of azimuths, elevations and ranges with a robust loss.

    Outcomes: FAILED without a start; DIVERGED behind an anchor that is used, or farther from the
    anchors' centre than FAR times their extent; OSCILLATED if no step is shorter than `tolerance_m`
    within `updates`. An anchor is used if its azimuth keeps a quarter of the full weight. The score
    is sqrt(sum rho / number of measurements): deviations, NaN without redundancy. With a known
    height, and from azimuths of upright anchors alone, z is NaN.

    The covariance is the inverse of the weighted normal matrix, times `Loss.spread`, and times the
    weighted variance of the residuals if that exceeds 1. An anchor's azimuth counts there as if the
    fix were at least one deviation of the elevation from the anchor's pole.
    """

    loss: str = param("student", "rho, the cost of a squared deviation", choices=LOSSES)
    nu: float = param(3.0, "degrees of freedom of the loss student", above=0, most=1e6)
    limit: float | None = param(
        None,
        "deviations from which huber weighs an angle less and truncated leaves it out; null: 1.345 "
        "and 3",
        above=0,
        most=1e6,
    )
    azimuth_sigma_deg: float = param(
        6.0, "standard deviation of the azimuth", unit="deg", above=0, most=90
    )
    elevation_sigma_deg: float | None = param(
        12.0,
        "standard deviation of the elevation; null: elevations are not used",
        unit="deg",
        above=0,
        most=90,
    )
    stated: bool = param(
        False, "whether the deviations that the measurements state are used in place of these"
    )
    range_sigma_m: float | str | None = param(
        STATED,
        "standard deviation of a range; stated: the measurement's own, and a range without one is "
        "not used; null: ranges are not used",
        unit="m",
        above=0,
        also=(STATED,),
    )
    height_m: float | str | None = param(
        None,
        "height of the target; free: z is estimated; null: the scenario's known height, else free",
        unit="m",
        also=(FREE,),
    )
    tolerance_m: float = tolerance_param(1e-4)
    updates: int = updates_param(100)
    clip: bool = clip_param()
    engine: str = engine_param()
    tile = 8
    by_replication = True
    heard_only = True
    per_step = True
    kernels = "kernels.robust"

    @property
    def needs(self) -> frozenset[str]:
        several = self.height_m == FREE or self.elevation_sigma_deg is None
        found = {"several_anchors"} if several and self.range_sigma_m is None else set()
        return frozenset(found | ({"stated_sigma"} if self.stated else set()))

    @property
    def uses(self) -> frozenset[str]:  # type: ignore[override]
        chosen = {
            "elevation": self.elevation_sigma_deg is not None,
            "delay": self.range_sigma_m is not None,
            "stated_sigma": self.stated,
        }
        return frozenset(name for name, used in chosen.items() if used)

    def check(self, scenario: Scenario, noise: Noise) -> None:
        """Raise Unfit as all estimators do, and if a single anchor measures but not two of these:
        the height is known, elevations are measured, ranges are.
        """
        super().check(scenario, noise)
        given = noise.offers()
        offered = scenario.offers() | ({"elevation"} if given is None else given)
        ray = "elevation" in offered and self.elevation_sigma_deg is not None
        ranged = "delay" in offered and self.range_sigma_m is not None
        alone = ray + ranged + bool(np.isfinite(self._height(scenario))) >= 2
        if not alone and "several_anchors" not in scenario.offers():
            raise Unfit(*NEEDS["several_anchors"])

    def _height(self, scenario: Scenario) -> float:
        """The known height in m, NaN if z is estimated."""
        if self.height_m == FREE:
            return np.nan
        height = scenario.known_height_m if self.height_m is None else self.height_m
        return np.nan if height is None else float(height)

    @property
    def rho(self) -> Loss:
        """The chosen loss with its parameter."""
        limit = LIMITS.get(self.loss, 1.0) if self.limit is None else self.limit
        return Loss(LOSSES.index(self.loss), self.nu if self.loss == "student" else limit)

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """One position per fix."""
        if self.elevation_sigma_deg is None:
            nothing = np.full_like(batch.elevation, np.nan)
            batch = replace(batch, elevation=nothing, elevation_sigma=None)
        height = self._height(scenario)
        measured, batch = self._weighted(batch, np.isfinite(height))
        compiled = self.compiled(batch.anchors)
        given = batch.anchors, measured, height, places(batch).astype(float)
        found = self._in_numpy(*given) if compiled is None else self._by_kernel(compiled, *given)
        p = found.position
        p[..., :2] = clipped(p[..., :2], scenario, self.clip)
        return Estimates(
            p,
            self.rho.spread * found.covariance,
            found.updates,
            found.outcome,
            found.score,
            found.used,
            found.reason,
        )

    def _weighted(self, batch: Batch, known: bool) -> tuple[Measured, Batch]:
        """Angles and ranges with 1 / variance, 0 where not measured; and the batch with the frames
        of anchors turned that see the target along their pole. `known`: the height is.
        """
        azimuth = np.isfinite(batch.azimuth) & is_deviation(batch.azimuth_sigma)
        line = azimuth & np.isfinite(batch.elevation) & is_deviation(batch.elevation_sigma)
        pole = line & (np.abs(np.abs(batch.elevation) - np.pi / 2) < POLE)
        a, e = batch.azimuth_sigma, batch.elevation_sigma
        if not self.stated or a is None:
            a = np.full_like(batch.azimuth, np.radians(self.azimuth_sigma_deg))
        if not self.stated or e is None:
            e = np.full_like(a, np.radians(self.elevation_sigma_deg or self.azimuth_sigma_deg))
        with np.errstate(divide="ignore", invalid="ignore"):
            we = np.where(line, 1.0 / np.square(e), 0.0)
            wa = np.where(pole, we, np.where(azimuth, 1.0 / np.square(a), 0.0))
        turned, _ = off_the_poles(batch)
        phi, theta = turned.azimuth, turned.elevation
        usable = azimuth & (known | line.any(axis=2, keepdims=True))
        angles = np.where(azimuth, phi, 0.0), np.where(line, theta, 0.0), wa, we
        return (*angles, *self._ranges(batch, usable)), turned

    def _ranges(self, batch: Batch, usable: np.ndarray) -> tuple[Array, Array]:
        """Ranges and 1 / variance (R, T, B), 0 where not `usable` (R, T, B) or without a positive
        deviation; both (R, T, 0) without any.
        """
        none = np.empty((*usable.shape[:2], 0))
        if batch.delay is None or self.range_sigma_m is None:
            return none, none
        sigma = None if batch.delay_sigma is None else LIGHT * batch.delay_sigma
        if self.range_sigma_m != STATED:
            sigma = np.full_like(batch.delay, self.range_sigma_m)
        if sigma is None:
            return none, none
        usable = usable & (batch.delay >= 0) & is_deviation(sigma)
        if not usable.any():
            return none, none
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = np.where(usable, 1.0 / np.square(sigma), 0.0)
        return np.where(usable, LIGHT * batch.delay, 0.0), weight

    def _in_numpy(
        self, anchors: Anchors, measured: Measured, height: float, numbers: Array
    ) -> Found:
        """The fixes (R, T), by NumPy."""
        shape = measured[0].shape
        N = shape[0] * shape[1]
        arrays = [a.reshape(N, -1) for a in measured]
        s = np.broadcast_to(anchors.position, (*shape, 3)).reshape(N, -1, 3)
        R = np.broadcast_to(anchors.rotation, (*shape, 3, 3)).reshape(N, -1, 3, 3)
        ids = np.broadcast_to(numbers, shape).reshape(N, -1)
        given = tuple(a if a.size else np.zeros((N, shape[2])) for a in arrays), (s, R, ids), height
        found = fixes(*given, self.rho, self.tolerance_m, self.updates)
        return Found(*(a.reshape(*shape[:2], *a.shape[1:]) for a in found))

    def _by_kernel(
        self,
        compiled: ModuleType,
        anchors: Anchors,
        measured: Measured,
        height: float,
        numbers: Array,
    ) -> Found:
        """The fixes (R, T), by the compiled kernel."""
        shape, rho = measured[0].shape[:2], self.rho
        outcome, reason = np.empty((2, *shape), dtype=np.int8)
        count, score, used = np.empty((3, *shape))
        p, P = np.empty((*shape, 3)), np.empty((*shape, 3, 3))
        found = Found(p, P, outcome, reason, count, score, used)
        arrays = *measured, anchors.position, anchors.rotation, numbers
        given = [np.ascontiguousarray(a, dtype=float) for a in arrays]
        compiled.robust(rho.kind, rho.k, self.tolerance_m, self.updates, height, *given, *found)
        return found
