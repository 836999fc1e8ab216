"""The indoor map: the shipped plan recounted, line of sight, the route, the motion model, every bad
file in one line.
"""

import json
import os
import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
import yaml
from scipy.linalg import expm
from scipy.stats import chi2, norm

from aoabench.config.plugins import construct
from aoabench.devices.plans.floor_plan import FloorPlan
from aoabench.devices.plans.sight import in_sight
from aoabench.errors import UserError
from aoabench.maths.geometry import in_frames, to_azel
from aoabench.models.motion import ConstantAcceleration, RandomWalk
from aoabench.resources import shipped
from aoabench.scenarios.indoor_map import IndoorMap

CONFIGS = shipped("configs")
ONE_IN_A_MILLION = 1e-6  # false alarms of each statistical test, two-sided


def preset(name="indoor_map", **changes):
    node = yaml.safe_load((CONFIGS / "scenario" / f"{name}.yaml").read_text())
    if "defaults" in node:
        base = yaml.safe_load((CONFIGS / "scenario" / "indoor_map.yaml").read_text())
        motion = {**base["motion"], **node.pop("motion")}
        node = {**base, **{k: v for k, v in node.items() if k != "defaults"}, "motion": motion}
    return construct({**node, **changes}, "scenario")


@pytest.fixture(scope="module")
def shipped_map():
    return preset()


@pytest.fixture(scope="module")
def plan():
    """Visited area and walls as shapely geometries, read without our reader."""
    found = {"visited": [], "wall": []}
    for feature in json.loads((CONFIGS / "plans" / "indoor_map.geojson").read_text())["features"]:
        found[feature["properties"]["kind"]].append(shapely.geometry.shape(feature["geometry"]))
    (visited,) = found["visited"]
    return visited, shapely.union_all(found["wall"])


# --- the shipped plan, recounted ------------------------------------------------------------------


def test_the_walls_are_those_of_the_file(shipped_map, plan):
    visited, walls = plan
    assert walls.bounds == (0, 0, 150, 112)
    assert shapely.union_all(shapely.linestrings(shipped_map.wall_segments)).equals(walls)
    assert shapely.difference(visited.exterior, walls).length == 0  # walls bound the visited area
    assert shipped_map.visited_area_m2 == pytest.approx(visited.area)
    assert 1800 < visited.area < 2200


def test_corridors_are_5_m_wide(plan):
    visited, _ = plan
    assert visited.buffer(-2.49).geom_type == "Polygon"  # nowhere less: it stays in one piece
    hall, *corners = sorted(shapely.get_parts(visited.buffer(-2.51)), key=lambda part: -part.area)
    assert hall.area > 300
    assert all(
        corner.area < 2 for corner in corners
    )  # of corridors more than 5 m wide nothing but bends is left


def test_access_nodes_hang_on_the_walls_and_look_inward(shipped_map, plan):
    visited, walls = plan
    position, R = shipped_map.true_anchors.position[0, 0], shipped_map.true_anchors.rotation[0, 0]
    assert len(position) == round(1.24 / 25 * visited.area)
    assert np.all(position[:, 2] == 3)
    points = shapely.points(position[:, :2])
    assert np.all(shapely.contains(visited, points))
    assert np.all(
        shapely.distance(walls, points) > 0.01
    )  # its own wall does not hide an access node
    assert np.all(shapely.distance(visited.exterior, points) < 0.1)
    assert np.all(shapely.contains(visited, shapely.points(position[:, :2] + 2 * R[:, 0, :2])))
    assert not np.any(
        shapely.contains(visited, shapely.points(position[:, :2] - 0.1 * R[:, 0, :2]))
    )
    gaps = np.diff(np.sort(shapely.line_locate_point(visited.exterior, points)))
    assert gaps.max() < 1.3 * gaps.mean()
    assert gaps.min() > 0.7 * gaps.mean()


