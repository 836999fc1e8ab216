"""How measurement components and state derivatives are laid out; shared by the measurement models."""

from __future__ import annotations

import numpy as np

from aoabench.geometry import Array


def flat(a: Array) -> Array:
    """(..., B, d) -> (..., B d): components in anchor order."""
    return a.reshape(*a.shape[:-2], -1)


def into_state(block: Array, n: int) -> Array:
    """Derivatives (..., B, d, 3) by the position to (..., B d, n) by the state, whose first three are the position."""
    J = block.reshape(*block.shape[:-3], -1, 3)
    return J if n == 3 else np.concatenate([J, np.zeros((*J.shape[:-1], n - 3))], axis=-1)


def per_step(quality: Array, x: Array) -> Array:
    """One step's values (R, m) made to broadcast against those of x (R, ..., n)."""
    return quality.reshape(quality.shape[0], *(1,) * (x.ndim - 2), quality.shape[1])
