"""One lap of a square track past anchors whose poles point along two of its sides [Nurminen 2018,
IV-D].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import gamma

import numpy as np

from aoabench.errors import BadValue
from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import Motion, Scenario
from aoabench.scenarios.layout import AnchorLayout
from aoabench.scenarios.parameters import dt_param, layout_param, name_param
from aoabench.types import Anchors


@dataclass(frozen=True)
class SquareTrack(Scenario):
    """A target on a square from (0, 0) counter-clockwise at height 0.

    Per step it travels l ~ N(q sqrt(2 dt) Gamma(1.5), 2 q^2 dt (1 - Gamma(1.5)^2)) m, q = `q_xy`
    [(12); negative lengths are kept]; 64 steps of 0.25 s make one lap. Filters start from a mean
    drawn from N(true start, prior_sigma_m^2 I).
    """

    name: str = name_param()
    anchors: AnchorLayout = layout_param()
    motion: Motion = param(help="motion model that filters assume", kind=Motion)
    side_m: float = param(5.0, "side of the square", unit="m", least=1e-3, most=1e6)
    steps: int = param(64, "number of steps", least=1, most=1_000_000)
    dt: float = dt_param(0.25)
    q_xy: float = param(0.5, "scale q of the step lengths", unit="m/s^(1/2)", least=1e-6, most=1e6)
    prior_sigma_m: float = param(
        1.0,
        "standard deviation of the filters' initial mean, which they know",
        unit="m",
        least=1e-6,
        most=1e6,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.motion.matrices(self.dt)[0]) != 3:
            raise BadValue("motion", self.motion, "a motion model of the position (3 numbers)")

    @cached_property
    def true_anchors(self) -> Anchors:
        """The true anchors (1, 1, B, ...)."""
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
