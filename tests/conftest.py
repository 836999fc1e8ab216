"""Shared pieces: the shipped configs as cells, and runs in a temporary folder."""

from __future__ import annotations

import os

import numpy as np
import pytest

os.environ.setdefault("MPLBACKEND", "Agg")

from aoabench.models.motion import RandomWalk
from aoabench.scenarios.layout import AnchorLayout
from aoabench.scenarios.square_track import SquareTrack
from tests import helpers

pytest.approx = helpers.approx
np.allclose, np.isclose = helpers.stated(np.allclose), helpers.stated(np.isclose)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20180710)


@pytest.fixture
def track() -> SquareTrack:
    layout = AnchorLayout(
        [[-1, 0, 0], [6, 0, 0], [6, 5, 0], [-1, 5, 0]],
        [[1, 0, 0], [-1, 0, 0], [-1, 0, 0], [1, 0, 0]],
    )
    return SquareTrack("square_track", layout, RandomWalk())
