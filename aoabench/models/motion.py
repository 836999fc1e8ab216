"""Motion models that filters believe in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aoabench.geometry import Array
from aoabench.types import check_number


@dataclass(frozen=True)
class RandomWalk:
    """theta_k = theta_{k-1} + w, w ~ N(0, dt diag(q_xy^2, q_xy^2, q_z^2)) [Nurminen 2018, (13)]; q in m / s^(1/2)."""

    q_xy: float = 0.5
    q_z: float = 0.1

    def __post_init__(self) -> None:
        check_number("q_xy", self.q_xy, least=1e-6, most=1e6)
        check_number("q_z", self.q_z, least=1e-6, most=1e6)

    def matrices(self, dt: float) -> tuple[Array, Array]:
        """F (3, 3) and Q (3, 3) m^2 for a step of dt s."""
        return np.eye(3), dt * np.diag([self.q_xy**2, self.q_xy**2, self.q_z**2])
