"""Anchors, walls and route of one site from files in metres or degrees, together."""

import json
from pathlib import Path

import numpy as np
import pytest

from aoabench.devices.anchors import read_anchors
from aoabench.devices.geodesy import Origin
from aoabench.devices.plans.floor_plan import FloorPlan
from aoabench.errors import BadValue
from aoabench.models.motion import ConstantAcceleration
from aoabench.scenarios.indoor_map import IndoorMap

ROOM = [[0, 0], [12, 0], [12, 6], [0, 6], [0, 0]]
NEXT = [[12, 0], [24, 0], [24, 6], [12, 6], [12, 0]]
NODES = [[0.05, 3, 2.5], [6, 0.05, 2.5], [11.95, 3, 2.5], [6, 5.95, 2.5]]
FACING = (0, 90, 180, -90)
ROUTE = [[1, 1], [11, 1], [11, 5], [1, 5]]
HERE = Origin(60.0, 24.0)


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{x},{y},{z},{f}\n" for (x, y, z), f in zip(NODES, FACING))
    Path("local.csv").write_text("x_m,y_m,z_m,facing_deg\n" + rows)
    lat, lon, height = HERE.geodetic(np.array(NODES)).T.tolist()
    rows = "".join(f"{a!r},{b!r},{h!r},{f}\n" for a, b, h, f in zip(lat, lon, height, FACING))
    Path("globe.csv").write_text("lat_deg,lon_deg,height_m,facing_deg\n" + rows)
    outlines([ROOM, NEXT], "local.geojson")
    outlines([degrees(ROOM), degrees(NEXT)], "globe.geojson")
    Path("local_way.csv").write_text("x_m,y_m\n" + "".join(f"{x},{y}\n" for x, y in ROUTE))
    points = "".join(f'<rtept lat="{b!r}" lon="{a!r}"/>' for a, b in degrees(ROUTE))
    Path("globe.gpx").write_text(f"<gpx><rte>{points}</rte></gpx>")


def degrees(points):
    lat, lon, _ = HERE.geodetic(np.column_stack([points, np.zeros(len(points))])).T
    return np.stack([lon, lat], axis=-1).tolist()


def outlines(rings, name):
    features = [
        {"type": "Feature", "properties": {"category": "room"}, "geometry": {"type": "Polygon", "coordinates": [ring]}}
        for ring in rings
    ]  # fmt: skip
    Path(name).write_text(json.dumps({"type": "FeatureCollection", "features": features}))


def site(anchors="local", walls="local", route=ROUTE, **more):
    crs = {"walls_crs": "wgs84"} if walls == "globe" else {}
    given = {"corner_radius_m": 0.3, **crs, **more}
    motion = ConstantAcceleration(1.0)
    return IndoorMap("own", f"{anchors}.csv", route, motion, f"{walls}.geojson", **given)


@pytest.mark.parametrize("anchors", ["local", "globe"])
@pytest.mark.parametrize("walls", ["local", "globe"])
@pytest.mark.parametrize("route", [ROUTE, "local_way.csv", "globe.gpx"])
def test_one_site_in_metres_and_in_degrees(anchors, walls, route):
    plain = site()
    mine = site(anchors, walls, route, origin_deg=[60.0, 24.0])
    for name in ("position", "rotation"):
        found, want = (getattr(s.true_anchors, name) for s in (mine, plain))
        np.testing.assert_allclose(found, want, atol=1e-6)
    np.testing.assert_allclose(mine.wall_segments, plain.wall_segments, atol=1e-6)
    points = plain.truth(None)[:, :3]
    np.testing.assert_allclose(mine.truth(None)[:, :3], points, atol=1e-6)
    assert mine.hears(points).all()
    assert mine.notes == ()
    assert len(mine.files) == 2 + isinstance(route, str)


def test_local_coordinates_beside_degrees_need_the_origin():
    for given, words in (
        ({"walls": "globe"}, "globe.geojson is not (scenario.walls_crs is 'wgs84')"),
        ({"route": "globe.gpx"}, "globe.gpx is in degrees and the anchors are in m"),
        (
            {"anchors": "globe"},
            "local.geojson has local coordinates and the anchors are in degrees",
        ),
        ({"anchors": "globe", "walls": "globe"}, "scenario.route is in m and the anchors"),
        ({"anchors": "globe", "walls": "globe", "route": "local_way.csv"}, "local_way.csv is in m"),
    ):
        with pytest.raises(BadValue, match=r"origin_deg=None .*: \[60.000") as error:
            site(**given)
        assert words in str(error.value), str(error.value)


