"""Laws: what a change of the world does to the estimates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aoabench.maths.geometry import Array, euler
from aoabench.testing import worlds
from aoabench.testing.rules import NotTried
from aoabench.testing.trial import Trial, taken_back
from aoabench.types import Batch

SHIFT = np.array([5e5, 5e6, 0.0])  # m, as onto a national grid
ABOUT_Z, IN_SPACE = np.array([0.0, 0.0, 2.2]), np.array([0.7, -0.4, 2.2])
NO_SHIFT, NO_TURN = np.zeros(3), np.eye(3)


def permuted(trial: Trial) -> str:
    """Whether the order of the anchors matters."""
    order = np.roll(np.arange(trial.batch.azimuth.shape[2]), 1)
    return _moved(trial, worlds.permuted(trial.batch, order), "permuting the anchors")


def shifted(trial: Trial) -> str:
    """Whether the place of the origin matters."""
    words = "moving the world by (5e5, 5e6, 0) m, as onto a national grid,"
    return _moved(trial, worlds.shifted(trial.batch, SHIFT), words, by=SHIFT)


def turned(trial: Trial) -> str:
    """Whether the direction of the x axis matters."""
    return _turned(trial, ABOUT_Z, "turning the world about the vertical")


def rotated(trial: Trial) -> str:
    """Whether the direction of the z axis matters."""
    if "height" in trial.estimator.needs:
        raise NotTried("its plane of known height is horizontal")
    return _turned(trial, IN_SPACE, "rotating the world in space")


def _turned(trial: Trial, angles: Array, words: str) -> str:
    turn, motion = euler(angles), trial.scenario.motion
    if "motion" in trial.estimator.needs and motion is not None:
        F, Q = (np.asarray(A) for A in motion.matrices(0.7))
        if F.shape[-1] % 3:
            raise NotTried("the state of the motion model does not consist of vectors in space")
        whole = worlds.blocks(turn, F.shape[-1])
        if not all(np.allclose(whole @ A @ whole.T, A, rtol=1e-9, atol=1e-12) for A in (F, Q)):
            raise NotTried("the motion model is not the same in all directions")
    return _moved(trial, worlds.rotated(trial.batch, turn), words, turn=turn)


def azimuths(trial: Trial) -> str:
    """Whether the jump of azimuths at +-180 deg matters."""
    words = "turning each anchor's frame so that azimuths jump from 180 to -180 deg"
    return _moved(trial, worlds.across_the_jump(trial.batch), words)


def _moved(
    trial: Trial, batch: Batch, words: str, turn: Array = NO_TURN, by: Array = NO_SHIFT
) -> str:
    """How a changed world changes the estimates, which are taken back to the axes before."""
    trial.require_exact()
    truth = trial.truth.copy()
    truth[..., :3] = truth[..., :3] @ turn.T + by
    found = taken_back(trial.run(batch, truth, scenario=trial.open_space), turn, by)
    problem = trial.apart(replace(trial.free, covariance=None), found)
    return f"{words} {problem}" if problem else ""
