"""The sum of squares of a whole track, its quadratic approximation, and the solution of that.

A state's share of the measurements is approximated about x_k by its information A = J^T W J and
g = J^T W v, with the derivatives J of h, the innovations v = y - h(x) and the weights W = 1 / r.
"""

from __future__ import annotations

from types import ModuleType
from typing import NamedTuple

import numpy as np

from aoabench.filters.belief import Belief
from aoabench.filters.compiled import kind_of
from aoabench.filters.roots import near
from aoabench.filters.smoother import KERNELS, at_step, backward_pass, predicted
from aoabench.kernels.loading import load
from aoabench.maths.geometry import Array
from aoabench.maths.linalg import cholesky
from aoabench.roles import Measurement
from aoabench.types import Anchors, Batch

ELEMENTS = 2**21  # numbers of a block of derivatives
NO_NOISE = 1e-12  # eigenvalue of a correlation matrix below which there is no noise


class Quadratic(NamedTuple):
    """Sums of squares (R, T) of each step's measurements, and their information A (R, T, n, n) and
    g (R, T, n) about the deviation of each state.
    """

    squares: Array
    A: Array
    g: Array

    @classmethod
    def empty(cls, x: Array) -> Quadratic:
        """Arrays for states x (R, T, n)."""
        return cls(np.zeros(x.shape[:2]), np.zeros((*x.shape, x.shape[-1])), np.zeros(x.shape))

    def damped(self, more: Array) -> Quadratic:
        """With the precisions `more` (R, T, n) of no deviation."""
        A, n = self.A.copy(), self.A.shape[-1]
        A[..., range(n), range(n)] += more
        return self._replace(A=A)


