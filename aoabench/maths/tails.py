"""Whether a few units decide a mean square."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike


def largest_share(squares: ArrayLike) -> float:
    """Share of the sum of `squares` (N,) that the largest of them holds; NaN values are left out.
    NaN without any, or if all are 0.
    """
    x = np.asarray(squares, dtype=float)
    x = x[np.isfinite(x)]
    total = float(x.sum())
    return float(x.max()) / total if total > 0 else math.nan


def usual_share(n: int, level: float = 0.05) -> float:
    """The share that the largest of n independent exponential values exceeds with the probability
    `level`, or less [Fisher 1929, to first order, which is exact above 1/2]; 1 for n = 1.

    The square of a normal error in the plane is exponential. A mean of several such squares, which
    is what most units are, has a lighter tail and a smaller share.
    """
    return 1 - (level / n) ** (1 / (n - 1)) if n > 1 else 1.0
