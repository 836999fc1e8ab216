"""Positions on the floor of the standard room, each from one anchor alone with errors of its
angles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aoabench.config.compose import compose_cells
from aoabench.maths.geometry import in_frames, to_azel
from aoabench.types import Anchors

ROOM = 10.0  # m, the sides of the standard room
SLOPE = np.tan(np.deg2rad(0.1))  # of the flattest ray that meets the floor


class Turns(NamedTuple):
    """Sines and cosines (2, B, N) of the errors of azimuth and elevation at B anchors in N
    samples.
    """

    sin: np.ndarray
    cos: np.ndarray

    @classmethod
    def of(cls, errors: np.ndarray) -> Turns:
        """Those of angle errors (2, N, B) rad."""
        e = np.ascontiguousarray(np.swapaxes(errors, 1, 2))
        return cls(np.sin(e), np.cos(e))


def standard_room(which: str = "") -> Anchors:
    """Anchors of scenario=standard_room, A, B and C of Figure 3, or of standard_room_1 ... _4,
    those of Figure 2.
    """
    words = [f"scenario=standard_room{which}", "noise=ae_normal", "estimator=[anchor_mean]"]
    return compose_cells(words)[0].scenario.true_anchors


def upright(position: np.ndarray) -> Anchors:
    """Anchors (B, 3) m whose frames are the global one."""
    return Anchors(position, np.broadcast_to(np.eye(3), (len(position), 3, 3)))


def floor_of(step: float) -> np.ndarray:
    """Points (P, 3) m on the floor in the middle of squares with sides of `step` m."""
    side = np.arange(step / 2, ROOM, step)
    return np.array([(x, y, 0.0) for x in side for y in side])


def normal_errors(n: int, anchors: int) -> np.ndarray:
    """Angle errors (2, n, anchors) rad of 10 deg, the same for every point."""
    return np.deg2rad(10.0) * np.random.default_rng(2024).standard_normal((2, n, anchors))


def single_positions(node: np.ndarray, anchors: np.ndarray, turns: Turns, clip: bool) -> np.ndarray:
    """x and y (2, B, N) m of a node (3,) m, each from one of the upright anchors (B, 3) m above it
    alone, with angle errors; with `clip`, moved into the room.

    The sines and cosines of the erroneous angles follow from those of the errors, which all nodes
    share.
    """
    a = upright(anchors)
    true = np.stack(to_azel(*in_frames(node[None, None], a.position, a.rotation)))[:, 0, 0, :, None]
    s, c = np.sin(true), np.cos(true)
    sin, cos = s * turns.cos + c * turns.sin, c * turns.cos - s * turns.sin
    above = (anchors[:, 2] - node[2])[:, None]
    reach = above * cos[1] / np.maximum(-sin[1], np.abs(cos[1]) * SLOPE)
    xy = np.stack([cos[0], sin[0]])
    xy *= reach
    xy += anchors.T[:2, :, None]
    return np.clip(xy, 0.0, ROOM, out=xy) if clip else xy
