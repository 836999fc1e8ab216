"""The same work in other libraries: one lap of the square track, azimuth-elevation model, all
anchors at once.

Every filter returns the estimated positions (T, 3) m, which show that it does the same work. A
faster implementation in one of these libraries is welcome here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from aoabench.maths.geometry import Array
from aoabench.resources import version
from aoabench.roles import Scenario
from aoabench.types import Batch


@dataclass(frozen=True)
class Lap:
    """A filter's call, which returns the positions (T, 3) m of a lap, and the number of equal laps
    that it computes.
    """

    call: Callable[[], Array]
    laps: int = 1

    def __call__(self) -> Array:
        return self.call()


KINDS = {"EKF": "ekf", "UKF": "ukf", "PF": "particle_filter"}


def available(
    scenario: Scenario, batch: Batch, sigma: float, particles: int
) -> dict[str, dict[str, Lap]]:
    """The EKF, UKF and PF of each library that is installed, those that it has, for one
    replication's measurements (1, T, B) with a deviation in rad.
    """
    given = scenario, batch, sigma, particles
    found: dict[str, Any] = {}
    if number := version("stonesoup"):
        from benchmarks.stone_soup import StoneSoup

        found[f"Stone Soup {number}"] = StoneSoup(*given)
    if number := version("filterpy"):
        from benchmarks.filter_py import FilterPy

        found[f"FilterPy {number}"] = FilterPy(*given)
    if number := version("particles"):
        from benchmarks.particles_lib import Particles

        found[f"particles {number}"] = Particles(*given)
    if number := version("jax"):
        from benchmarks.jax_filters import Jax

        found[f"JAX {number}"] = Jax(*given)
    return {
        name: {
            kind: Lap(getattr(library, call), 1 if kind == "PF" else getattr(library, "laps", 1))
            for kind, call in KINDS.items()
            if hasattr(library, call)
        }
        for name, library in found.items()
    }
