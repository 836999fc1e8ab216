"""The walls of a floor plan, for the map."""

from __future__ import annotations

from pathlib import Path

from aoabench.devices import plan
from aoabench.maths.geometry import Array


def walls(path: str) -> Array:
    """Walls (W, 2, 2) m of a file; raises BadValue for a file that is none."""
    return plan.read_plan("--plan", Path(path)).walls
