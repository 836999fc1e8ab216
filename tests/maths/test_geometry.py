"""Directions, frames and wrapping against closed forms and finite checks."""

import numpy as np
import pytest

from aoabench.maths import geometry as g


def test_wrap_stays_in_the_half_open_interval(rng):
    a = np.concatenate(
        [rng.uniform(-50, 50, 10_000), np.pi * np.arange(-9, 10), [1e-17, -1e-17, 0.0]]
    )
    w = g.wrap(a)
    assert np.all((w > -np.pi) & (w <= np.pi))
    assert np.allclose(np.exp(1j * w), np.exp(1j * a), atol=1e-13)
    assert g.wrap(-np.pi) == np.pi


def test_azel_and_unit_vectors_are_inverse(rng):
    az, el = rng.uniform(-np.pi, np.pi, 10_000), rng.uniform(-np.pi / 2, np.pi / 2, 10_000)
    u = g.to_unit(az, el)
    assert np.allclose(np.linalg.norm(u, axis=-1), 1, atol=1e-15)
    az2, el2 = g.to_azel(*(3.7 * u.T))
    assert np.allclose(az2, az, atol=1e-9)
    assert np.allclose(el2, el, atol=1e-9)


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_azimuth_of_an_exact_pole_is_zero(zero):
    assert g.to_azel(zero, zero, 1.0) == (0.0, np.pi / 2)
    assert g.to_azel(zero, -0.0, -2.0) == (0.0, -np.pi / 2)


@pytest.mark.parametrize(
    "direction", [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [1, 2, 3], [0, 0, 1], [0, 0, -2]]
)
def test_facing_rotations_are_proper_and_turn_the_direction_into_the_pole(direction):
    R = g.facing(direction)
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-15)
    assert np.isclose(np.linalg.det(R), 1)
    assert np.allclose(R @ np.array(direction) / np.linalg.norm(direction), [0, 0, 1], atol=1e-15)
    if direction[2] == 0:
        assert np.allclose(R[1], [0, 0, 1]), "second row: up"
        assert R[0, 2] == 0, "first row: horizontal"


def test_facing_refuses_a_zero_direction():
    with pytest.raises(ValueError, match="zero"):
        g.facing([0, 0, 0])


def test_points_in_anchor_frames_equal_the_plain_product(rng):
    position, rotation = (
        rng.normal(size=(1, 5, 3)),
        np.stack([g.euler(rng.normal(size=3)) for _ in range(5)])[None],
    )
    for shape in [(7, 3), (7, 4, 3)]:
        p = rng.normal(size=shape)
        plain = np.einsum("bij,...bj->...bi", rotation[0], p[..., None, :] - position[0])
        assert np.allclose(np.stack(g.in_frames(p, position, rotation), axis=-1), plain, atol=1e-14)


def test_tangent_basis_is_orthonormal_everywhere(rng):
    u = rng.normal(size=(10_000, 3))
    u = np.concatenate([u / np.linalg.norm(u, axis=1, keepdims=True), np.eye(3), -np.eye(3)])
    e1, e2 = g.tangent_basis(u)
    frame = np.stack([e1, e2, u], axis=-2)
    assert np.allclose(frame @ np.swapaxes(frame, -1, -2), np.eye(3), atol=1e-14)
    assert np.allclose(np.linalg.det(frame), 1)
