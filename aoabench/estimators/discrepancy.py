"""The discrepancy filter (DF): a vote among the anchors' ellipses, then fusion of those that agree
[Boquet 2024, 5].

S1  Each anchor's ray, and its azimuth and elevation moved by one deviation
    sigma = R_sigma sigma-hat, meet the plane of the node's known height;
    the points there make an ellipse E_i with centre mu_i and Sigma_i                   (12)-(17)
S2  M* is the largest set of anchors whose ellipses have a common point                 (18)-(19)
S3  Sigma = (sum_{M*} Sigma_i^-1)^-1,   mu = Sigma sum_{M*} Sigma_i^-1 mu_i             (20)-(21)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from aoabench.errors import BadValue, check_number
from aoabench.estimators import ellipses
from aoabench.estimators.parameters import clip_param, height_param, horizon_param
from aoabench.estimators.places import places
from aoabench.estimators.plane import clipped, plane_of
from aoabench.estimators.rays import POLE
from aoabench.kernels.loading import Compiled, engine_param
from aoabench.maths.geometry import Array, to_unit
from aoabench.params import param
from aoabench.roles import Estimator, Noise, Scenario
from aoabench.streams import Streams
from aoabench.types import Anchors, Batch, Estimates, Outcome, Reason

KERNELS = "kernels.discrepancy"
CENTRES = ("midpoint", "estimate")
INTERSECTIONS = ("boxes", "exact")
TIES = ("area", "first")
MOST = 62  # anchors; the kernel stores a set as the bits of an integer
REASONS = {
    Outcome.FAILED: Reason.NO_MEASUREMENT,
    Outcome.REJECTED: Reason.NO_AGREEMENT,
    Outcome.DIVERGED: Reason.BEHIND,
}
LEAST_AXIS = 1e-6  # m; so that an ellipse has an interior
EVEN = 1e-9  # ratios (19) that differ by less are taken as equal


@dataclass(frozen=True)
class Discrepancy(Compiled, Estimator):
    """The discrepancy filter, with ellipses from the deviations r_sigma azimuth_sigma_deg and
    r_sigma elevation_sigma_deg.
    """

    r_sigma: float = param(1.0, "factor on both deviations; a small one rejects more", above=0)
    azimuth_sigma_deg: float = param(
        8.1, "standard deviation of the azimuth", unit="deg", above=0, most=90
    )
    elevation_sigma_deg: float = param(
        11.1, "standard deviation of the elevation", unit="deg", above=0, most=90
    )
    centre: str = param(
        "midpoint",
        "centre of an ellipse: the midpoint (12) of the projections of elevation +- sigma, "
        "or the projected estimate",
        choices=CENTRES,
    )
    minimum_axis_m: float = param(0.1, "lower limit of the ellipses' half-axes", unit="m", least=0)
    horizon_deg: float = horizon_param()
    intersection: str = param(
        "boxes",
        "regions with a common point: the ellipses' bounding boxes, or the ellipses (exact)",
        choices=INTERSECTIONS,
    )
    ties: str = param(
        "area",
        "choice among several largest sets: the largest ratio (19) of areas, "
        "or the first in the order of anchor numbers",
        choices=TIES,
    )
    vote: bool = param(
        True, "whether anchors vote; false: all anchors that measured are fused, without S2"
    )
    clip: bool = clip_param()
    height_m: float | None = height_param()
    engine: str = engine_param()
    tile = 8
    by_replication = True
    kernels = KERNELS

    def __post_init__(self) -> None:
        super().__post_init__()
        for sigma in (self.azimuth_sigma_deg, self.elevation_sigma_deg):
            check_number("r_sigma", self.r_sigma, above=0, most=90 / sigma)

    uses = frozenset({"elevation"})

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"elevation"} | ({"height"} if self.height_m is None else set()))

    def check(self, scenario: Scenario, noise: Noise) -> None:
        """Raise Unfit as all estimators do, and UserError if an anchor lies in the plane or the
        scenario has more than MOST anchors.
        """
        super().check(scenario, noise)
        plane_of(self.height_m, scenario)
        B = scenario.true_anchors.count
        if self.vote and B > MOST:
            raise BadValue(
                "vote", True, f"false: the scenario has {B} anchors, and at most {MOST} can vote"
            )

    def __call__(self, batch: Batch, scenario: Scenario, streams: Streams) -> Estimates:
        """One position per fix; outcome REJECTED if fewer than two ellipses agree, FAILED if no
        anchor measured, DIVERGED behind an anchor of those that agree.
        """
        height = plane_of(self.height_m, scenario)
        compiled = self.compiled(batch.anchors)
        R, T, _ = batch.azimuth.shape
        found = (
            np.empty((R, T, 3)),
            np.empty((R, T, 3, 3)),
            np.empty((R, T), dtype=np.int8),
            np.empty((R, T)),
        )
        place = np.broadcast_to(places(batch), batch.azimuth.shape)
        for i in range(R):
            given = batch.azimuth[i], batch.elevation[i], batch.anchors.of(i), place[i], height
            into = tuple(a[i] for a in found)
            if compiled is None:
                self.fixes(*given, *into)
            else:
                self.by_kernel(compiled, *given, *into)
        position, covariance, outcome, used = found
        position[..., :2] = clipped(position[..., :2], scenario, self.clip)
        reason = np.array([REASONS.get(o, Reason.NONE) for o in Outcome], dtype=np.int8)[outcome]
        return Estimates(position, covariance, None, outcome, None, used, reason)

    @property
    def deviations(self) -> tuple[float, float]:
        """Deviations of azimuth and elevation in rad."""
        return self.r_sigma * math.radians(self.azimuth_sigma_deg), self.r_sigma * math.radians(
            self.elevation_sigma_deg
        )

    @property
    def slope(self) -> float:
        """Tangent of the smallest angle between a ray and the plane."""
        return math.tan(math.radians(self.horizon_deg))

    @property
    def least_axis(self) -> float:
        """Lower limit of the half-axes in m."""
        return max(self.minimum_axis_m, LEAST_AXIS)

    def by_kernel(
        self,
        compiled: ModuleType,
        azimuth: Array,
        elevation: Array,
        anchors: Anchors,
        place: np.ndarray,
        height: float,
        *found: np.ndarray,
    ) -> None:
        """The same as `fixes`, by the compiled kernel; `found` are the arrays to fill in."""
        centre = CENTRES.index(self.centre)
        vote = compiled.NO_VOTE if not self.vote else INTERSECTIONS.index(self.intersection)
        sa, se = self.deviations
        sines = np.array([math.sin(sa), math.cos(sa), math.sin(se), math.cos(se)])
        angles = np.ascontiguousarray(azimuth), np.ascontiguousarray(elevation)
        s, R = (np.ascontiguousarray(a[0]) for a in anchors.frames)
        compiled.discrepancy(
            centre,
            vote,
            TIES.index(self.ties),
            self.slope,
            sines,
            self.least_axis,
            *angles,
            s,
            R,
            place[0].astype(np.int64),
            height,
            *found,
        )

    def fixes(
        self,
        azimuth: Array,
        elevation: Array,
        anchors: Anchors,
        place: np.ndarray,
        height: float,
        *found: np.ndarray,
    ) -> None:
        """Fill in position (N, 3) m, covariance (N, 3, 3) m^2, outcome and number of anchors used
        (N,) from angles (N, B) rad of anchors in places (N, B).
        """
        position, covariance, outcome, used = found
        position[:], covariance[:], outcome[:], used[:] = np.nan, np.nan, Outcome.FAILED, 0
        missing = ~(np.isfinite(azimuth) & np.isfinite(elevation))
        azimuth, elevation = (np.where(missing, 0.0, a) for a in (azimuth, elevation))
        ahead = (to_unit(azimuth, elevation)[..., None, :] @ anchors.rotation[0])[..., 0, :]
        s = np.broadcast_to(anchors.position[0], ahead.shape)
        away = ahead[..., 2] * np.sign(height - s[..., 2]) < 0  # a ray straight away has no azimuth
        missing |= away & (np.hypot(ahead[..., 0], ahead[..., 1]) < POLE)
        m, L = self.ellipses_of(np.where(missing, np.nan, azimuth), elevation, anchors, height)
        for k in range(len(m)):
            known = np.flatnonzero(~missing[k])
            if len(known):
                chosen = known[self.selected(m[k, known], L[k, known])]
                used[k] = len(np.unique(place[k, chosen]))
                outcome[k] = Outcome.OK if len(chosen) else Outcome.REJECTED
                if len(chosen):
                    position[k, :2], covariance[k, :2, :2] = ellipses.fused(
                        m[k, chosen], L[k, chosen]
                    )
                    p = np.array([*position[k, :2], height])
                    if (((p - s[k, chosen]) * ahead[k, chosen]).sum(axis=-1) < 0).any():
                        outcome[k] = Outcome.DIVERGED

    def ellipses_of(
        self, azimuth: Array, elevation: Array, anchors: Anchors, height: float
    ) -> tuple[Array, Array]:
        """S1: centres (N, B, 2) m and L = R S (N, B, 2, 2) of the ellipses, from angles (N, B) of
        anchors (1, N|1, B, ...).

        The half-axis a (13) lies along p_phi+ - p_phi-. For an upright anchor this is the radial
        line of (15), and it is still defined at the nadir, where the ellipse's centre is directly
        below the anchor.
        """
        s, R = anchors.position[0], anchors.rotation[0]
        to_plane = height - s[..., 2]
        sa, se = self.deviations

        def seen(
            p: Array,
        ) -> tuple[Array, Array]:  # f^-1: azimuth and elevation of points (N, B, 2)
            v = np.concatenate(
                [p - s[..., :2], np.broadcast_to(to_plane[..., None], (*p.shape[:2], 1))], axis=-1
            )
            x, y, z = np.moveaxis((R @ v[..., None])[..., 0], -1, 0)
            return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))

        def f(
            azimuth: Array, elevation: Array
        ) -> tuple[Array, np.ndarray]:  # and whether the ray had to be turned
            x, y, z = np.moveaxis(
                (np.swapaxes(R, -1, -2) @ to_unit(azimuth, elevation)[..., None])[..., 0], -1, 0
            )
            flat, towards = np.hypot(x, y), z * np.sign(to_plane)
            low = towards < flat * self.slope
            reach = np.abs(to_plane) / np.maximum(np.maximum(towards, flat * self.slope), 1e-300)
            return s[..., :2] + reach[..., None] * np.stack([x, y], axis=-1), low

        p, low = f(azimuth, elevation)
        turned = seen(p)
        azimuth, elevation = np.where(low, turned[0], azimuth), np.where(low, turned[1], elevation)
        plus, minus = f(azimuth, elevation + se)[0], f(azimuth, elevation - se)[0]
        a = np.linalg.norm(plus - minus, axis=-1) / 2  # (13)
        m = f(azimuth, elevation)[0] if self.centre == "estimate" else (plus + minus) / 2  # (12)
        theta, phi = seen(m)
        b = np.linalg.norm(f(theta + sa, phi)[0] - f(theta - sa, phi)[0], axis=-1) / 2  # (14)
        along = np.where(
            (a > 0)[..., None], (plus - minus) / np.where(a > 0, 2 * a, 1.0)[..., None], (1.0, 0.0)
        )
        a, b = (np.maximum(axis, self.least_axis) for axis in (a, b))
        across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        return m, np.stack([a[..., None] * along, b[..., None] * across], axis=-1)  # (16), (17)

    def selected(self, m: Array, L: Array) -> np.ndarray:
        """S2: indices, increasing, of the ellipses m (B, 2), L (B, 2, 2) in the set M*; none if no
        two ellipses agree.
        """
        if not self.vote:
            return np.arange(len(m))
        if self.intersection == "boxes":
            half = ellipses.half_widths(L)
            lower, upper = m - half, m + half
            corners = np.stack(np.meshgrid(*lower.T), axis=-1).reshape(
                -1, 1, 2
            )  # a common box has its lower corner at one of these
            sets = ellipses.largest(np.all((lower <= corners) & (corners <= upper), axis=-1))
        # a common region has crossings as vertices, or it is one whole ellipse with its centre
        else:
            inside = [ellipses.levels(m, m, L) <= 1 + ellipses.TOUCH]
            for pair, p in ellipses.all_crossings(m, L).items():
                inside.append(ellipses.levels(p, m, L) <= 1 + ellipses.TOUCH)
                inside[-1][:, pair] = True
            sets = ellipses.largest(np.concatenate(inside))
        if len(sets[0]) < 2:
            return np.array([], dtype=int)
        best, chosen = -1.0, sets[0]
        for M in sets if len(sets) > 1 and self.ties == "area" else []:
            boxes = self.intersection == "boxes"
            common, union = (
                ellipses.box_areas(lower[M], upper[M]) if boxes else ellipses.areas(m[M], L[M])
            )
            if common / union > best + EVEN:  # (19)
                best, chosen = common / union, M
        return chosen
