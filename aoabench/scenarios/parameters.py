"""Parameters that several scenarios have."""

from __future__ import annotations

from typing import Any

from aoabench.params import param
from aoabench.scenarios.layout import AnchorLayout


def name_param() -> Any:
    """The parameter `name`."""
    return param(help="key of the random streams: scenarios of one name share their draws")


def layout_param() -> Any:
    """The parameter `anchors` for a layout."""
    return param(help="positions and orientations of the anchors", kind=AnchorLayout)


def size_param(default: tuple[float, float, float]) -> Any:
    """The parameter `size_m`."""
    return param(default, "extent in x, y and z", unit="m", shape=(3,), above=0)


def dt_param(default: float) -> Any:
    """The parameter `dt`."""
    return param(default, "time from step to step", unit="s", least=1e-6, most=1e6)


def least_heard_param() -> Any:
    """The parameter `least_heard`."""
    help = "share of the steps with a measurement by an anchor below which a run prints a warning"
    return param(0.1, help, least=0, most=1)


def origin_param() -> Any:
    """The field `origin_deg` of a scenario that reads files of places."""
    return param(
        None,
        "latitude and longitude of the local (0, 0), where a file is in degrees; null: the "
        "centroid of anchors in degrees",
        unit="deg",
        shape=(2,),
    )


def bounds_param() -> Any:
    """The field `bounds_m` of a scenario that takes its places from files."""
    return param(
        None,
        "lower and upper corner [x, y] of the target's area; null: no bounds",
        unit="m",
        shape=(2, 2),
    )
