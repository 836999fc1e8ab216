"""What tests share beyond fixtures: comparisons that state by which tolerance they compare."""

import errno
import os
import struct
import sys
from functools import wraps

import numpy as np
import pytest

from aoabench.maths.geometry import to_unit
from aoabench.roles import Scenario

_approx, _REL, _ABS = pytest.approx, 1e-6, 1e-12  # pytest's own defaults
_RTOL, _ATOL = 1e-5, 1e-8  # NumPy's


def approx(expected, rel=None, abs=None, nan_ok=False):
    """`pytest.approx` that refuses to compare by its default absolute tolerance.

    pytest accepts the larger of `rel` times the expected value and `abs`, and `abs` is 1e-12 unless
    it is given: `0.0 == pytest.approx(3.1e-13)` is true. This raises ValueError where that default
    would be the larger one for any expected number, zero included. Such a comparison states either
    `rel` and `abs=0`, or a bound `abs` on the scale of the quantity. (`abs=0` without `rel` is
    refused too: pytest then compares exactly.) `conftest.py` puts this in place of `pytest.approx`.
    """
    numbers = _magnitudes(expected)
    if abs is None and np.any(numbers * (_REL if rel is None else rel) < _ABS):
        raise ValueError(
            f"approx of {numbers.min():.3g} would accept any error below {_ABS:g}; "
            "state rel and abs=0, or a bound abs on the quantity's scale"
        )
    if abs == 0 and rel is None:
        raise ValueError("approx with abs=0 and no rel compares exactly; state rel, or use ==")
    return _approx(expected, rel=rel, abs=abs, nan_ok=nan_ok)


def _magnitudes(expected):
    """Sizes (N,) of the finite numbers in a number, a sequence, an array or a mapping's values."""
    values = list(expected.values()) if isinstance(expected, dict) else expected
    try:
        sizes = np.abs(np.ravel(np.asarray(values, dtype=float)))
    except (TypeError, ValueError):  # a text or a date: no tolerance applies
        return np.empty(0)
    return sizes[np.isfinite(sizes)]


def stated(close):
    """`np.allclose` or `np.isclose` that refuses, in tests, to compare by its default `atol`.

    That is 1e-8 and is added to `rtol` times the expected size. This raises ValueError where `atol`
    is not given and the default would be the larger one for every expected number: the comparison
    then states `atol`, 0 or a bound on the scale of the quantity. Calls from elsewhere pass through.
    """

    @wraps(close)
    def checked(a, b, rtol=_RTOL, atol=None, equal_nan=False):
        if atol is None and sys._getframe(1).f_globals.get("__name__", "").startswith("tests."):
            sizes = _magnitudes(b)
            if len(sizes) and rtol * sizes.max() < _ATOL:
                raise ValueError(
                    f"{close.__name__} of at most {sizes.max():.3g} would accept any error below "
                    f"{_ATOL:g}; state atol"
                )
        return close(a, b, rtol, _ATOL if atol is None else atol, equal_nan)

    return checked


class Place(Scenario):
    """A scenario of nothing but anchors, and whatever else a test needs to say."""

    name = "place"

    def __init__(self, anchors, height_m=None, bounds_m=None, motion=None, dt=1.0):
        self._anchors, self._height, self._bounds = anchors, height_m, bounds_m
        self.motion, self.dt = motion, dt

    @property
    def true_anchors(self):
        return self._anchors

    @property
    def known_height_m(self):
        return self._height

    @property
    def bounds_m(self):
        return self._bounds


def directions(batch):
    """Measured directions (R, T, B, 3), unit vectors in the global frame; NaN if not measured."""
    u = to_unit(batch.azimuth, batch.elevation)
    return np.einsum("rtbi,rtbij->rtbj", u, np.broadcast_to(batch.anchors.rotation, (*u.shape, 3)))


class Msvcrt:
    """Windows' `msvcrt.locking` by Linux's locks of open files: a byte from the current position,
    held by one opening of the file.
    """

    LK_NBLCK = 2

    def __init__(self):
        self.places = []

    def locking(self, descriptor, mode, count):
        import fcntl  # POSIX alone

        assert (mode, count) == (self.LK_NBLCK, 1)
        self.places.append(os.lseek(descriptor, 0, os.SEEK_CUR))
        wanted = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_CUR, 0, count, 0)
        try:
            fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, wanted)
        except BlockingIOError:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES)) from None
