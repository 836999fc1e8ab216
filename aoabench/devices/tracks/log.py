"""Angles, times, signal strengths and ranges in aoabench's conventions, from the columns of a log.

A row holds the measurements by one anchor, or those by the mobile of one anchor. The conventions of
a log are declared, never guessed. Angles are converted to azimuth counter-clockwise from the
anchor's +x and elevation up from its xy-plane:

    azimuth = zero +- value                      elevation = value, -value or 90 deg - value
    by the mobile: heading + azimuth + 180 deg   -elevation          both in global axes
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from aoabench.devices.readers.table import Table
from aoabench.errors import listed
from aoabench.maths.geometry import LIGHT, Array, wrap

TURN = {"deg": 360.0, "rad": 2 * np.pi}
MOST_DBM = 20.0  # a larger signal strength is doubted
SIGMAS = ("error", "absent", "absolute")  # treatments of a negative deviation


class Conventions(NamedTuple):
    """Conventions of a log's angles: the parameters of the same names of a recorded scenario."""

    azimuth_unit: str
    azimuth_sense: str
    azimuth_zero_deg: float
    elevation_unit: str
    elevation_kind: str
    elevation_limit_deg: float
    negative_sigma: str
    frame: str
    measured_by: str
    heading_deg: float | None

    @property
    def needs_heading(self) -> bool:
        """Whether the log must contain the mobile's heading."""
        return (self.measured_by, self.frame, self.heading_deg) == ("mobile", "own", None)

    @property
    def units(self) -> dict[str, str]:
        """The unit of each angle."""
        return {"azimuth": self.azimuth_unit, "elevation": self.elevation_unit}


def known_anchors(
    table: Table, ids: Sequence[str], strict: bool
) -> tuple[Table, np.ndarray, list[str]]:
    """Return the rows of the anchors `ids`, the number (N,) of each row's anchor, and remarks on
    the rows left out.

    A log without a column of anchors is that of the first one. Raises BadValue for a row of another
    anchor if `strict`, and if no row is left.
    """
    if "anchor" not in table.names:
        return table, np.zeros(table.count, dtype=int), []
    anchor = table.indices("anchor", ids, strict=strict)
    unknown = int((anchor < 0).sum())
    if not unknown:
        return table, anchor, []
    if unknown == len(anchor):
        raise table.bad(f"at least one row of a known anchor: {listed(ids)}")
    notes = [f"{table.path}: {unknown} rows of unknown anchors left out"]
    return table.where(anchor >= 0), anchor[anchor >= 0], notes


def angles(table: Table, given: Conventions) -> dict[str, Array]:
    """Return azimuth and elevation (N,) rad in aoabench's conventions, NaN where not measured, and
    their deviations (N,) rad if the table has them.

    Raises BadValue for a row that breaks the declared conventions.
    """
    found = {"azimuth": _azimuth(table, given), "elevation": _elevation(table, given)}
    if given.measured_by == "mobile":
        heading = given.heading_deg or 0.0
        turn = table.numbers("heading", empty=False) if given.needs_heading else heading
        found["azimuth"] = found["azimuth"] + np.deg2rad(turn) + np.pi
        found["elevation"] = -found["elevation"]
    found["azimuth"] = wrap(found["azimuth"])
    for angle, unit in given.units.items():
        column = f"{angle}_sigma"
        if column in table.names:
            sigma = table.numbers(column) * (2 * np.pi / TURN[unit])
            if given.negative_sigma == "absent":
                found[angle] = np.where(sigma < 0, np.nan, found[angle])
            positive = np.where(sigma < 0, np.nan, sigma)
            sigma = np.abs(sigma) if given.negative_sigma == "absolute" else positive
            allowed = (
                f"a number > 0 in {table.names[column]} "
                f"for every {angle} that was measured; see scenario.negative_sigma"
            )
            table.check(column, np.isfinite(found[angle]) & ~(sigma > 0), allowed)
            found[column] = sigma
    return found


