"""Directions and frames: azimuth and elevation, unit vectors, anchor frames, wrapping.

Azimuth is measured from the frame's +x towards +y in (-pi, pi], elevation from its xy-plane towards
+z in [-pi/2, pi/2]; the poles are +-z, where the azimuth is undefined and taken as 0. All functions
broadcast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

LIGHT = 299_792_458.0  # m/s


def wrap(angle: ArrayLike) -> Array:
    """Angle (...) rad wrapped into (-pi, pi]."""
    a = np.asarray(angle, dtype=float)
    a = a - 2 * np.pi * np.rint(a / (2 * np.pi))
    return np.where(a <= -np.pi, np.pi, np.minimum(a, np.pi))  # rounding may exceed pi


def to_unit(azimuth: ArrayLike, elevation: ArrayLike) -> Array:
    """Unit vectors (..., 3) from azimuth and elevation (...) rad [Nurminen 2018, (3)]."""
    c = np.cos(elevation)
    z = np.sin(elevation)
    return np.stack(np.broadcast_arrays(np.cos(azimuth) * c, np.sin(azimuth) * c, z), axis=-1)


def to_azel(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Array, Array]:
    """Azimuth and elevation (...) rad from components (...) of vectors of any length; azimuth 0 at
    an exact pole.
    """
    x, y = (
        np.asarray(x) + 0.0,
        np.asarray(y) + 0.0,
    )  # -0.0 would turn the undefined azimuth of a pole into pi
    return np.arctan2(y, x), np.arctan2(z, np.sqrt(x * x + y * y))


def in_frames(point: ArrayLike, position: Array, rotation: Array) -> tuple[Array, Array, Array]:
    """x, y, z (R, ..., B) m of points in each anchor's frame, R_j (theta - s_j).

    point (R, ..., 3) m, position (R|1, B, 3) m, rotation (R|1, B, 3, 3); or, with a common second
    axis, point (R, T, ..., 3) m, position (R|1, T|1, B, 3) m, rotation (R|1, T|1, B, 3, 3).
    """
    p = np.asarray(point, dtype=float)
    s = _aligned(position, p.ndim - 1, 2)
    R = _aligned(rotation, p.ndim - 1, 3)
    dx, dy, dz = (p[..., i, None] - s[..., i] for i in range(3))
    x, y, z = (R[..., i, 0] * dx + R[..., i, 1] * dy + R[..., i, 2] * dz for i in range(3))
    return x, y, z


def rotations_for(point: Array, rotation: Array) -> Array:
    """Rotations (R|1, B, 3, 3) with axes of length 1 inserted after the first, to broadcast with
    points (R, ..., n).
    """
    return _aligned(rotation, point.ndim - 1, 3)


def _aligned(array: Array, leading: int, own: int) -> Array:
    """The array with `leading` axes in front of its last `own` axes: axes of length 1 are inserted
    after its leading axes.
    """
    split = array.ndim - own
    return array.reshape(*array.shape[:split], *(1,) * (leading - split), *array.shape[split:])


def facing(direction: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Array:
    """Rotation (..., 3, 3), global to anchor frame, of an anchor whose pole points along
    `direction` (..., 3).

    Its rows are the horizontal local x, the local y ("up") and the direction itself; a vertical
    direction takes the global y as up. Raises ValueError for a direction of length 0.
    """
    z = np.asarray(direction, dtype=float)
    length = np.linalg.norm(z, axis=-1, keepdims=True)
    if not np.all(length > 0):
        raise ValueError("a facing direction must not be zero")
    z = z / length
    vertical = (
        np.linalg.norm(np.cross(np.broadcast_to(up, z.shape), z), axis=-1, keepdims=True) < 1e-12
    )
    x = np.cross(np.where(vertical, (0.0, 1.0, 0.0), up), z)
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-2)


def euler(roll_pitch_yaw: ArrayLike) -> Array:
    """Rotation matrix (3, 3) = Rz(yaw) Ry(pitch) Rx(roll) from three angles in rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(roll_pitch_yaw), np.sin(roll_pitch_yaw)
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return rz @ ry @ rx


def tangent_basis(direction: Array) -> tuple[Array, Array]:
    """Two unit vectors (..., 3) that complete unit vectors (..., 3) to a right-handed orthonormal
    frame.

    Without a singular direction and without branches (Duff et al., JCGT 2017).
    """
    x, y, z = direction[..., 0], direction[..., 1], direction[..., 2]
    s = np.copysign(1.0, z)
    a = -1.0 / (s + z)
    b = x * y * a
    return (
        np.stack([1.0 + s * x * x * a, s * b, -s * x], axis=-1),
        np.stack([b, s + y * y * a, -y], axis=-1),
    )


def euler_of(matrix: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw in rad of a rotation matrix (3, 3); the inverse of `geometry.euler`."""
    level = np.hypot(matrix[0, 0], matrix[1, 0])
    pitch = np.arctan2(-matrix[2, 0], level)
    if level < 1e-12:  # roll and yaw turn about the same axis
        return 0.0, float(pitch), float(np.arctan2(-matrix[0, 1], matrix[1, 1]))
    roll, yaw = np.arctan2(matrix[2, 1], matrix[2, 2]), np.arctan2(matrix[1, 0], matrix[0, 0])
    return float(roll), float(pitch), float(yaw)
