"""Lines of sight of anchors that stand on walls, compared with the pieces into which the walls cut a
small disc around the anchor.
"""

import numpy as np
import pytest
import shapely

from aoabench.devices.plans.floor_plan import FloorPlan
from aoabench.devices.plans.sight import faces_along, in_sight

ROOM = np.array([[[0, 0], [12, 0]], [[12, 0], [12, 6]], [[12, 6], [0, 6]], [[0, 6], [0, 0]]], float)


def slow(points, anchors, walls, facing, radius=1e-3):
    """A way from a point to an anchor ends at a disc around the anchor, which the walls cut into
    pieces: it has to end at the piece that the anchor faces.
    """
    lines, found = shapely.MultiLineString(list(walls)), []
    for a, f in zip(anchors, facing):
        disc = shapely.Point(a).buffer(radius).difference(lines.buffer(1e-4 * radius))
        (piece,) = [
            part
            for part in shapely.get_parts(disc)
            if part.contains(shapely.Point(a + radius / 2 * np.array([np.cos(f), np.sin(f)])))
        ]
        ahead = points - a
        ends = a + radius / 2 * ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        ways = shapely.linestrings(np.stack([points, ends], axis=1))
        found.append(
            shapely.contains(piece, shapely.points(ends)) & ~shapely.intersects(lines, ways)
        )
    return np.stack(found, axis=1)


def test_a_room_is_seen_from_its_walls_and_corners():
    anchors = np.array([[0, 3], [6, 0], [12, 3], [6, 6], [0, 0], [12, 6], [6, 3.0]])
    facing = np.deg2rad([0, 90, 180, -90, 45, 225, 10])
    inside = np.array([[1, 1], [11, 5], [6, 3], [0.001, 5.9]])
    outside = np.array([[-1, 3], [6, -1], [13, 3], [6, 7], [-1, -1], [20, 20]])
    assert in_sight(inside, anchors, ROOM, facing).all()
    assert not in_sight(outside, anchors, ROOM, facing).any()
    assert in_sight(anchors[:6], anchors[:6], ROOM, facing[:6]).diagonal().all()  # at the anchors
    away = in_sight(inside, anchors, ROOM, facing + np.pi)
    assert not away[:, :6].any()
    assert away[:, 6].all()
    assert in_sight(outside, anchors, ROOM, facing + np.pi)[0, 0]
    assert not in_sight(inside, anchors, ROOM)[:, :6].any()  # no facing: on a wall is hidden


def test_obstacles_hide_from_anchors_on_walls_too():
    screen = np.array([[[6, 1], [6, 5]]], float)
    anchors, facing = np.array([[0, 3.0]]), np.zeros(1)
    seen = in_sight(
        np.array([[5, 3], [7, 3], [7, 5], [11, 0.1]]),
        anchors,
        np.concatenate([ROOM, screen]),
        facing,
    )
    assert seen[:, 0].tolist() == [True, False, False, False]


def test_outer_corners_and_ends_see_around():
    """The quadrant x < 5, y < 0 is built up; a screen ends in the middle of nowhere."""
    block = np.array([[[0, 0], [5, 0]], [[5, 0], [5, -5]]], float)
    points = np.array([[9, 9], [-3, 4], [9, -4.0], [1, -1]])
    seen = in_sight(points, np.array([[5.0, 0]]), block, np.deg2rad([45.0]))
    assert seen[:, 0].tolist() == [True, True, True, False]
    assert in_sight(points, np.array([[5.0, 0]]), block, np.deg2rad([225.0]))[:, 0].tolist() == [
        False, False, False, True,
    ]  # fmt: skip
    screen = np.array([[[0, 0], [5, 0]]], float)
    for facing in (0, 90, 200):
        assert in_sight(points, np.array([[5.0, 0]]), screen, np.deg2rad([facing])).all()


def test_facing_along_a_wall():
    """Ahead of it on both sides; in a corner the narrower side; the plan's notes name it."""
    points = np.array([[1, 1], [11, 1], [11, -1], [1, -1.0]])
    along = in_sight(points, np.array([[6.0, 0]]), ROOM[:1], np.zeros(1))
    assert along[:, 0].tolist() == [False, True, True, False]
    for facing in (0, np.pi / 2):
        corner = in_sight(points, np.array([[0.0, 0]]), ROOM[[0, 3]], np.array([facing]))
        assert corner[:, 0].tolist() == [True, True, False, False]
    anchors = np.array([[6.0, 0], [6, 0], [0, 0], [6, 3]])
    assert faces_along(anchors, ROOM, np.array([0, 1, 0, 0])) == [0]


@pytest.mark.parametrize("at", ["on", "ends", "crossings"])
def test_any_walls_and_facings(at, rng):
    walls = rng.uniform(0, 10, (14, 1, 2)) + rng.uniform(-4, 4, (14, 2, 2))
    walls[1::2, 0] = walls[::2, 1] if at == "crossings" else walls[1::2, 0]
    share = rng.uniform(0.1, 0.9, (len(walls), 1)) if at == "on" else np.ones((len(walls), 1))
    anchors = walls[:, 0] + share * (walls[:, 1] - walls[:, 0])
    points = rng.uniform(-2, 12, (60, 2))
    seen = []
    for _ in range(4):
        facing = rng.uniform(-4, 4, len(anchors))
        found = in_sight(points, anchors, walls, facing)
        np.testing.assert_array_equal(found, slow(points, anchors, walls, facing))
        seen.append(found.mean())
    assert 0.05 < np.mean(seen) < 0.95


def test_turns_shifts_and_scales_change_nothing(rng):
    walls = np.concatenate([ROOM, rng.uniform(0, 6, (5, 2, 2))])
    anchors = np.concatenate([ROOM.mean(axis=1), ROOM[:, 0], walls[4:].mean(axis=1)])
    points, facing = rng.uniform(-1, 13, (80, 2)), rng.uniform(-3, 3, len(anchors))
    before = in_sight(points, anchors, walls, facing)
    turn = 0.7
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    for scale, shift in ((1, 0), (1e3, 5e5), (1e-2, -3)):
        p, a, w = (scale * (x @ R.T) + shift for x in (points, anchors, walls))
        np.testing.assert_array_equal(in_sight(p, a, w, facing + turn), before)
    swapped = in_sight(points[:, ::-1], anchors[:, ::-1], walls[:, ::-1, ::-1], np.pi / 2 - facing)
    np.testing.assert_array_equal(swapped, before)


def test_near_a_wall_is_on_it_up_to_the_stated_distance():
    reach = 1.2e-3  # a ten thousandth of 12 m
    points, facing = np.array([[6, 3.0]]), np.deg2rad([90.0])
    for off, sees in ((0, True), (0.9 * reach, True), (-0.9 * reach, True), (-1.1 * reach, False)):
        assert in_sight(points, np.array([[6, off]]), ROOM, facing)[0, 0] == sees, off
    assert not in_sight(points, np.array([[6, 0.9 * reach]]), ROOM, facing + np.pi)[0, 0]
    assert in_sight(points, np.array([[6, 1.1 * reach]]), ROOM, facing + np.pi)[0, 0]


def test_no_shipped_access_node_stands_on_a_wall():
    from aoabench.devices.plans.plan import find
    from aoabench.devices.plans.sight import on_walls

    files = [find("", f"indoor_map{name}") for name in ("_anchors.csv", ".geojson")]
    plan = FloorPlan.read(files)
    assert not on_walls(plan.position, plan.walls).any()
    assert plan.notes == ()
