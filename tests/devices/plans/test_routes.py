"""Routes from files, and the arcs at their corners."""

from pathlib import Path

import numpy as np
import pytest
import shapely

from aoabench.devices.geodesy import Origin
from aoabench.devices.plans.routes import read_route
from aoabench.errors import BadValue
from aoabench.scenarios.route import RoundedRoute

WAY = np.array([[1, 1], [11, 1], [11, 5], [1, 5]], dtype=float)
HERE = Origin(60.0, 24.0)


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def degrees(points=WAY):
    return HERE.geodetic(np.column_stack([points, np.zeros(len(points))]))[:, :2].tolist()


def gpx(kind="rte", points=None, space=' xmlns="http://www.topografix.com/GPX/1/1"'):
    tag = {"rte": "rtept", "trk": "trkpt", "wpt": "wpt"}[kind]
    inner = "".join(
        f'<{tag} lat="{a!r}" lon="{b!r}"><ele>3</ele></{tag}>' for a, b in points or degrees()
    )
    around = {"rte": "<rte>{}</rte>", "trk": "<trk><trkseg>{}</trkseg></trk>", "wpt": "{}"}[kind]
    return f'<?xml version="1.0"?><gpx version="1.1"{space}>{around.format(inner)}</gpx>'


def table(head, points):
    return head + "\n" + "".join(f"{a!r},{b!r}\n" for a, b in points)


FILES = {
    "x, y": ("r.csv", table("x_m,y_m", WAY.tolist())),
    "degrees": ("r.csv", table("Latitude,Longitude", degrees())),
    "route": ("r.gpx", gpx()),
    "track": ("r.gpx", gpx("trk")),
    "waypoints": ("r.gpx", gpx("wpt", space="")),
    "a stop": ("r.csv", table("x_m,y_m", [p for p in WAY.tolist() for _ in range(3)])),
}


@pytest.mark.parametrize(("name", "text"), FILES.values(), ids=FILES)
def test_one_route_in_many_forms(name, text):
    Path(name).write_text(text)
    found = read_route("route", Path(name), HERE)
    np.testing.assert_allclose(found.points, WAY, atol=1e-7)
    assert found.geodetic == ("x_m" not in text)
    left = "8 waypoints less than 0.01 m from the one before are left out"
    heights = "r.gpx: heights (ele) are not read, because they count from the sea"
    stops = text.count("\n") > 8
    assert found.notes == ((f"r.csv: {left}",) if stops else (heights,) if "<ele>" in text else ())
    assert found.heights is None


BAD = {
    "form": ("r.kml", "1 1\n", HERE, "a file .csv or .gpx"),
    "columns": ("r.csv", "x,y\n1,2\n", HERE, "columns x_m, y_m, or lat_deg, lon_deg; it has x, y"),
    "cells": ("r.csv", "x_m,y_m\n1,2\n3,\n", HERE, "line 3 has y_m=nan"),
    "one place": ("r.csv", "x_m,y_m\n1,2\n1,2\n", HERE, "two or more different waypoints"),
    "no origin": ("r.gpx", gpx(), None, "origin_deg=None"),
    "elsewhere": ("r.gpx", gpx(), Origin(50, 8), "km away"),
    "no xml": ("r.gpx", "lat lon", HERE, "a GPX file"),
    "nothing": ("r.gpx", "<gpx/>", HERE, "its GPX has no route, track or waypoints"),
    "no number": (
        "r.gpx",
        '<gpx><wpt lat="60" lon="x"/></gpx>',
        HERE,
        "wpt 0 has lon_deg='x'",
    ),
    "no lat": ("r.gpx", '<gpx><wpt lon="3"/></gpx>', HERE, "wpt 0 has lat_deg=None"),
}


@pytest.mark.parametrize(("name", "text", "origin", "words"), BAD.values(), ids=BAD)
def test_a_bad_file_gives_one_line(name, text, origin, words):
    Path(name).write_text(text)
    with pytest.raises(BadValue) as error:
        read_route("route", Path(name), origin)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_turn_back_is_made_on_the_spot():
    route = RoundedRoute.through([[0, 0], [10, 0], [4, 0], [4, 5]], 1.0)
    assert route.length == pytest.approx(10 + 6 + 5 - 2 + np.pi / 2)
    position, ahead, curvature = route.at(np.array([9.0, 9.999, 10.0, 12.0]))
    np.testing.assert_allclose(position, [[9, 0], [9.999, 0], [10, 0], [8, 0]], atol=1e-12)
    np.testing.assert_allclose(ahead[:, 0], [1, 1, -1, -1])
    assert not curvature.any()


def test_there_and_back_reverses_the_way(rng):
    there = np.concatenate([[[0, 0]], rng.uniform(-50, 50, (4, 2))])
    back = np.concatenate([there, there[-2::-1]])
    path, one = (RoundedRoute.through(way, 0.1, smaller=True) for way in (back, there))
    assert path.length == pytest.approx(2 * one.length)
    arc = np.linspace(0, one.length - 1e-6, 200)
    np.testing.assert_allclose(path.at(arc)[0], path.at(path.length - arc)[0], atol=1e-6)


def test_short_legs_have_smaller_arcs_on_request(rng):
    """The path is continuous and leads through all legs, at most the radius of a corner away."""
    way = np.cumsum(rng.normal(size=(300, 2)) + [1, 0], axis=0)
    with pytest.raises(BadValue, match="corner_radius_m"):
        RoundedRoute.through(way, 2.0)
    path = RoundedRoute.through(way, 2.0, smaller=True)
    arc = np.linspace(0, path.length, 200_001)
    position, ahead, curvature = path.at(arc)
    step = np.diff(position, axis=0)
    assert np.linalg.norm(step, axis=1).max() <= arc[1] * (1 + 1e-6)
    straight = (curvature[:-1] == 0) & (curvature[1:] == 0)
    assert 0.2 < straight.mean() < 0.9
    off = np.linalg.norm(step / arc[1] - ahead[:-1], axis=1)
    assert np.mean(off[straight] < 1e-6) > 0.99
    middles = (way[:-1] + way[1:]) / 2
    nearest = shapely.LineString(position).distance(shapely.points(middles))
    assert nearest.max() < 1e-3
    np.testing.assert_allclose(position[[0, -1]], way[[0, -1]], atol=1e-9)
    assert path.length <= np.linalg.norm(np.diff(way, axis=0), axis=1).sum()


def test_wide_legs_keep_the_radius():
    one, two = (RoundedRoute.through(WAY, 0.3, smaller=s) for s in (False, True))
    for a, b in zip(vars(one).values(), vars(two).values()):
        np.testing.assert_array_equal(a, b)