def test_local_axes_are_broadside_left_and_up(shipped_map):
    known = shipped_map.true_anchors
    R = known.rotation[0, 0]
    assert np.allclose(R @ np.swapaxes(R, 1, 2), np.eye(3))
    assert np.allclose(np.linalg.det(R), 1)
    assert np.allclose(R[:, 2], [0, 0, 1])
    ahead, left = (
        known.position[0, 0] + 3 * R[:, 0],
        known.position[0, 0] + np.cross([0, 0, 1], R[:, 0]),
    )
    for point, azimuth in ((ahead, 0), (left, np.pi / 2)):
        a, e = to_azel(*in_frames(point[None], known.position, known.rotation))
        assert np.allclose(np.diagonal(a[0]), azimuth, atol=1e-12)
        assert np.allclose(np.diagonal(e[0]), 0, atol=1e-12)


def test_the_route(shipped_map, plan, rng):
    visited, walls = plan
    truth = shipped_map.truth(rng)
    points = shapely.points(truth[:, :2])
    assert np.all(shapely.contains(visited, points))
    assert shapely.distance(walls, points).min() > 0.5
    assert shipped_map.line_of_sight(truth[:, :3]).sum(axis=1).min() >= 4
    step = np.diff(truth[:, :3], axis=0)
    chord = (
        2 * 2.0 * np.sin(1.1 * 0.1 / (2 * 2.0))
    )  # the way of one step on an arc, as the crow flies
    speed = np.linalg.norm(step, axis=1) / 0.1
    assert speed.max() <= 1.1 * (1 + 1e-5)  # the climb adds five millionths
    assert speed.min() >= chord / 0.1 * (1 - 1e-9)
    assert np.allclose(np.diff(truth[:, 2], n=2), 0, atol=1e-12)
    assert truth[0, 2] == pytest.approx(1, abs=1e-3)
    assert truth[-1, 2] == pytest.approx(2, abs=1e-3)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    assert np.abs(np.diff(heading)).max() <= 1.1 * 0.1 / 2.0 + 1e-9
    assert np.hypot(*(truth[-1, :2] - shipped_map.route[-1])) < 0.11


def test_velocity_and_acceleration_are_the_derivatives(rng):
    fine = preset(dt=0.001, route=[[0, 0], [6, 0], [9, 5], [3, 9], [3, 20]], walls=None)
    truth = fine.truth(rng)
    position, velocity, acceleration = truth[:, :3], truth[:, 3:6], truth[:, 6:]
    assert np.allclose((position[2:] - position[:-2]) / 0.002, velocity[1:-1], atol=4e-4)
    arcs = np.flatnonzero(np.linalg.norm(acceleration, axis=1) > 0)
    jumps = np.flatnonzero(np.abs(np.diff(acceleration, axis=0)).max(axis=1) > 0.01)
    away = np.setdiff1d(np.arange(1, len(truth) - 1), np.concatenate([jumps, jumps + 1]))
    assert np.allclose(
        ((velocity[2:] - velocity[:-2]) / 0.002)[away - 1], acceleration[away], atol=1e-6
    )
    assert np.allclose(np.linalg.norm(acceleration[arcs], axis=1), 1.1**2 / 2.0)
    assert len(jumps) == 2 * 3  # into and out of each corner
    assert np.allclose(np.linalg.norm(velocity[:, :2], axis=1), 1.1)


# --- line of sight --------------------------------------------------------------------------------


def crosses(a, b, c, d):
    """Whether the ways a-b and c-d cross: each has the other's ends on two sides."""

    def side(p, q, r):
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0


@pytest.mark.parametrize("walls", [1, 7, 8, 60])
def test_line_of_sight_is_what_orientation_tests_and_shapely_find(walls, rng):
    segments = rng.uniform(0, 10, (walls, 1, 2)) + rng.uniform(-2, 2, (walls, 2, 2))
    points, anchors = rng.uniform(0, 10, (40, 3)), rng.uniform(0, 10, (9, 3))
    found = in_sight(points, anchors, segments)
    lines = [shapely.LineString(s) for s in segments]
    for p in range(len(points)):
        for a in range(len(anchors)):
            ends = points[p, :2], anchors[a, :2]
            assert found[p, a] == (not any(crosses(*ends, *s) for s in segments))
            assert found[p, a] == (
                not any(line.intersects(shapely.LineString(ends)) for line in lines)
            )
    assert 0 < found.mean() < 1