def strengths(table: Table, absent: Sequence[float]) -> tuple[Array | None, list[str]]:
    """Return the signal strengths (N,) in dBm, NaN for empty cells and for the numbers `absent`,
    None if no row has one, and remarks to print.
    """
    if "rssi" not in table.names:
        return None, []
    value, name = table.numbers("rssi"), table.names["rssi"]
    gone = np.isin(value, np.array(absent, dtype=float))
    found, notes = np.where(gone, np.nan, value), []
    if gone.any():
        which = ", ".join(f"{number:g}" for number in absent)
        notes.append(
            f"{table.path}: {gone.sum()} of {np.isfinite(value).sum()} {name} mean not available: "
            f"{which} (scenario.rssi_absent)"
        )
    if np.isfinite(found).any() and np.nanmax(found) > MOST_DBM:
        notes.append(
            f"{table.path}: {name} reaches {np.nanmax(found):g}; received signals are far below "
            f"{MOST_DBM:g} dBm, and the largest number is taken for the strongest"
        )
    return (found if np.isfinite(found).any() else None), notes


def ranges(table: Table, sigma_m: float | None) -> tuple[dict[str, Array], list[str]]:
    """Return ranges and their deviations as `delay` and `delay_sigma` (N,) s, NaN where a range has
    no deviation above 0; nothing if no range has one; and remarks to print.

    A row without a deviation above 0 has `sigma_m`.
    """
    if "range" not in table.names:
        return {}, []
    distance = table.numbers("range")
    stated = "range_sigma" in table.names
    sigma = table.numbers("range_sigma") if stated else np.full(len(distance), np.nan)
    sigma = np.where(sigma > 0, sigma, np.nan if sigma_m is None else sigma_m)
    measured = np.isfinite(distance)
    used = measured & np.isfinite(sigma)
    notes = []
    if lost := int((measured & ~used).sum()):
        notes.append(
            f"{table.path}: {lost} of {measured.sum()} {table.names['range']} are not used: their "
            "deviation is not stated, or 0; scenario.range_sigma_m states one"
        )
    if not used.any():
        return {}, notes
    found = {"delay": distance, "delay_sigma": sigma}
    return {name: np.where(used, value, np.nan) / LIGHT for name, value in found.items()}, notes


def _azimuth(table: Table, given: Conventions) -> Array:
    """Azimuths (N,) rad, counter-clockwise; in the mobile's own frame if the mobile measures."""
    turn = TURN[given.azimuth_unit]
    raw = table.numbers("azimuth")
    allowed = (
        f"azimuths within +-{turn:.6g}, as scenario.azimuth_unit={given.azimuth_unit} declares"
    )
    table.check("azimuth", np.abs(raw) > turn * (1 + 1e-6), allowed)
    sign = 1.0 if given.azimuth_sense == "counterclockwise" else -1.0
    return np.deg2rad(given.azimuth_zero_deg) + sign * raw * (2 * np.pi / turn)


def _elevation(table: Table, given: Conventions) -> Array:
    """Elevations (N,) rad, up from the horizontal; NaN where the table has none."""
    if "elevation" not in table.names:
        return np.full(table.count, np.nan)
    turn, kind = TURN[given.elevation_unit], given.elevation_kind
    raw, limit = table.numbers("elevation"), turn * given.elevation_limit_deg / 360
    zeros = {"elevation": (0, 1), "depression": (0, -1), "zenith": (turn / 4, -1)}
    middle, sign = zeros[kind]
    allowed = (
        f"{kind} angles from {middle - limit:.6g} to {middle + limit:.6g}, "
        f"as scenario.elevation_kind={kind} and "
        f"scenario.elevation_unit={given.elevation_unit} declare"
    )
    table.check("elevation", np.abs(raw - middle) > limit * (1 + 1e-6), allowed)
    return sign * (raw - middle) * (2 * np.pi / turn)


def doubts(table: Table, azimuth_unit: str) -> list[str]:
    """A warning line if azimuths declared as deg look like rad, else an empty list."""
    raw = table.numbers("azimuth")
    raw = raw[np.isfinite(raw)]
    if azimuth_unit == "rad" or len(raw) <= 20:
        return []
    if np.abs(raw).max() > 2 * np.pi or np.all(raw == np.rint(raw)):
        return []
    name = table.names["azimuth"]
    return [
        f"{table.path}: {name} is within +-2 pi deg; if it is in rad, set scenario.azimuth_unit=rad"
    ]
