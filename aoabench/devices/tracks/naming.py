"""Which columns of a log are read, by aoabench's names for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from aoabench.devices.readers.columns import found_column, shown_columns
from aoabench.devices.readers.reading import FILE, Content
from aoabench.devices.readers.wide import Wide
from aoabench.devices.tracks.log import Conventions
from aoabench.devices.tracks.moments import SECONDS
from aoabench.devices.tracks.poses import DEFAULTS
from aoabench.errors import BadValue, did_you_mean, listed

DEFAULT_TRUTH = {"truth_lat": "truth_lat_deg", "truth_lon": "truth_lon_deg"}
DEFAULT_TRUTH |= {"truth_height": "truth_height_m"}
EXPECTED = ("heading_deg", "elevation_deg", "elevation_rad")  # left out where conventions say so


def default_names(given: Conventions, time_unit: str) -> dict[str, list[str]]:
    """The columns' default names, by aoabench's; angles and times carry the declared unit."""
    a, e, t = given.azimuth_unit, given.elevation_unit, time_unit
    found = {name: [f"{name}_m"] for name in ("x", "y", "z", "range", "range_sigma")}
    found |= {name: [name] for name in ("fix", "tag", "sequence")}
    found |= {name: [default] for name, default in DEFAULTS.items()}
    found |= {name: [default] for name, default in DEFAULT_TRUTH.items()}
    found |= {"azimuth": [f"azimuth_{a}"], "azimuth_sigma": [f"azimuth_sigma_{a}"]}
    found |= {"elevation": [f"elevation_{e}"], "elevation_sigma": [f"elevation_sigma_{e}"]}
    for name in ("time", "anchor_time"):
        found[name] = list(dict.fromkeys([f"{name}_{t}", name, f"{name}_s"]))
    return found | {"anchor": ["anchor", FILE], "rssi": ["rssi_dbm"], "heading": ["heading_deg"]}


def chosen_columns(
    path: object,
    columns: Sequence[str],
    named: Mapping[str, str | None],
    defaults: Mapping[str, Sequence[str]],
    required: set[str],
) -> dict[str, str]:
    """Map aoabench's column names to those of the file with `columns`, for the columns to read.

    A column has its name in `named`, or else the first of its default names that the file has, in
    upper or lower case and with any marks: `Azimuth (deg)` is azimuth_deg.
    Raises BadValue if a named or required column is missing, or occurs twice. A fix, a sequence
    number or a time is always required; x and y are required if one of x, y, z is read.
    """
    chosen = {
        ours: found_column(defaults[ours], columns) if name is None else name
        for ours, name in named.items()
    }
    grouped = any(chosen[ours] for ours in ("fix", "sequence", "anchor_time"))
    required = required | (set() if grouped else {"time"})
    required |= {"x", "y"} if any(chosen.get(axis) for axis in "xyz") else set()
    lost = [ours for ours, name in chosen.items() if name is None and ours in required]
    for ours, name in chosen.items():
        if ours in lost:
            raise _no_column(ours, name, defaults[ours][0], path, columns, lost)
        if name is not None and columns.count(name) != 1:
            raise _no_column(ours, name, name, path, columns)
    return {ours: name for ours, name in chosen.items() if name is not None}


def _no_column(
    ours: str,
    name: str | None,
    wanted: str,
    path: object,
    columns: Sequence[str],
    lost: Sequence[str] = (),
) -> BadValue:
    """The error for the column `ours`, whose name `wanted` is missing or twice in the file; `lost`
    are all required columns that are missing.
    """
    default = f", by default called {wanted}," if name is None else ""
    allowed = f"a column{default} of {path}, which has {shown_columns(columns)}"
    if wanted in columns:
        allowed += f"; {wanted} occurs {columns.count(wanted)} times"
    else:
        allowed += did_you_mean(wanted, columns)
    if lost:
        words = ",".join(f"{one}:NAME" for one in lost)
        allowed += f"; 'scenario.columns={{{words}}}' reads columns of other names"
    if ours == "time":
        units = [unit for unit in SECONDS if f"time_{unit}" in columns]
        allowed += "".join(f"; scenario.time_unit={unit} reads time_{unit}" for unit in units)
        allowed += (
            "; or scenario.columns.fix, a column with the number of each row's fix, "
            "or scenario.columns.sequence, the tags' own numbers of packets"
        )
    return BadValue(f"columns.{ours}", name, allowed)


def unread(content: Content, chosen: Mapping[str, str], path: object) -> list[str]:
    """A line with the columns of a table that are not read, else an empty list."""
    known = {*chosen.values(), FILE, *EXPECTED}
    left = [name for name in content.columns if name and name not in known]
    if not left or content.stated or isinstance(content, Wide):
        return []
    return [f"{path}: columns that are not read: {listed(left)}"]