def test_line_of_sight_on_the_shipped_plan(shipped_map, rng):
    points, anchors = (
        rng.uniform([0, 0, 0], [150, 112, 3], (60, 3)),
        shipped_map.true_anchors.position[0, 0],
    )
    points[:20] = shipped_map.truth(rng)[::150, :3][:20]
    found = shipped_map.line_of_sight(points)
    walls = shapely.MultiLineString(list(shipped_map.wall_segments))
    slow = [
        [not walls.intersects(shapely.LineString([p[:2], a[:2]])) for a in anchors] for p in points
    ]
    assert np.array_equal(found, slow)


def test_line_of_sight_without_walls_in_one_place_and_of_many_points(rng):
    anchors = np.array([[1.0, 2, 3], [1.0, 2, 3]])
    assert in_sight(np.array([[1.0, 2, 0]]), anchors, np.array([[[0.0, 0], [9, 0]]])).all()
    assert in_sight(rng.normal(size=(5, 3)), anchors, None).all()
    assert in_sight(np.empty((0, 3)), anchors, np.ones((1, 2, 2))).shape == (0, 2)
    points = rng.uniform(0, 10, (50_000, 3))  # more than are held at once
    found = in_sight(points, anchors, np.array([[[0.0, 5], [10, 5]]]))
    assert np.array_equal(found[:, 0], points[:, 1] < 5)


def test_the_nearest_in_sight_report(shipped_map, rng):
    points = shipped_map.truth(rng)[::40, :3]
    seen = shipped_map.line_of_sight(points)
    d = np.linalg.norm(points[:, None] - shipped_map.true_anchors.position[0, 0], axis=-1)
    for nearest in (1, 8, 20):
        reported = replace(shipped_map, nearest=nearest).hears(points)
        for t in range(len(points)):
            wanted = sorted(np.flatnonzero(seen[t]), key=lambda b, t=t: d[t, b])[:nearest]
            assert set(np.flatnonzero(reported[t])) == set(wanted)
    for nearest in (None, 107, 1000):
        assert np.array_equal(replace(shipped_map, nearest=nearest).hears(points), seen)


def test_the_routes_tables_are_kept_and_travel(shipped_map, rng, monkeypatch):
    """A copy in another process does not look for lines of sight again, even if the first one had
    not yet.
    """
    fresh = pickle.dumps(replace(shipped_map, dt=1.0))
    with monkeypatch.context() as patch:
        patch.delattr(FloorPlan, "in_sight")
        other = pickle.loads(fresh)
        reported = other.hears(other.truth(rng)[:, :3])
    assert reported.sum(axis=1).tolist() == [8] * other.route_steps
    points = shipped_map.truth(rng)[:, :3]
    table = shipped_map.hears(points)
    assert shipped_map.hears(points.copy()) is table
    assert np.array_equal(shipped_map.hears(points[100:105]), table[100:105])
    again = pickle.loads(pickle.dumps(shipped_map))
    assert again == shipped_map
    assert again.files == shipped_map.files
    assert np.array_equal(again.hears(points), table)


# --- the motion model -----------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [0.01, 0.1, 2.0])
@pytest.mark.parametrize("q", [1e-7, 0.1, 5.0])
def test_constant_acceleration_is_the_continuous_model(dt, q):
    """Van Loan's matrix exponential."""
    A = np.kron(np.diag([1.0, 1.0], 1), np.eye(3))
    W = q * np.diag([0.0] * 6 + [1.0] * 3)
    E = expm(dt * np.block([[-A, W], [np.zeros((9, 9)), A.T]]))
    F, Q = ConstantAcceleration(q).matrices(dt)
    assert np.allclose(F, E[9:, 9:].T, rtol=1e-12, atol=1e-14)
    scale = np.sqrt(np.outer(np.diag(Q), np.diag(Q)))
    assert np.allclose(Q / scale, E[9:, 9:].T @ E[:9, 9:] / scale, atol=1e-7)
    assert np.all(np.linalg.eigvalsh(Q / scale) > 0)


