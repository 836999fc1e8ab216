"""Measures of the error with bootstrap standard errors over campaigns.

Positions are clipped to the room, so that many errors are equal. At such an atom the jackknife of a
quantile is 0 or far too large; drawing whole campaigns with replacement is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from aoabench.maths.estimate import Estimate

from .common import rms

RESAMPLES = 400
BIN_M = 0.002  # m, resolution of the resampled quantiles
MOST_M = 12.0  # m, more than the room's diagonal


@dataclass(frozen=True)
class Resampled:
    """A number, and the same for each of the resamples (RESAMPLES,), which are the same for all
    numbers of as many campaigns.
    """

    value: float
    again: np.ndarray

    def __sub__(self, other: Resampled) -> Resampled:
        """The difference, paired over campaigns."""
        return Resampled(self.value - other.value, self.again - other.again)

    @property
    def estimate(self) -> Estimate:
        """The number with its standard error."""
        return Estimate(self.value, float(self.again.std(ddof=1)))


@cache
def weights(campaigns: int) -> np.ndarray:
    """How often each campaign occurs in each resample (RESAMPLES, campaigns)."""
    rng = np.random.default_rng(0)
    return rng.multinomial(campaigns, np.full(campaigns, 1 / campaigns), size=RESAMPLES)


def measures(e: np.ndarray) -> dict[str, Resampled]:
    """RMSE, CEP50 and CEP90 in m and `tail`, the 99 % quantile over the median, of the given errors
    (R, T) m; NaN: no fix.
    """
    w = weights(len(e))
    squares, given = np.nansum(e**2, axis=1), np.isfinite(e).sum(axis=1)
    edges = np.arange(0.0, MOST_M + BIN_M, BIN_M)
    counts = np.array([np.histogram(row[np.isfinite(row)], edges)[0] for row in e], dtype=float)
    below = np.cumsum(w @ counts, axis=1)
    middle = edges[:-1] + BIN_M / 2
    shares = (0.5, 0.9, 0.99)
    again = [middle[(below >= p * below[:, -1:]).argmax(axis=1)] for p in shares]
    value = np.nanquantile(e, shares)
    return {
        "rmse_m": Resampled(rms(e), np.sqrt((w @ squares) / (w @ given))),
        "cep50_m": Resampled(float(value[0]), again[0]),
        "cep90_m": Resampled(float(value[1]), again[1]),
        "tail": Resampled(float(value[2] / value[0]), again[2] / again[0]),
    }
