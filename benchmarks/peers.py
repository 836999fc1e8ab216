"""The same work in other libraries: one lap of the square track, azimuth-elevation model, all
anchors at once.

Every filter returns the estimated positions (T, 3) m, which show that it does the same work. A
faster implementation in one of these libraries is welcome here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from aoabench.maths.geometry import Array
from aoabench.resources import version
from aoabench.roles import Scenario
from aoabench.types import Batch

Laps = dict[str, Callable[[], Array]]  # by kind: EKF, UKF, PF


def available(scenario: Scenario, batch: Batch, sigma: float, particles: int) -> dict[str, Laps]:
    """EKF, UKF and PF of each library that is installed, for one replication's measurements (1, T,
    B) with a deviation in rad.
    """
    given = scenario, batch, sigma, particles
    found: dict[str, Any] = {}
    if number := version("stonesoup"):
        from benchmarks.stone_soup import StoneSoup

        found[f"Stone Soup {number}"] = StoneSoup(*given)
    if number := version("filterpy"):
        from benchmarks.filter_py import FilterPy

        found[f"FilterPy {number}"] = FilterPy(*given)
    return {
        name: {"EKF": library.ekf, "UKF": library.ukf, "PF": library.particle_filter}
        for name, library in found.items()
    }
