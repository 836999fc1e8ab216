"""The square track: one lap past anchors whose poles look along two of its sides [Nurminen 2018,
IV-D].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import gamma

import numpy as np

from aoabench.errors import check_number
from aoabench.maths.geometry import Array
from aoabench.models.motion import RandomWalk
from aoabench.roles import Scenario
from aoabench.scenarios.layout import AnchorLayout
from aoabench.types import Anchors


@dataclass(frozen=True)
class SquareTrack(Scenario):
    """A target on a square of side `side_m` from (0, 0) counter-clockwise at height 0.

    Per step of `dt` s it travels l ~ N(q sqrt(2 dt) Gamma(1.5), 2 q^2 dt (1 - Gamma(1.5)^2)) m, q =
    `q_xy` m/s^(1/2) [(12); negative lengths are kept]; 64 steps of 0.25 s make one lap. Filters
    believe `motion` and start from a mean drawn from N(true start, prior_sigma_m^2 I).
    """

    name: str
    anchors: AnchorLayout
    motion: RandomWalk = field()
    side_m: float = 5.0
    steps: int = 64
    dt: float = 0.25
    q_xy: float = 0.5
    prior_sigma_m: float = 1.0

    def __post_init__(self) -> None:
        check_number("side_m", self.side_m, least=1e-3, most=1e6)
        check_number("steps", self.steps, least=1, most=1_000_000, integer=True)
        check_number("dt", self.dt, least=1e-6, most=1e6)
        check_number("q_xy", self.q_xy, least=1e-6, most=1e6)
        check_number("prior_sigma_m", self.prior_sigma_m, least=1e-6, most=1e6)

    @cached_property
    def true_anchors(self) -> Anchors:
        """The anchors as they are."""
        return self.anchors.known

    def step_length(self) -> tuple[float, float]:
        """Mean and standard deviation of one step's length in m [(12)]."""
        scale, g = self.q_xy * np.sqrt(2 * self.dt), gamma(1.5)
        return float(scale * g), float(scale * np.sqrt(1 - g**2))

    def truth(self, rng: np.random.Generator) -> Array:
        """True positions (T, 3) m after each step."""
        mean, sigma = self.step_length()
        return self.at(np.cumsum(mean + sigma * rng.standard_normal(self.steps)))

    def at(self, arc_m: Array) -> Array:
        """Positions (..., 3) m at arc lengths (...) m from the start."""
        side, s = self.side_m, np.mod(arc_m, 4 * self.side_m)
        x = np.clip(s, 0, side) - np.clip(s - 2 * side, 0, side)
        y = np.clip(s - side, 0, side) - np.clip(s - 3 * side, 0, side)
        return np.stack([x, y, np.zeros_like(x)], axis=-1)

    def prior(self, rng: np.random.Generator, truth: Array) -> tuple[Array, Array]:
        """Mean (3,) m drawn around the true start (0, 0, 0), and covariance (3, 3) m^2."""
        return self.prior_sigma_m * rng.standard_normal(3), self.prior_sigma_m**2 * np.eye(3)