def test_the_centroid_of_the_anchors_is_the_default_origin_and_said():
    mine = site("globe", "globe", "globe.gpx")
    shift = mine.true_anchors.position[0, 0] - NODES
    np.testing.assert_allclose(shift, shift[:1] + np.zeros((4, 3)), atol=1e-4)
    np.testing.assert_allclose(mine.true_anchors.position[0, 0, :, :2].mean(axis=0), 0, atol=0.01)
    (note,) = mine.notes
    assert "scenario.origin_deg=[60.0000269" in note
    stated = [float(one) for one in note.partition("=[")[2].partition("]")[0].split(",")]
    again = site("globe", "globe", "globe.gpx", origin_deg=stated)
    np.testing.assert_array_equal(again.true_anchors.position, mine.true_anchors.position)
    assert again.notes == ()


def test_rooms_are_separate_and_a_route_through_their_wall_is_told():
    inside = site()
    assert inside.hears(inside.truth(None)[:, :3]).all()
    other = site(route=[[13, 1], [23, 1], [23, 5]])
    assert not other.hears(other.truth(None)[:, :3]).any()
    through = site(route=[[1, 1], [20, 1], [20, 4], [5, 4]])
    (note,) = through.notes
    assert "the route goes through or touches walls at 2 places, first near (12, 1)" in note
    assert inside.notes == ()
    files = [Path("local.csv"), Path("local.geojson")]
    plan = FloorPlan.read(files)
    for highest, places in ((5.99, None), (6, 1), (6.5, 2)):
        notes = plan.crossings(np.array([[1.0, 1], [11, highest], [2, 1]]))
        assert [f"at {places} places" in note for note in notes] == [True] * (places is not None)


def test_a_turn_back_is_a_route():
    mine = site(route=[[1, 1], [11, 1], [1, 1]])
    truth = mine.truth(None)
    assert len(truth) == pytest.approx(20 / 0.11, abs=1)
    assert set(np.sign(truth[:, 3])) == {1.0, -1.0}
    assert np.abs(truth[:, 6:8]).max() == 0


def test_units_beyond_metres():
    outlines([(np.array(ring) / 0.3048).tolist() for ring in (ROOM, NEXT)], "feet.geojson")
    mine = IndoorMap("own", "local.csv", ROUTE, ConstantAcceleration(1.0), "feet.geojson", walls_unit="ft", corner_radius_m=0.3)  # fmt: skip
    np.testing.assert_allclose(mine.wall_segments, site().wall_segments, atol=1e-9)


def test_clocks_and_heights():
    Path("a.csv").write_text("x_m,y_m,clock_offset_s\n0,0,1.5\n1,0,-0.25\n")
    assert read_anchors("anchors", "a.csv").clock_offset_s.tolist() == [1.5, -0.25]
    assert read_anchors("anchors", "local.csv").clock_offset_s is None
    Path("a.csv").write_text("Lat,Lon,z_m\n60,24,3\n60,24.0001,4\n")
    found = read_anchors("anchors", "a.csv", HERE)
    np.testing.assert_allclose(found.anchors.position[0, 0, :, 2], [3, 4], atol=1e-5)


def test_a_route_with_heights():
    Path("way.csv").write_text("x_m,y_m,z_m\n1,1,1\n11,1,3\n11,5,2\n1,5,2\n")
    mine = site(route="way.csv")
    truth = mine.truth(None)
    flat = site()
    np.testing.assert_array_equal(
        truth[:, [0, 1, 3, 4, 6, 7]], flat.truth(None)[:, [0, 1, 3, 4, 6, 7]]
    )
    corners = [np.argmin(np.linalg.norm(truth[:, :2] - p, axis=1)) for p in ROUTE]
    np.testing.assert_allclose(truth[corners, 2], [1, 3, 2, 2], atol=0.03)
    np.testing.assert_allclose(np.diff(truth[:, 2]) / 0.1, truth[1:, 5], atol=0.2)
    assert np.isclose(np.diff(truth[:, 2]) / 0.1, truth[1:, 5]).mean() > 0.95
    degrees_ = HERE.geodetic(np.column_stack([ROUTE, [1, 3, 2, 2]])).tolist()
    rows = "".join(f"{a!r},{b!r},{h!r}\n" for a, b, h in degrees_)
    Path("globe_way.csv").write_text("lat,lon,height_m\n" + rows)
    again = site(route="globe_way.csv", origin_deg=[60.0, 24.0])
    np.testing.assert_allclose(again.truth(None), truth, atol=1e-5)


@pytest.mark.parametrize("route", [ROUTE, "local_way.csv", "globe.gpx"])
def test_filters_start_at_the_first_waypoint(route, rng):
    mine = site(route=route, origin_deg=[60.0, 24.0])
    starts = [mine.prior(rng, None)[0] for _ in range(400)]
    np.testing.assert_allclose(np.mean(starts, axis=0)[:3], [1, 1, 1], atol=0.2)