@pytest.mark.parametrize("q", [0, -1, np.nan, "a", True, None])
def test_constant_acceleration_wants_a_positive_density(q):
    with pytest.raises(UserError, match="q="):
        ConstantAcceleration(q)


def white(e, sample):
    """Two-sided tests, each with ONE_IN_A_MILLION false alarms, that e (N, 9) is N(0, I)."""
    N = len(e)
    total = np.sum(e**2)
    assert chi2.ppf(ONE_IN_A_MILLION / 2, 9 * N) < total < chi2.isf(ONE_IN_A_MILLION / 2, 9 * N), (
        sample
    )
    moments = np.triu(e.T @ e / N - np.eye(9)) / np.sqrt(
        (1 + np.eye(9)) / N
    )  # 45 numbers, nearly normal for large N
    assert np.abs(moments).max() < norm.isf(ONE_IN_A_MILLION / 45 / 2), sample
    assert np.abs(e.mean(axis=0)).max() * np.sqrt(N) < norm.isf(ONE_IN_A_MILLION / 9 / 2), sample


@pytest.mark.parametrize("changes", [{}, {"dt": 1.0, "motion": ConstantAcceleration(0.3)}])
def test_truth_from_the_model_has_the_models_covariance(changes, rng):
    scenario = replace(preset("indoor_map_model"), steps=20, **changes)
    truth = np.stack([scenario.truth(rng) for _ in range(4000)])
    mean, P = scenario.prior(rng, truth[0])
    assert np.array_equal(mean, scenario.prior(rng, truth[1])[0])
    assert np.array_equal(mean, [93, 73, 1, 0, 0, 0, 0, 0, 0])
    F, Q = scenario.motion.matrices(scenario.dt)
    for k in range(20):
        mean, P = F @ mean, F @ P @ F.T + Q
        if k in (0, 19):
            white(np.linalg.solve(np.linalg.cholesky(P), (truth[:, k] - mean).T).T, f"step {k}")
    w = (truth[:, 1:] - truth[:, :-1] @ F.T).reshape(-1, 9)
    white(np.linalg.solve(np.linalg.cholesky(Q), w.T).T, "increments")


def test_the_shipped_model_variant_wanders_some_metres(rng):
    scenario = preset("indoor_map_model")
    ends = np.stack([scenario.truth(rng)[-1, :3] for _ in range(50)]) - [93, 73, 1]
    assert scenario.steps == 600
    assert scenario.wall_segments is None
    assert scenario.visited_area_m2 is None
    assert 1.5 < np.sqrt(np.mean(ends**2)) < 6
    points = scenario.truth(rng)[:, :3]
    assert np.all(scenario.hears(points).sum(axis=1) == 8)
    assert len(replace(scenario, steps=None).truth(rng)) == scenario.route_steps == 90


def test_the_prior_is_drawn_around_the_true_start(shipped_map, rng):
    truth = shipped_map.truth(rng)
    drawn = np.stack([shipped_map.prior(rng, truth)[0] for _ in range(4000)])
    P = shipped_map.prior(rng, truth)[1]
    assert np.array_equal(np.sqrt(np.diag(P)), [1, 1, 0.1, 1, 1, 1, 0.5, 0.5, 0.5])
    assert np.array_equal(P, np.diag(np.diag(P)))
    assert np.all(drawn[:, 3:] == 0)
    e = (drawn[:, :3] - [17.5, 24.5, 1]) / [1, 1, 0.1]
    assert np.abs(e.mean(axis=0)).max() * np.sqrt(4000) < norm.isf(ONE_IN_A_MILLION / 3 / 2)
    assert (
        chi2.ppf(ONE_IN_A_MILLION / 2, 12000) < np.sum(e**2) < chi2.isf(ONE_IN_A_MILLION / 2, 12000)
    )


# --- files and parameters -------------------------------------------------------------------------

