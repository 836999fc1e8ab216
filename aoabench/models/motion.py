"""Motion models of filters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import Motion


@dataclass(frozen=True)
class RandomWalk(Motion):
    """theta_k = theta_{k-1} + w, w ~ N(0, dt diag(q_xy^2, q_xy^2, q_z^2)) [Nurminen 2018, (13)]."""

    q_xy: float = param(0.5, "spread in x and in y", unit="m/s^(1/2)", least=1e-6, most=1e6)
    q_z: float = param(0.1, "spread in z", unit="m/s^(1/2)", least=1e-6, most=1e6)

    def matrices(self, dt: float) -> tuple[Array, Array]:
        """F (3, 3) and Q (3, 3) m^2 for a step of dt s."""
        return np.eye(3), dt * np.diag([self.q_xy**2, self.q_xy**2, self.q_z**2])


@dataclass(frozen=True)
class ConstantAcceleration(Motion):
    """s_k = F s_{k-1} + w, w ~ N(0, Q), for the state x, y, z, vx, vy, vz, ax, ay, az [Lu 2019,
    (15), (19)].

    The acceleration is a Wiener process: the jerk is white in each direction.
    """

    q: float = param(help="spectral density of the jerk", unit="m^2/s^5", above=0, most=1e6)

    def matrices(self, dt: float) -> tuple[Array, Array]:
        """F (9, 9) and Q (9, 9) for a step of dt s; positions in m, velocities in m/s,
        accelerations in m/s^2.
        """
        F = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])
        Q = np.array([
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ])  # fmt: skip
        return np.kron(F, np.eye(3)), self.q * np.kron(Q, np.eye(3))
