"""Quadratic forms of inverses against extended precision, and where a matrix is near-singular."""

import mpmath
import numpy as np
import pytest

from aoabench.maths.linalg import BLOCK, quadratic

LEAST = 1e-6


def turned(eigenvalues, rng):
    """Symmetric matrices (N, 3, 3) with the eigenvalues (N, 3) in random directions."""
    Q, _ = np.linalg.qr(rng.normal(size=(len(eigenvalues), 3, 3)))
    A = Q * np.asarray(eigenvalues)[:, None, :] @ np.swapaxes(Q, -1, -2)
    return (A + np.swapaxes(A, -1, -2)) / 2


def test_a_quadratic_form_is_that_of_extended_precision(rng):
    """A condition number of 10^k costs at most k of the sixteen digits."""
    eigenvalues = 10.0 ** -rng.uniform(0, 5.9, (200, 3))
    eigenvalues[:, 0] = 1.0
    A, g = turned(eigenvalues, rng), rng.normal(size=(200, 3))
    with mpmath.workdps(40):
        pairs = [(mpmath.matrix(m.tolist()), mpmath.matrix(v.tolist())) for m, v in zip(A, g)]
        exact = np.array([float((v.T * mpmath.lu_solve(m, v))[0]) for m, v in pairs])
    error = np.abs(quadratic(A, g, LEAST) - exact) / exact
    assert (error * eigenvalues.min(axis=1) < 20 * np.finfo(float).eps).all()


@pytest.mark.parametrize("scale", [1.0, 1e-150, 1e120])
@pytest.mark.parametrize("middle", [1.0, 1e-2, 1e-4, 0.0])
def test_a_matrix_counts_from_the_stated_ratio_of_eigenvalues_on(middle, scale, rng):
    low = LEAST * np.repeat([1 - 1e-4, 1 + 1e-4], 50)
    eigenvalues = scale * np.stack([np.ones(100), np.maximum(low, middle), low], axis=-1)
    found = quadratic(turned(eigenvalues, rng), rng.normal(size=(100, 3)), LEAST)
    assert np.isnan(found[:50]).all()
    assert (found[50:] > 0).all()


def test_which_matrices_count_is_what_the_eigenvalues_say(rng):
    A = turned(10.0 ** -rng.uniform(0, 9, (20_000, 3)), rng)
    A[::7] -= 0.1 * np.eye(3)
    spread = np.linalg.eigvalsh(A)
    wanted = spread[:, 0] > LEAST * spread[:, -1]
    assert 0.1 < wanted.mean() < 0.9
    assert np.array_equal(np.isfinite(quadratic(A, np.ones((len(A), 3)), LEAST)), wanted)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_matrix_with_one_entry_that_is_not_finite_gives_nan(value):
    A = np.tile(np.eye(3), (9, 1, 1))
    A[np.arange(9), np.arange(9) // 3, np.arange(9) % 3] = value
    assert np.isnan(quadratic(A, np.ones((9, 3)), LEAST)).all()


def test_a_quadratic_form_does_not_depend_on_the_matrices_around(rng):
    A = turned(rng.uniform(0.1, 1, (2 * BLOCK + 3, 3)), rng)
    g = rng.normal(size=(len(A), 3))
    whole = quadratic(A, g, LEAST)
    for i in (0, BLOCK - 1, BLOCK, len(A) - 1):
        assert quadratic(A[[i]], g[[i]], LEAST)[0] == whole[i]
    assert quadratic(A[:0], g[:0], LEAST).shape == (0,)
