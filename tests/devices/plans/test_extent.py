"""Plans in degrees, in other units and in other places are refused, and small or odd ones are not."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from aoabench.devices.plans.extent import Box
from aoabench.errors import UserError
from aoabench.models.motion import ConstantAcceleration
from aoabench.scenarios.indoor_map import IndoorMap
from aoabench.scenarios.recorded import Recorded

ROOM = [[0, 0], [12, 0], [12, 6], [0, 6], [0, 0]]
NODES = [[0, 3], [6, 0], [12, 3], [6, 6]]
ROUTE = [[1, 1], [11, 1], [11, 5], [1, 5]]


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def scaled(points, factor=1.0, shift=(0.0, 0.0)):
    return (np.array(points, dtype=float) * factor + shift).tolist()


def plan(walls=ROOM, nodes=NODES, route=ROUTE, kind="geojson", more=None, **changes):
    rows = "".join(f"{x!r},{y!r},2.5,{f}\n" for (x, y), f in zip(nodes, (0, 90, 180, -90)))
    Path("a.csv").write_text("x_m,y_m,z_m,facing_deg\n" + rows)
    if kind == "csv":
        lines = [[*a, *b] for a, b in pairwise(walls)]
        text = "\n".join(",".join(map(repr, line)) for line in lines)
        Path("w.csv").write_text("x0_m,y0_m,x1_m,y1_m\n" + text)
    else:
        line = {"type": "LineString", "coordinates": walls}
        feature = {"type": "Feature", "properties": {}, "geometry": line}
        content = {"type": "FeatureCollection", "features": [feature], **(more or {})}
        Path("w.geojson").write_text(json.dumps(content))
    motion = ConstantAcceleration(1.0)
    given = {"corner_radius_m": 0.3, **changes}
    return IndoorMap("own", "a.csv", route, motion, f"w.{kind}", **given)


def refused(*words, **given):
    with pytest.raises(UserError) as error:
        plan(**given)
    assert "\n" not in str(error.value)
    for word in words:
        assert word in str(error.value), str(error.value)


DEGREES = scaled(ROOM, 1 / 111_000, (24.0, 60.0))


@pytest.mark.parametrize("kind", ["geojson", "csv"])
def test_degrees_are_refused_unless_declared_local(kind):
    words = ("walls=", f"w.{kind}", "degrees", "scenario.walls_crs=local", "wgs84")
    refused(*words, walls=DEGREES, kind=kind)
    refused(*words, walls=scaled(DEGREES, 1, (-24, -120)), kind=kind)
    refused("origin_deg=None", "[60.0000", "24.0000", walls=DEGREES, kind=kind, walls_crs="wgs84")
    refused(
        "walls lie within x 24 to 24.0001", "access nodes and the route within x 0 to 12",
        walls=DEGREES, kind=kind, walls_crs="local",
    )  # fmt: skip
    tiny = {"nodes": scaled(NODES, 0.05), "route": scaled(ROUTE, 0.05), "speed_m_s": 0.1}
    tiny |= {"walls": scaled(ROOM, 0.05), "kind": kind, "corner_radius_m": 0.01}
    refused("degrees", **tiny)
    assert plan(**tiny, walls_crs="local").wall_segments.max() == pytest.approx(0.6)


@pytest.mark.parametrize(("unit", "size"), [("mm", 1000), ("cm", 100)])
@pytest.mark.parametrize("kind", ["geojson", "csv"])
def test_other_units_are_asked_for_and_honoured(unit, size, kind):
    large = scaled(ROOM, size)
    refused(
        "walls=", f"walls span {12 * size} m", "access nodes and the route 12 m",
        f"scenario.walls_unit={unit}", walls=large, kind=kind,
    )  # fmt: skip
    mine = plan(walls=large, kind=kind, walls_unit=unit)
    np.testing.assert_allclose(mine.wall_segments, plan(kind=kind).wall_segments)
    assert mine.hears(mine.truth(None)[:, :3]).all()
    assert plan(walls=large, kind=kind, walls_unit="m").wall_segments.max() == 12 * size
    refused(f"walls_unit='{unit}'", "perhaps m", "0.12" if unit == "cm" else "0.012",
            walls=scaled(ROOM), kind=kind, walls_unit=unit)  # fmt: skip


def test_the_visited_area_has_the_unit_too():
    ring = {"type": "Polygon", "coordinates": [scaled(ROOM, 1000)]}
    visited = {"type": "Feature", "properties": {"kind": "visited"}, "geometry": ring}
    plan(walls=scaled(ROOM, 1000), walls_unit="mm")
    content = json.loads(Path("w.geojson").read_text())
    content["features"].append(visited)
    Path("w.geojson").write_text(json.dumps(content))
    again = IndoorMap(
        "own", "a.csv", ROUTE, ConstantAcceleration(1.0), "w.geojson", walls_unit="mm",
        corner_radius_m=0.3,
    )  # fmt: skip
    assert again.visited_area_m2 == pytest.approx(72)


def test_stated_units_and_reference_systems_are_not_overlooked():
    mm = {"walls": scaled(ROOM, 1000), "more": {"units": "mm"}}
    refused("units is 'mm'", "scenario.walls_unit=mm", **mm)
    refused("units is 'mm'", "in m", **mm, walls_unit="m")
    assert plan(**mm, walls_unit="mm").wall_segments.max() == pytest.approx(12)
    refused("units is 'ft'", "scenario.walls_unit=ft", more={"units": "ft"})
    refused("units is 'deg'", "convert", more={"units": "deg"})
    refused("units is '3'", "convert", more={"units": 3})
    crs = {"crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25833"}}}
    refused("crs is 'urn:ogc:def:crs:EPSG::25833'", "scenario.walls_crs=local", more=crs)
    refused("origin_deg=None", "crs is 'EPSG:4326'", more={"crs": "EPSG:4326"})
    assert plan(more=crs, walls_crs="local").wall_segments.max() == 12
    assert plan(more={"crs": None, "units": "m"}).wall_segments.max() == 12


def test_plan_and_nodes_in_mm_beside_a_route_in_m():
    both = {"walls": scaled(ROOM, 1000), "nodes": scaled(NODES, 1000)}
    refused(
        "walls=", "access nodes 12000 m, the route 10 m", "walls and access nodes in mm?", **both
    )
    refused("anchors=", "access nodes in mm?", **both, walls_unit="mm")
    plan(**both, walls_unit="m")


def test_places_that_do_not_meet():
    refused("walls=", "walls lie within x 500 to 512", walls=scaled(ROOM, 1, (500, 0)))
    utm = (500_000, 5_000_000)
    refused("anchors=", "x 500000 to 500012", "the route", nodes=scaled(NODES, 1, utm))
    refused("walls=", "access nodes and the route", walls=scaled(ROOM, 1, utm))
    refused("anchors=", "the same coordinates", route=scaled(ROUTE, 1, utm))
    refused("anchors=", "access nodes in mm?", nodes=scaled(NODES, 1000))
    refused("route=", "the route in mm?", route=scaled(ROUTE, 1000))
    refused("anchors=", "perhaps these are degrees", nodes=scaled(NODES, 1e-5, (24, 60)))
    moved = {
        name: scaled(p, 1, utm) for name, p in (("walls", ROOM), ("nodes", NODES), ("route", ROUTE))
    }
    assert plan(**moved).wall_segments.max() == 5_000_006


def test_anchors_on_walls_need_a_facing():
    plan()
    Path("a.csv").write_text("x_m,y_m\n0,3\n6,0\n")
    with pytest.raises(UserError, match=r"anchors='a.csv' .* facing_deg, because access nodes"):
        IndoorMap("own", "a.csv", ROUTE, ConstantAcceleration(1.0), "w.geojson")
    Path("a.csv").write_text("x_m,y_m\n0.1,3\n6,0.1\n")
    IndoorMap("own", "a.csv", ROUTE, ConstantAcceleration(1.0), "w.geojson")


ODD = {
    "one node and a long corridor": {"nodes": [[0.1, 3]], "walls": [[0, 0], [300, 0]]},
    "a campus and a short route": {
        "walls": scaled(ROOM, 60), "nodes": scaled(NODES, 60), "route": [[100, 100], [103, 100]]},
    "two nodes in one place": {"nodes": [[1, 3], [1, 3]]},
    "a pillar": {"walls": scaled(ROOM, 0.1, (5, 2)), "nodes": scaled(NODES, 3)},
    "nodes along one wall": {"nodes": [[1, 6], [5, 6], [9, 6]]},
    "outdoors": {"nodes": scaled(NODES, 30), "route": [[800, 5], [810, 5]], "walls": scaled(ROOM, 80)},
}  # fmt: skip


@pytest.mark.parametrize("given", ODD.values(), ids=ODD)
def test_what_is_only_odd_is_taken(given):
    plan(**given)


def test_true_positions_of_a_log_that_do_not_meet_the_anchors():
    Path("a.csv").write_text("id,x_m,y_m\n1,0,0\n2,12,6\n")
    for x, y, words in (
        (5000, 3000, ["path='log.csv'", "true positions in mm?"]),
        (500_005, 5_000_003, ["anchors='a.csv'", "same coordinates"]),
        (5, 3, None),
        (24, 60, None),
    ):
        rows = "".join(f"{k},1,10,{x + k * (1000 if x == 5000 else 1)},{y}\n" for k in range(6))
        Path("log.csv").write_text("fix,anchor,azimuth_deg,x_m,y_m\n" + rows)
        if words is None:
            Recorded("own", "log.csv", "a.csv")
            continue
        with pytest.raises(UserError) as error:
            Recorded("own", "log.csv", "a.csv")
        assert all(word in str(error.value) for word in words), str(error.value)


def test_boxes(rng):
    for _ in range(200):
        a, b = (rng.uniform(-5, 5, 2) + rng.uniform(0, 4, (9, 2)) for _ in range(2))
        one, two = Box.around(a), Box.around(b)
        grid = np.linspace(0, 1, 21)[:, None]
        near = [np.array(box.low + grid * (box.high - box.low)) for box in (one, two)]
        x, y = (np.abs(near[0][:, None, i] - near[1][None, :, i]).min() for i in range(2))
        assert one.gap(two) == two.gap(one) <= np.hypot(x, y) + 1e-12
        assert one.gap(two) >= np.hypot(x, y) - 0.4
        assert (one.gap(two) == 0) == bool(
            np.all(one.low <= two.high) and np.all(two.low <= one.high)
        )
