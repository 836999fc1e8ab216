"""The Fisher information of a noise, from its samples alone.

At one point, each anchor's error across the line of sight has a component along the azimuth and one
along the elevation, and a time of arrival adds one along the line. Each is taken as a location
parameter of its own distribution: its information is the integral of f'^2 / f, with the density f
and its derivative from a histogram whose cells are a fifth of the spread wide.
"""

from __future__ import annotations

import numpy as np

from aoabench.maths.geometry import LIGHT, Array, to_azel, wrap
from aoabench.roles import Noise, Scenario

SAMPLES, CELLS = 20_000, 5  # cells per deviation
LEAST = 30  # samples in a cell whose slope is used


def information_of(noise: Noise, scenario: Scenario, point: Array) -> Array:
    """Fisher information (3, 3) 1/m^2 of one set of measurements at a point (3,) m, from SAMPLES
    samples; its sampling error is some 5 % for a normal distribution.
    """
    states = scenario.truth(np.random.default_rng(1))
    truth = np.zeros((SAMPLES, states.shape[1]))
    truth[:, :3] = point
    found = noise.sample(np.random.default_rng(2), scenario, truth)
    s, R = (a[0] for a in scenario.true_anchors.frames)
    local = np.einsum("bij,bj->bi", R, point - s)
    azimuth, elevation = to_azel(*local.T)
    r = np.linalg.norm(local, axis=-1)
    errors = [
        wrap(found.azimuth - azimuth) * np.cos(elevation) * r,
        (found.elevation - elevation) * r,
    ]
    axes = [
        np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros_like(r)], axis=-1),
        np.stack(
            [
                -np.cos(azimuth) * np.sin(elevation),
                -np.sin(azimuth) * np.sin(elevation),
                np.cos(elevation),
            ],
            axis=-1,
        ),
    ]
    if found.delay is not None:
        errors.append(LIGHT * found.delay - r)
        axes.append(local / r[:, None])
    J = np.zeros((3, 3))
    for error, axis in zip(errors, axes):
        for b, e in enumerate(error.T):
            d = R[b].T @ axis[b]
            J += location_information(e) * np.outer(d, d)
    return J


def location_information(error: Array) -> float:
    """The Fisher information about the location of a distribution, from its samples (N,); 0 where
    nothing was measured.
    """
    known = error[np.isfinite(error)]
    if not len(known):
        return 0.0
    low, high = np.quantile(known, [0.16, 0.84])
    width = max((high - low) / 2, 1e-300) / CELLS
    middle = np.median(known)
    cells = np.arange(-8 * CELLS, 8 * CELLS + 1)
    count = np.histogram(known, middle + width * (np.append(cells, cells[-1] + 1) - 0.5))[0]
    before, here, after = count[:-2], count[1:-1], count[2:]
    use = here >= LEAST
    slope = (after - before)[use] / (2 * width)
    noise = (after + before)[use] / (4 * width**2)  # of the counts, in the square of the slope
    total = float(((slope**2 - noise) / here[use]).sum())
    return max(total, 0.0) / len(known) * len(known) / len(error)