ANCHORS = "x_m,y_m,z_m,facing_deg\n0,1,3,0\n5,-1,3,90\n"
MOTION = {"_target_": "aoabench.models.motion.ConstantAcceleration", "q": 0.1}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text(ANCHORS)
    return tmp_path


def own(**changes):
    node = {
        "_target_": "aoabench.scenarios.indoor_map.IndoorMap",
        "name": "own",
        "anchors": "a.csv",
        "route": [[0, 0], [10, 0]],
        "motion": MOTION,
        "walls": None,
    }
    return construct({**node, **changes}, "scenario")


def collection(*features, **more):
    return {"type": "FeatureCollection", "features": list(features), **more}


def feature(form, coordinates, **properties):
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": form, "coordinates": coordinates},
    }


def test_walls_from_csv_equal_those_from_geojson(shipped_map, here, rng):
    rows = [
        ",".join(map(repr, [f"wall {i}", *s.ravel().tolist()]))
        for i, s in enumerate(shipped_map.wall_segments)
    ]
    (here / "w.csv").write_text(
        "\ufeffname,x0_m,y0_m,x1_m,y1_m\r\n" + "\r\n".join(rows) + "\r\n\r\n", encoding="utf-8"
    )
    mine = replace(shipped_map, walls="w.csv")
    points = shipped_map.truth(rng)[::60, :3]
    assert np.array_equal(mine.wall_segments, shipped_map.wall_segments)
    assert np.array_equal(mine.line_of_sight(points), shipped_map.line_of_sight(points))
    assert mine.visited_area_m2 is None


def test_own_files_come_first_and_any_path_will_do(here):
    (here / "indoor_map_anchors.csv").write_text(ANCHORS)
    (here / "plans").mkdir()
    square = [[2, 2], [4, 2, 0.5], [4, 4], [2, 4], [2, 2]]
    hole = [[2.5, 2.5], [3.5, 2.5], [3.5, 3.5], [2.5, 3.5], [2.5, 2.5]]
    content = collection(
        feature("LineString", [[2, 2], [2, 2], [4, 2, 9]], kind="wall"),
        feature("MultiLineString", [[[2, -1], [2, 1], [3, 1]], [[0, 5], [1, 5]]]),
        {
            "type": "Feature",
            "properties": None,
            "geometry": {"type": "LineString", "coordinates": [[7, 7], [8, 8]]},
        },
        feature("Polygon", [square, hole], kind="visited"),
        units="m",
    )
    path = here / "plans" / "own.geojson"
    path.write_text(json.dumps(content))
    for walls in ("plans/own.geojson", str(path)):
        mine = own(anchors="indoor_map_anchors.csv", walls=walls)
        assert tuple(f.path for f in mine.files) == (
            (here / "indoor_map_anchors.csv").resolve(),
            path.resolve(),
        )
        assert mine.true_anchors.position.shape == (1, 1, 2, 3)
        assert mine.wall_segments.shape == (5, 2, 2)  # the one of length 0 is left out
        assert mine.visited_area_m2 == pytest.approx(4 - 1)
    seen = mine.line_of_sight(mine.truth(None)[:, :3])
    x = mine.truth(None)[:, 0]
    assert np.array_equal(
        seen[:, 0], x < 2
    )  # behind the wall at x = 2, -1 <= y <= 1 the first is hidden
    assert tuple(f.path for f in own().files) == ((here / "a.csv").resolve(),)
    assert tuple(f.path for f in preset().files) == (
        (here / "indoor_map_anchors.csv").resolve(),  # the user's own of that name
        (CONFIGS / "plans" / "indoor_map.geojson").resolve(),
    )


