"""Names of the columns of a log in a scenario's YAML."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from aoabench.params import CheckedParams, param


def _column(help: str, default: str) -> Any:
    allowed = "the name of a column, or null"
    return param(None, f"column of {help}; null: {default}, if the file has it", allowed=allowed)


@dataclass(frozen=True)
class Columns(CheckedParams):
    """Names of the columns in the file. The columns azimuth, anchor, and fix, sequence or time are
    required. An empty angle was not measured.
    """

    azimuth: str | None = _column("azimuths", "azimuth_deg or azimuth_rad")
    elevation: str | None = _column("elevations", "elevation_deg or elevation_rad")
    anchor: str | None = _column("the anchors' ids", "anchor")
    fix: str | None = _column("the fixes' numbers or names, used in place of time", "fix")
    time: str | None = _column(
        "times by one clock, numbers or dates and times (ISO 8601)", "time_s, or by time_unit"
    )
    tag: str | None = _column("the tags' names; each tag has tracks of its own", "tag")
    sequence: str | None = _column(
        "the tags' own numbers of packets, equal at all anchors, used in place of time", "sequence"
    )
    anchor_time: str | None = _column(
        "times by a clock of each anchor's own", "anchor_time_s, or by time_unit"
    )
    rssi: str | None = _column("signal strengths in dBm", "rssi_dbm")
    azimuth_sigma: str | None = _column(
        "the azimuths' standard deviations", "azimuth_sigma_deg or azimuth_sigma_rad"
    )
    elevation_sigma: str | None = _column(
        "the elevations' standard deviations", "elevation_sigma_deg or elevation_sigma_rad"
    )
    range: str | None = _column("ranges in m", "range_m")
    range_sigma: str | None = _column("the ranges' standard deviations in m", "range_sigma_m")
    heading: str | None = _column(
        "the mobile's heading in deg, if heading_deg is null", "heading_deg"
    )
    x: str | None = _column("x of the true positions in m", "x_m")
    y: str | None = _column("y of the true positions in m", "y_m")
    z: str | None = _column("z of the true positions in m", "z_m")
    truth_lat: str | None = _column("their latitudes in deg, in place of x", "truth_lat_deg")
    truth_lon: str | None = _column("their longitudes in deg, in place of y", "truth_lon_deg")
    truth_height: str | None = _column("their heights in m beside these", "truth_height_m")
    anchor_x: str | None = _column("x of receivers that move in m", "anchor_x_m")
    anchor_y: str | None = _column("y of receivers that move in m", "anchor_y_m")
    anchor_z: str | None = _column("z, or height, of receivers that move in m", "anchor_z_m")
    anchor_lat: str | None = _column("their latitudes in deg, in place of x", "anchor_lat_deg")
    anchor_lon: str | None = _column("their longitudes in deg, in place of y", "anchor_lon_deg")
    anchor_facing: str | None = _column(
        "the directions that anchors face, in deg counter-clockwise from +x", "anchor_facing_deg"
    )
    anchor_bearing: str | None = _column(
        "these directions in deg clockwise from north (+y)", "anchor_bearing_deg"
    )
