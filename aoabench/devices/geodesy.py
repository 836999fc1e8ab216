"""Geodetic coordinates on WGS84 and local coordinates in m: x east, y north, z up at an origin.

The local coordinates are those of the plane that touches the ellipsoid at the origin, so that
distances and angles are exact; at 1 km from the origin the ellipsoid lies 8 cm below the plane.

    (X, Y, Z) = ((N + h) cos lat cos lon, (N + h) cos lat sin lon, ((1 - e^2) N + h) sin lat)
    N = a / sqrt(1 - e^2 sin^2 lat)                  from the earth's centre, at the height h
    (x, y, z) = R(lat0, lon0) ((X, Y, Z) - (X0, Y0, Z0))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from aoabench.errors import BadValue, check_array
from aoabench.maths.geometry import Array

AXIS_M = 6_378_137.0  # equatorial radius
FLATTENING = 1 / 298.257223563
_E2 = FLATTENING * (2 - FLATTENING)
FAR_M = 200_000.0  # points further from the origin do not belong to one site
DIGITS = 7  # of a default origin in deg: some 1 cm

LATITUDES = ("lat_deg", "lat", "latitude", "latitude_deg")
LONGITUDES = ("lon_deg", "lon", "lng", "long", "longitude", "longitude_deg")
HEIGHTS = ("height_m", "height", "alt_m", "alt", "altitude_m", "altitude", "ele", "z_m", "z")
WGS84 = ("EPSG:4326", "EPSG::4326", "CRS84", "WGS84", "WGS 84")


@dataclass(frozen=True)
class Origin:
    """The point at height 0 of the ellipsoid that has the local coordinates (0, 0, 0)."""

    lat_deg: float
    lon_deg: float

    @classmethod
    def given(cls, value: object) -> Origin | None:
        """The origin of scenario.origin_deg, None for null; raises BadValue for other values than
        a latitude and a longitude.
        """
        if value is None:
            return None
        lat, lon = check_array("origin_deg", value, (2,))
        if abs(lat) > 90 or abs(lon) > 180:
            swapped = "; the latitude comes first" if abs(lon) <= 90 and abs(lat) <= 180 else ""
            allowed = f"latitude within +-90 and longitude within +-180 deg{swapped}"
            raise BadValue("origin_deg", value, allowed)
        return cls(float(lat), float(lon))

    @classmethod
    def amid(cls, lat_deg: Array, lon_deg: Array) -> Origin:
        """The centroid of points (N,) deg, rounded to DIGITS."""
        east = np.mean((lon_deg - lon_deg[0] + 180) % 360 - 180) + lon_deg[0]
        east = (east + 180) % 360 - 180
        return cls(round(float(np.mean(lat_deg)), DIGITS), round(float(east), DIGITS))

    def local(self, lat_deg: Array, lon_deg: Array, height_m: Array | float = 0.0) -> Array:
        """Local coordinates (..., 3) m of points (...); height_m is above the ellipsoid."""
        away = _from_centre(lat_deg, lon_deg, height_m) - _from_centre(self.lat_deg, self.lon_deg)
        return np.asarray(away @ self._axes.T)

    def geodetic(self, points: Array) -> Array:
        """Latitude deg, longitude deg and height m (..., 3) of local points (..., 3) m."""
        X, Y, Z = np.moveaxis(points @ self._axes + _from_centre(self.lat_deg, self.lon_deg), -1, 0)
        across = np.hypot(X, Y)
        lat = np.arctan2(Z, across * (1 - _E2))
        for _ in range(5):  # each step leaves less than a hundredth of the error
            N = AXIS_M / np.sqrt(1 - _E2 * np.sin(lat) ** 2)
            lat = np.arctan2(Z + _E2 * N * np.sin(lat), across)
        sine, cosine = np.sin(lat), np.cos(lat)
        height = across * cosine + Z * sine - AXIS_M * np.sqrt(1 - _E2 * sine**2)
        return np.stack([np.rad2deg(lat), np.rad2deg(np.arctan2(Y, X)), height], axis=-1)

    def is_near(self, lat_deg: float, lon_deg: float) -> bool:
        """Whether a point may belong to the site of this origin."""
        here = self.local(np.array(lat_deg), np.array(lon_deg))
        return bool(np.linalg.norm(here) <= FAR_M)

    @property
    def _axes(self) -> Array:
        """The local axes (3, 3), rows east, north, up, in coordinates from the earth's centre."""
        lat, lon = np.deg2rad([self.lat_deg, self.lon_deg])
        (sp, cp), (sl, cl) = (np.sin(lat), np.cos(lat)), (np.sin(lon), np.cos(lon))
        return np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])

    def __str__(self) -> str:
        return f"[{self.lat_deg!r}, {self.lon_deg!r}]"


