"""Whether a kernel equals its reference but for rounding, fix by fix and on any processor.

Two programs that are both right give the estimates of measurements that differ by a few eps. So the
tolerance of each fix is how far the estimate moves when its measurements do: a fix whose iteration
wanders, or two ellipses that nearly touch, may be far apart, and all others may not.
"""

from dataclasses import replace

import numpy as np

EPS = np.finfo(float).eps
MEASURED = ("azimuth", "elevation", "delay")


def moved_by_rounding(estimate, batch, copies=8):
    """Largest change of position and of covariance (2, R, T) over copies of the batch.

    Each measurement of a copy is off by up to 4 eps of itself; `estimate` is a function of a batch.
    """
    rng, exact = np.random.default_rng(0), estimate(batch)
    moved = np.zeros((2, *exact.outcome.shape))
    for _ in range(copies):
        given = {name: getattr(batch, name) for name in MEASURED}
        other = estimate(replace(batch, **{
            name: y * (1 + 4 * EPS * rng.uniform(-1, 1, y.shape)) for name, y in given.items() if y is not None
        }))  # fmt: skip
        moved[0] = np.maximum(moved[0], apart(exact.position, other.position))
        if exact.covariance is not None:
            moved[1] = np.maximum(moved[1], apart(exact.covariance, other.covariance))
    return np.where(np.isnan(moved), np.inf, moved)  # rounding decides whether it fails


def apart(a, b):
    """Largest distance of a component in each fix (R, T); components that are NaN in both count 0."""
    both = np.isnan(a) & np.isnan(b)
    return np.where(both, 0.0, np.abs(a - b)).reshape(*a.shape[:2], -1).max(-1)


def equal_but_for_rounding(fast, slow, moved, where=...):
    """Assert it of the estimates of two engines, and `moved` by rounding, in the fixes `where`.

    The factor 50 is ten times the largest that was seen over all kernels, with AVX-512, AVX2 and
    SSE2. 1e-14 of the largest component are the roundings that measurements have no part in.
    """
    for name, by in zip(("position", "covariance"), moved):
        a, b = getattr(fast, name), getattr(slow, name)
        if b is not None:
            least = 1e-14 * np.nanmax(np.abs(b), initial=0.0)
            assert np.all((apart(a, b) <= 50 * (by + least))[where])
