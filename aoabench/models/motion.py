"""Motion models of filters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import Motion

_AXES = np.eye(3)


@dataclass(frozen=True)
class RandomWalk(Motion):
    """theta_k = theta_{k-1} + w, w ~ N(0, dt diag(q_xy^2, q_xy^2, q_z^2)) [Nurminen 2018, (13)].

    The defaults suit a walking person.
    """

    q_xy: float = param(0.5, "spread in x and in y", unit="m/s^(1/2)", least=1e-6, most=1e6)
    q_z: float = param(0.1, "spread in z", unit="m/s^(1/2)", least=1e-6, most=1e6)

    def matrices(self, dt: float | Array) -> tuple[Array, Array]:
        """F (3, 3), or (1, ..., 1, 3, 3), and Q (..., 3, 3) m^2 for steps of dt (...) s."""
        Q = np.asarray(dt)[..., None, None] * np.diag([self.q_xy**2, self.q_xy**2, self.q_z**2])
        return _AXES.reshape((1,) * np.ndim(dt) + (3, 3)), Q


@dataclass(frozen=True)
class ConstantVelocity(Motion):
    """s_k = F s_{k-1} + w, w ~ N(0, Q), for the state x, y, z, vx, vy, vz.

    The acceleration is white in each direction, with the spectral density q^2. The defaults suit a
    walking person, whose speed changes by some 0.5 m/s in a second.
    """

    q_xy: float = param(0.5, "spread of vx and of vy", unit="m/s^(3/2)", least=1e-6, most=1e6)
    q_z: float = param(0.1, "spread of vz", unit="m/s^(3/2)", least=1e-6, most=1e6)
    speed_xy: float = param(
        1.0, "standard deviation of vx and of vy at a filter's start", unit="m/s", above=0, most=1e4
    )
    speed_z: float = param(
        0.1, "standard deviation of vz at a filter's start", unit="m/s", above=0, most=1e4
    )

    def matrices(self, dt: float | Array) -> tuple[Array, Array]:
        """F and Q (..., 6, 6) for steps of dt (...) s; positions in m, velocities in m/s."""
        one, zero = dt * 0 + 1, dt * 0
        F = _blocks([[one, dt], [zero, one]], np.ones(3))
        density = np.array([self.q_xy**2, self.q_xy**2, self.q_z**2])
        return F, _blocks([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], density)

    def start(self) -> Array:
        """Standard deviations (3,) m/s of the velocity."""
        return np.array([self.speed_xy, self.speed_xy, self.speed_z])


@dataclass(frozen=True)
class ConstantAcceleration(Motion):
    """s_k = F s_{k-1} + w, w ~ N(0, Q), for the state x, y, z, vx, vy, vz, ax, ay, az [Lu 2019,
    (15), (19)].

    The acceleration is a Wiener process: the jerk is white in each direction.
    """

    q: float = param(help="spectral density of the jerk", unit="m^2/s^5", above=0, most=1e6)

    def matrices(self, dt: float | Array) -> tuple[Array, Array]:
        """F and Q (..., 9, 9) for steps of dt (...) s; positions in m, velocities in m/s,
        accelerations in m/s^2.
        """
        one, zero = dt * 0 + 1, dt * 0
        F = [[one, dt, dt**2 / 2], [zero, one, dt], [zero, zero, one]]
        Q = [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ]
        return _blocks(F, np.ones(3)), _blocks(Q, np.full(3, self.q))

    def start(self) -> Array:
        """Standard deviations (6,): 1 m/s of each velocity, and of the accelerations what the jerk
        adds to them in 1 s.
        """
        return np.repeat([1.0, np.sqrt(self.q)], 3)


# motion models whose parameters all have defaults, by name
NAMED: dict[str, type[Motion]] = {"random_walk": RandomWalk, "constant_velocity": ConstantVelocity}


def motion_of(motion: Motion | str | None) -> Motion | None:
    """The motion model, or the one of a name of NAMED with its defaults."""
    return NAMED[motion]() if isinstance(motion, str) else motion


def _blocks(rows: list[list[float | Array]], axes: Array) -> Array:
    """Matrices (..., 3 k, 3 k) from entries (k, k), each (...), times diag(axes), axes (3,)."""
    entries = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    k = entries.shape[-1]
    blocks = entries[..., :, None, :, None] * np.diag(axes)[:, None, :]
    return blocks.reshape(*entries.shape[:-2], 3 * k, 3 * k)
