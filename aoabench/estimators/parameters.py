"""Parameters that several estimators have."""

from __future__ import annotations

from typing import Any

from aoabench.params import param


def height_param() -> Any:
    """The parameter `height_m` of a method in the plane."""
    return param(None, "height of the target's plane; null: the scenario's known height", unit="m")


def horizon_param() -> Any:
    """The parameter `horizon_deg` of a method in the plane."""
    help = "least angle between a ray and the plane; a flatter ray is turned to it"
    return param(1.0, help, unit="deg", above=0, most=89)


def clip_param() -> Any:
    """The parameter `clip`."""
    return param(True, "whether x and y are moved into the scenario's bounds, if it has bounds")


def tolerance_param(default: float) -> Any:
    """The parameter `tolerance_m` of an iteration."""
    return param(default, "a shorter step ends the iteration", unit="m", above=0, most=1e6)


def updates_param(default: int) -> Any:
    """The parameter `updates` of an iteration."""
    return param(
        default, "number of steps after which the iteration is oscillating", least=1, most=1_000_000
    )