def _from_centre(lat_deg: ArrayLike, lon_deg: ArrayLike, height: ArrayLike = 0.0) -> Array:
    """Coordinates (..., 3) m from the earth's centre; the third axis points north."""
    lat, lon, h = np.broadcast_arrays(np.deg2rad(lat_deg), np.deg2rad(lon_deg), height)
    N = AXIS_M / np.sqrt(1 - _E2 * np.sin(lat) ** 2)
    flat = (N + h) * np.cos(lat)
    up = ((1 - _E2) * N + h) * np.sin(lat)
    return np.stack([flat * np.cos(lon), flat * np.sin(lon), up], axis=-1)


def check_degrees(key: str, value: object, lat: Array, lon: Array, origin: Origin | None) -> None:
    """Raise BadValue for points (N,) deg that are no latitudes and longitudes, or lie further than
    FAR_M from the origin.
    """
    if not (np.abs(lat).max() <= 90 and np.abs(lon).max() <= 360):
        swap = np.abs(lon).max() <= 90 and np.abs(lat).max() <= 360
        hint = ": latitudes and longitudes are exchanged?" if swap else ""
        allowed = (
            "latitudes within +-90 and longitudes within +-360 deg; these span "
            f"{lat.min():.6g} to {lat.max():.6g} and {lon.min():.6g} to {lon.max():.6g}{hint}"
        )
        raise BadValue(key, value, allowed)
    if origin is None:
        return
    away = np.linalg.norm(origin.local(lat, lon), axis=-1)
    worst = int(np.argmax(away))
    if away[worst] <= FAR_M:
        return
    swap = (
        abs(origin.lon_deg) <= 90
        and float(
            np.linalg.norm(Origin(origin.lon_deg, origin.lat_deg).local(lat, lon), axis=-1).max()
        )
        <= FAR_M
    )
    hint = ": latitude and longitude are exchanged?" if swap else ""
    allowed = (
        f"points within {FAR_M / 1000:g} km of scenario.origin_deg={origin}; latitude "
        f"{lat[worst]:.6g}, longitude {lon[worst]:.6g} is {away[worst] / 1000:.0f} km away{hint}"
    )
    raise BadValue(key, value, allowed)


def local_positions(key: str, path: str, degrees: Array, origin: Origin | None) -> Array:
    """Local positions (M, 3) m from latitudes, longitudes deg and heights m; z is unknown where the
    height is. Raises BadValue, which names `key` and `path`, for degrees of another place, and
    without an origin.
    """
    if origin is None:
        allowed = f"latitude and longitude of the local (0, 0), because {path} is in degrees"
        raise BadValue("origin_deg", None, allowed)
    found = np.full(degrees.shape, np.nan)
    some = np.isfinite(degrees[:, :2]).all(axis=1)
    lat, lon, height = degrees[some].T
    check_degrees(key, path, lat, lon, origin)
    found[some] = origin.local(lat, lon, np.nan_to_num(height))
    found[np.isnan(degrees[:, 2]), 2] = np.nan
    return found


def degree_columns(present: Sequence[str]) -> tuple[str, str, str | None] | None:
    """The columns of latitude, longitude and, or None, height among a file's columns; None if the
    file lacks a latitude or a longitude. Upper and lower case are the same.
    """
    lower = {name.strip().lower(): name for name in reversed(present)}
    lat, lon, height = (
        next((lower[one] for one in known if one in lower), None)
        for known in (LATITUDES, LONGITUDES, HEIGHTS)
    )
    return None if lat is None or lon is None else (lat, lon, height)


def names_wgs84(crs: str) -> bool:
    """Whether the name of a reference system is that of WGS84 in degrees."""
    return any(crs.upper().endswith(one) for one in WGS84)


def from_projected(key: str, crs: str, points: Array) -> tuple[Array, Array]:
    """Latitudes and longitudes (N,) deg of points (N, 2) in a projected reference system, such as
    EPSG:25832; x east. Raises BadValue for an unknown system, and without the library pyproj.
    """
    try:
        from pyproj import Transformer
        from pyproj.exceptions import ProjError
    except ImportError:
        allowed = "local or wgs84; other systems need the library pyproj: pip install aoabench[geo]"
        raise BadValue(key, crs, allowed) from None
    try:
        lon, lat = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(*points.T)
    except ProjError:
        raise BadValue(key, crs, "local, wgs84 or a known system such as EPSG:25832") from None
    if not (np.isfinite(lat).all() and np.isfinite(lon).all()):
        raise BadValue(key, crs, "the system of the coordinates; some lie outside of this one")
    return np.asarray(lat), np.asarray(lon)