@pytest.mark.parametrize(("text", "says"), [
    (None, "existing file; shipped: indoor_map.geojson, indoor_map_anchors.csv, track.csv"),
    ("", "line 1 is empty"),
    ("x_m,z_m\n1,2\n", "columns x_m, y_m and, where needed, id (else 1, 2, ...), z_m, facing_deg, pitch_deg, roll_deg"),
    ("x_m,x_m,y_m,z_m,facing_deg\n1,1,2,3,4\n", "each once"),
    ("x_m,y_m,z_m,facing_deg\n", "at least one row"),
    ("x_m,y_m,z_m,facing_deg\n1,2,3,0\n1,2,high,0\n", "line 3 has z_m='high'"),
    ("x_m,y_m,z_m,facing_deg\n1,2,3\n", "line 2 has facing_deg=nan"),
    ("x_m,y_m,z_m,facing_deg\n1,nan,3,0\n", "line 2 has y_m=nan"),
    ("x_m,y_m,z_m,facing_deg\n1,inf,3,0\n", "finite number"),
    (b"x\x00y", "byte 1 is 0, as in binary files"),
    (b"\xff\xfe\x00x", "no names of columns"),
])  # fmt: skip
def test_a_bad_anchor_file_gives_one_clear_line(text, says, here):
    if text is not None:
        (here / "bad.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    one_line("scenario.anchors", "bad.csv", says, anchors="bad.csv")


LINE = [[0, 0], [1, 1]]


@pytest.mark.parametrize(("content", "says"), [
    (None, "existing file"),
    ("{", "is not JSON"),
    ("[" * 100_000, "is not JSON"),
    ([], "FeatureCollection"),
    ({"type": "Feature"}, "FeatureCollection"),
    ({"type": "Point", "coordinates": [1, 2]}, "at least one wall, or null for none; it has 1 Point"),
    ({"type": "FeatureCollection", "features": {}}, "FeatureCollection"),
    (collection(), "at least one wall"),
    (collection(feature("LineString", [[1, 1], [1, 1]])), "at least one wall"),
    (collection(feature("Polygon", [[*LINE, [1, 0], [0, 0]]], kind="visited")), "at least one wall"),
    (collection(feature("LineString", LINE), units="deg"), "units is 'deg'"),
    (collection(feature("Polygon", LINE, kind="wall")), "at least two points"),
    (collection(feature("LineString", LINE, kind="visited")), "'visited' and the geometry 'LineString'"),
    (collection(feature("LineString", LINE, kind="door")), "it has 1 doors"),
    (collection(feature("LineString", LINE, kind="desk"), feature("LineString", LINE, kind="desk")), "it has 2 desk"),
    (collection(7), "feature 0"),
    (collection({"type": "Feature", "geometry": None}), "it has 1 without a geometry"),
    (collection({"type": "Feature", "geometry": {"type": ["LineString"]}}), "geometry ['LineString']"),
    (collection(feature("LineString", [[0, 0]])), "at least two points"),
    (collection(feature("LineString", [[0, 0], [1]])), "at least two points"),
    (collection(feature("LineString", [[0, 0], ["a", 1]])), "at least two points"),
    (collection(feature("LineString", [[0, 0], [float("nan"), 1]])), "finite numbers"),
    (collection(feature("LineString", None)), "at least two points"),
    (collection(feature("MultiLineString", [])), "at least two points"),
    (collection(feature("MultiLineString", [LINE, 3])), "at least two points"),
])  # fmt: skip
def test_a_bad_wall_file_gives_one_clear_line(content, says, here):
    if content is not None:
        (here / "w.geojson").write_text(
            content if isinstance(content, str) else json.dumps(content)
        )
    one_line("scenario.walls", "w.geojson", says, walls="w.geojson")


@pytest.mark.parametrize(("name", "text", "says"), [
    ("w.csv", "x0_m,y0_m,x1_m\n", "columns x0_m, y0_m, x1_m, y1_m"),
    ("w.csv", "x0_m,y0_m,x1_m,y1_m\n", "at least one row"),
    ("w.csv", "x0_m,y0_m,x1_m,y1_m\n1,2,1,2\n", "at least one wall, or null for none"),
    ("w.csv", "x0_m,y0_m,x1_m,y1_m\n0,0,1,\n", "line 2 has y1_m=nan"),
    ("w.svg", "<svg/>", ".geojson (or .json), .csv (or another table) or .dxf"),
])  # fmt: skip
def test_bad_walls_in_other_formats(name, text, says, here):
    (here / name).write_text(text)
    one_line("scenario.walls", name, says, walls=name)


@pytest.mark.parametrize(("key", "value", "says"), [
    ("anchors", None, "existing file"),
    ("anchors", "", "existing file"),
    ("anchors", ".", "existing file"),
    ("anchors", "a\0b", "existing file"),
    ("walls", 5, "existing file"),
    ("route", [], "N x 2 finite numbers"),
    ("route", [[0, 0]], "two or more waypoints"),
    ("route", [[0, 0], [1]], "N x 2 finite numbers"),
    ("route", [[0, 0, 0], [1, 1, 1]], "N x 2 finite numbers"),
    ("route[1]", [[0, 0], [0, 0], [9, 9]], "other than the one before"),
    ("route", "nowhere.gpx", "existing file"),
    ("walls_layers", ["walls"], "null without scenario.walls"),
    ("origin_deg", [60], "2 finite numbers"),
    ("origin_deg", [124, 60], "latitude within +-90 and longitude within +-180 deg; the latitude comes first"),
    ("corner_radius_m", 6.0, "<= 5; the way from waypoint 1 to 2 is 10 m long"),
    ("corner_radius_m", 0, ">= 0.001"),
    ("speed_m_s", 0, ">= 0.001"),
    ("height_m", [1], "2 finite numbers"),
    ("height_m", [1, "a"], "2 finite numbers"),
    ("dt", -1, ">= 0.001"),
    ("dt", 100.0, "cuts the route of"),
    ("nearest", 0, "an integer >= 1"),
    ("nearest", 2.5, "an integer >= 1"),
    ("prior_sigma_xy_m", 0, "a number >= 1e-09"),
    ("prior_sigma_z_m", "a", "a number"),
    ("prior_sigma_velocity_m_s", -1, "a number"),
    ("prior_sigma_acceleration_m_s2", None, "a number"),
    ("truth_from", "log", "one of route, model"),
    ("steps", 5, "null with truth_from=route"),
    ("steps", 0, "an integer >= 1"),
    ("motion", None, "position, velocity and acceleration"),
    ("motion.q", {**MOTION, "q": 0}, "a number > 0"),
    ("motion", {"_target_": "aoabench.models.motion.RandomWalk"}, "position, velocity and acceleration"),
])  # fmt: skip
def test_a_bad_parameter_gives_one_clear_line(key, value, says, here):
    field = key.split("[")[0].split(".")[0]
    more = {"route": [[0, 0], [10, 0], [10, 10], [20, 10]]} if field == "corner_radius_m" else {}
    one_line(f"scenario.{key}=", "", says, **more, **{field: value})


def one_line(key, value, says, **changes):
    with pytest.raises(UserError) as caught:
        own(**changes)
    text = str(caught.value)
    assert text.startswith(key), text
    assert value in text
    assert "allowed: " in text
    assert says in text
    assert "\n" not in text


def test_arcs_of_the_widest_radius_meet(here):
    """Half circles that leave nothing of the line between them; a straight waypoint changes
    nothing.
    """
    mine = own(route=[[0, 0], [10, 0], [10, 10], [20, 10]], corner_radius_m=5, dt=0.05)
    points = mine.truth(None)[:, :2]
    assert np.allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), 0.055, atol=1e-5)
    assert mine._path.length == pytest.approx(5 + 5 * np.pi + 5)
    one, two = own(), own(route=[[0, 0], [4, 0], [10, 0]])
    assert np.allclose(one.truth(None), two.truth(None), atol=1e-12)
    assert all(a < b for a, b in pairwise(one.truth(None)[:, 0]))


def test_a_direct_construction_needs_no_yaml(here):
    scenario = IndoorMap("own", "a.csv", [[0, 0], [3, 0]], ConstantAcceleration(1.0), None)
    assert scenario.truth(np.random.default_rng(1)).shape == (27, 9)
    with pytest.raises(UserError, match="motion"):
        IndoorMap("own", "a.csv", [[0, 0], [3, 0]], RandomWalk(), None)
    assert os.path.samefile(scenario.files[0].path, here / "a.csv")
