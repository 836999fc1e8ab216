"""Local coordinates on WGS84: an independent ellipsoid, isometry, and mistakes in one line."""

import mpmath
import numpy as np
import pytest

from aoabench.devices.geodesy import (
    Origin,
    check_degrees,
    degree_columns,
    from_projected,
    names_wgs84,
)
from aoabench.errors import BadValue

PLACES = [(60.0, 24.0), (-33.9, 151.2), (0.0, 0.0), (89.9, 10.0), (-12.0, -77.0), (45.0, 179.9999)]


def slow(lat, lon, height, lat0, lon0):
    """East, north and up by 40 digits, from the surface's gradient instead of sines of latitude."""
    mpmath.mp.dps = 40
    a = mpmath.mpf(6378137)
    b = a * (1 - 1 / mpmath.mpf("298.257223563"))

    def place(lat, lon, height):
        p, m = mpmath.radians(mpmath.mpf(lat)), mpmath.radians(mpmath.mpf(lon))
        n = [mpmath.cos(p) * mpmath.cos(m), mpmath.cos(p) * mpmath.sin(m), mpmath.sin(p)]
        # the point of the ellipsoid with the normal n is D n / sqrt(n' D n), D = diag(a^2, a^2, b^2)
        D = [a * a, a * a, b * b]
        root = mpmath.sqrt(sum(d * c * c for d, c in zip(D, n)))
        return [d * c / root + mpmath.mpf(height) * c for d, c in zip(D, n)], n, m

    (here, _, _), (there, up, m0) = place(lat, lon, height), place(lat0, lon0, 0)
    away = [p - q for p, q in zip(here, there)]
    east = [-mpmath.sin(m0), mpmath.cos(m0), 0]
    north = [up[1] * 0 - up[2] * east[1], up[2] * east[0] - 0, up[0] * east[1] - up[1] * east[0]]
    return [float(sum(p * q for p, q in zip(axis, away))) for axis in (east, north, up)]


@pytest.mark.parametrize(("lat0", "lon0"), PLACES)
def test_local_coordinates_are_those_of_the_tangent_plane(lat0, lon0, rng):
    lat, lon = lat0 + rng.uniform(-0.05, 0.05, 20), lon0 + rng.uniform(-0.05, 0.05, 20)
    height = rng.uniform(-50, 3000, 20)
    found = Origin(lat0, lon0).local(lat, lon, height)
    want = [slow(*one, lat0, lon0) for one in zip(lat.tolist(), lon.tolist(), height.tolist())]
    np.testing.assert_allclose(found, want, atol=1e-8)


@pytest.mark.parametrize(("lat0", "lon0"), PLACES)
def test_there_and_back(lat0, lon0, rng):
    origin = Origin(lat0, lon0)
    points = rng.uniform(-5e4, 5e4, (200, 3))
    lat, lon, height = origin.geodetic(points).T
    np.testing.assert_allclose(origin.local(lat, lon, height), points, atol=1e-8)


def test_distances_do_not_depend_on_the_origin(rng):
    lat, lon, height = (
        48 + rng.uniform(-0.1, 0.1, 9),
        11 + rng.uniform(-0.1, 0.1, 9),
        rng.uniform(0, 900, 9),
    )
    one, two = (Origin(*place).local(lat, lon, height) for place in ((48, 11), (47.7, 12.1)))
    apart = [np.linalg.norm(p[:, None] - p[None], axis=-1) for p in (one, two)]
    np.testing.assert_allclose(*apart, atol=1e-7)


def test_north_is_y_and_east_is_x():
    east, north = Origin(60, 24).local(np.array([60, 60.001]), np.array([24.001, 24]))[:, :2]
    np.testing.assert_allclose(east, [55.8, 0], atol=0.05)
    np.testing.assert_allclose(north, [0, 111.4], atol=0.05)


def test_a_centroid_across_the_antimeridian():
    assert Origin.amid(np.array([1.0, 3.0]), np.array([179.9, -179.9])).lat_deg == 2
    assert abs(Origin.amid(np.array([1.0, 3.0]), np.array([179.9, -179.9])).lon_deg) == 180
    assert Origin.amid(np.array([1.0, 1.0]), np.array([10.0, 10.00000004])).lon_deg == 10.0


def test_mistakes_give_one_line():
    for value, words in (
        ([160, 24], "the latitude comes first"),
        ([60, 200], "longitude within +-180"),
        ([1, 2, 3], "2 finite numbers"),
        ([None, 2], "2 finite numbers"),
    ):
        with pytest.raises(BadValue, match="origin_deg") as error:
            Origin.given(value)
        assert words in str(error.value)
    assert Origin.given([24, 160]) == Origin(24, 160)
    assert Origin.given(None) is None


def test_points_of_another_place_and_exchanged_ones():
    lat, lon = np.array([60.0, 60.001]), np.array([24.0, 24.001])
    check_degrees("walls", "w", lat, lon, Origin(60.1, 24.1))
    check_degrees("walls", "w", lat, lon, None)
    for place, words in (((24.0, 60.0), "exchanged?"), ((50.0, 8.0), "km away")):
        with pytest.raises(BadValue, match=r"within 200 km .*km away") as error:
            check_degrees("walls", "w", lat, lon, Origin(*place))
        assert words in str(error.value)
    with pytest.raises(BadValue, match="exchanged"):
        check_degrees("walls", "w", np.array([151.0]), np.array([-33.0]), None)


def test_columns_of_degrees():
    assert degree_columns(["Lat", "x", "LONGITUDE", "alt"]) == ("Lat", "LONGITUDE", "alt")
    assert degree_columns(["lat_deg", "lon_deg"]) == ("lat_deg", "lon_deg", None)
    assert degree_columns(["lat", "x_m"]) is None


def test_names_of_wgs84():
    for name in ("EPSG:4326", "urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:EPSG::4326"):
        assert names_wgs84(name)
    assert not names_wgs84("urn:ogc:def:crs:EPSG::25833")


def test_projected_coordinates(rng):
    pyproj = pytest.importorskip("pyproj")
    points = np.array([385_000.0, 6_672_000.0]) + rng.uniform(-500, 500, (20, 2))
    lat, lon = from_projected("walls_crs", "EPSG:3067", points)
    local = Origin.amid(lat, lon).local(lat, lon)
    apart = [np.linalg.norm(p[:, None] - p[None], axis=-1) for p in (points, local)]
    np.testing.assert_allclose(*apart, rtol=5e-4, atol=1e-3)  # the map's scale is 0.9996 at least
    geod = pyproj.Geod(ellps="WGS84")
    _, _, length = geod.inv(lon[0], lat[0], lon[1], lat[1])
    assert np.linalg.norm(local[0] - local[1]) == pytest.approx(length, abs=1e-4)
    with pytest.raises(BadValue, match="walls_crs='EPSG:99'"):
        from_projected("walls_crs", "EPSG:99", points)


def test_without_pyproj_the_extra_is_named(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(BadValue, match=r"aoabench\[geo\]"):
        from_projected("walls_crs", "EPSG:3067", np.zeros((1, 2)))