class TrackModel(NamedTuple):
    """Measurement model h, measurements y (R, T, m), NaN = not measured, with nominal variances
    (R, T, m), and anchors; prior mean (R, n) and covariance (1, n, n); F and Q (R|1, T|1, n, n);
    roots of the inverse covariances of the first state (R|1, n, n) and of Q.
    """

    h: Measurement
    y: Array
    quality: Array
    anchors: Anchors
    mean: Array
    prior: Array
    F: Array
    Q: Array
    first: Array
    later: Array
    engine: str

    @classmethod
    def of(cls, h: Measurement, batch: Batch, belief: Belief, engine: str) -> TrackModel:
        """The model of a tile."""
        F, Q = np.ascontiguousarray(belief.F), np.ascontiguousarray(belief.Q)
        prior = np.ascontiguousarray(belief.covariance, dtype=float)[None]
        first = inverse_root(predicted(prior, at_step(F, 0), at_step(Q, 0)))
        mean = np.ascontiguousarray(belief.mean, dtype=float)
        given = h, *h.observe(batch), batch.anchors
        return cls(*given, mean, prior, F, Q, first, inverse_root(Q), engine)

    def weights(self, x: Array, deviations: Array) -> Array:
        """1 / r (R, T, m) of the measurements at states x (R, T, n) with `deviations` (R, T, n).

        0 for a measurement that is missing, or whose anchor is too near to the state for a
        derivative (`roots.near`).
        """
        found = np.zeros(self.y.shape)
        for some in self._blocks(x):
            states, anchors = self._rows(x, some), self._anchors(some)
            r = self.h.covariance(states, anchors, self._rows(self.quality, some))
            close = near(states, self._rows(deviations, some)[..., None], anchors)
            close = np.repeat(close, self.y.shape[-1] // anchors.count, axis=1)
            used = np.isfinite(self._rows(self.y, some)) & ~close & (r > 0)
            found[:, some] = np.where(used, 1 / r, 0.0).reshape(len(x), -1, self.y.shape[-1])
        return found

    def quadratic(self, x: Array, weights: Array, which: np.ndarray, into: Quadratic) -> Quadratic:
        """The measurements' squares and information about states x (R, T, n) of the replications
        `which` in place of those of `into`, which is returned.

        NumPy computes all replications, so that the bits of one do not depend on the others.
        """
        kind, kernels = kind_of(self.h, self.engine), self._kernels()
        if kind is None or kernels is None:
            return self._quadratic(x, weights)
        data = x, self.y, weights, self.anchors.position, self.anchors.rotation
        given = (np.ascontiguousarray(array, dtype=float) for array in data)
        kernels.information(kind, which, *given, *into)
        return into

    def _quadratic(self, x: Array, weights: Array) -> Quadratic:
        found, n = Quadratic.empty(x), x.shape[-1]
        for some in self._blocks(x):
            states, anchors, W = self._rows(x, some), self._anchors(some), self._rows(weights, some)
            v = self.h.residual(self._rows(self.y, some), self.h.predict(states, anchors))
            v = np.where(W > 0, v, 0.0)
            J = np.where(W[..., None] > 0, self.h.jacobian(states, anchors), 0.0)
            WJ = np.swapaxes(W[..., None] * J, -1, -2)
            found.squares[:, some] = (W * v * v).sum(-1).reshape(len(x), -1)
            found.A[:, some] = (WJ @ J).reshape(len(x), -1, n, n)
            found.g[:, some] = (WJ @ v[..., None]).reshape(len(x), -1, n)
        return found

    def cost(self, x: Array, at: Quadratic, known: np.ndarray, which: np.ndarray) -> Array:
        """The sum of squares (R,) over the steps `known` (R, T) of states x (R, T, n), where `at`
        is their quadratic approximation; of replications not in `which`, any number.
        """
        kernels = self._kernels()
        if kernels is not None:
            motion, found = (self.mean, self.F, self.first, self.later), np.zeros(len(x))
            kernels.cost(which, known, x, at.squares, *motion, found)
            return found
        before = np.concatenate([self.mean[:, None], x[:, :-1]], axis=1)
        w = (x - (self.F @ before[..., None])[..., 0])[..., None]
        later = self.later[:, 1:] if self.later.shape[1] > 1 else self.later
        scaled = np.concatenate([self.first[:, None] @ w[:, :1], later @ w[:, 1:]], axis=1)
        total = at.squares + (scaled * scaled).sum(axis=(-1, -2))
        return np.where(known, total, 0.0).sum(axis=1)

    def solve(self, x: Array, at: Quadratic, which: np.ndarray) -> tuple[Array, Array]:
        """States (R, T, n) that minimise the quadratic approximation `at` about x, and covariances
        (R, T, n, n) of the normal distribution that it is the logarithm of; of replications not in
        `which`, any numbers.
        """
        s, P = x.copy(), np.zeros_like(at.A)
        kernels = self._kernels()
        if kernels is not None:
            kernels.forward(which, self.mean, self.prior, self.F, self.Q, at.A, at.g, x, s, P)
            kernels.backward(which, self.F, self.Q, s, P)
            return s, P
        m, C = self.mean, np.broadcast_to(self.prior, (len(x), *self.prior.shape[1:]))
        for k in range(x.shape[1]):
            F = at_step(self.F, k)
            m, C = (F @ m[..., None])[..., 0], predicted(C, F, at_step(self.Q, k))
            C = informed(C, at.A[:, k])
            u = at.g[:, k] - (at.A[:, k] @ (m - x[:, k])[..., None])[..., 0]
            m = m + (C @ u[..., None])[..., 0]
            s[:, k], P[:, k] = m, C
        return backward_pass(s, P, self.F, self.Q)

    def _kernels(self) -> ModuleType | None:
        return load(KERNELS) if self.engine == "auto" else None

    def _blocks(self, x: Array) -> list[slice]:
        """Blocks of steps whose derivatives fit into the memory."""
        R, T, n = x.shape
        size = max(ELEMENTS // (R * self.y.shape[-1] * n), 1)
        return [slice(k, min(k + size, T)) for k in range(0, T, size)]

    def _rows(self, array: Array, some: slice) -> Array:
        """The steps of a block of an array (R, T, ...), one after the other: (R t, ...)."""
        return np.ascontiguousarray(array[:, some]).reshape(-1, *array.shape[2:])

    def _anchors(self, some: slice) -> Anchors:
        """The anchors (R t|1, 1, B, ...) of a block."""
        if not self.anchors.moving and all(len(a) == 1 for a in self.anchors.arrays.values()):
            return self.anchors
        shape = len(self.y), some.stop - some.start
        here = self.anchors.at(np.arange(some.start, some.stop)).arrays.items()
        wide = {name: np.broadcast_to(a, (*shape, *a.shape[2:])) for name, a in here}
        return Anchors(**{name: a.reshape(-1, 1, *a.shape[2:]) for name, a in wide.items()})


def informed(P: Array, A: Array) -> Array:
    """(P^-1 + A)^-1 (R, n, n) as L (I + L^T A L)^-1 L^T, P = L L^T, which is positive definite."""
    L = cholesky(P)
    Lt = np.swapaxes(L, -1, -2)
    K = np.linalg.solve(cholesky(np.eye(P.shape[-1]) + Lt @ A @ L), Lt)
    return np.swapaxes(K, -1, -2) @ K


def inverse_root(Q: Array) -> Array:
    """W (..., n, n) with w^T Q^-1 w = |W w|^2 for every w = Q z; Q (..., n, n) may be singular.

    A direction without noise, in which w is 0 up to rounding, is left out.
    """
    variance = np.einsum("...ii->...i", Q)
    scale = np.sqrt(np.where(variance > 0, variance, 1.0))
    R = Q / (scale[..., :, None] * scale[..., None, :])
    finite = np.isfinite(R).all((-1, -2))[..., None]
    values, vectors = np.linalg.eigh(np.where(finite[..., None], R, 0.0))
    root = np.where(values > NO_NOISE, 1 / np.sqrt(np.maximum(values, NO_NOISE)), 0.0)
    root = np.where(finite, root, np.nan)
    W = root[..., :, None] * np.swapaxes(vectors, -1, -2) / scale[..., None, :]
    return np.ascontiguousarray(W)
