"""Floor plans as people have them: forms of GeoJSON, doors, levels, layers, DXF."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely

from aoabench.devices.geodesy import Origin
from aoabench.devices.plans.doors import cut
from aoabench.devices.plans.drawing import Door
from aoabench.devices.plans.plan import Frame, read_plan
from aoabench.devices.plans.sight import in_sight
from aoabench.errors import BadValue

ROOM = [[0, 0], [12, 0], [12, 6], [0, 6], [0, 0]]
NEXT = [[12, 0], [24, 0], [24, 6], [12, 6], [12, 0]]


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def feature(form, coordinates, **properties):
    geometry = {"type": form, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def read(content, frame=None):
    if isinstance(content, list):
        content = {"type": "FeatureCollection", "features": content}
    Path("w.geojson").write_text(json.dumps(content))
    return read_plan("walls", Path("w.geojson"), frame)


def outline(walls):
    return shapely.union_all(shapely.linestrings(walls))


def same(walls, *lines):
    return outline(walls).equals(shapely.union_all([shapely.LineString(line) for line in lines]))


FORMS = {
    "polygon": [feature("Polygon", [ROOM], category="room")],
    "open ring": [feature("Polygon", [ROOM[:-1]])],
    "line": [feature("LineString", ROOM)],
    "lines": [feature("MultiLineString", [[a, b] for a, b in pairwise(ROOM)], kind="wall")],
    "closed lines": [feature("MultiLineString", [ROOM])],
    "twice": [feature("Polygon", [ROOM]), feature("LineString", ROOM[::-1])],
    "polygons": [feature("MultiPolygon", [[ROOM]], kind="room")],
    "one feature": feature("Polygon", [ROOM]),
    "one geometry": {"type": "Polygon", "coordinates": [ROOM]},
    "collection": [{"type": "Feature", "properties": None, "geometry": {
        "type": "GeometryCollection", "geometries": [
            {"type": "LineString", "coordinates": ROOM[:3]},
            {"type": "LineString", "coordinates": ROOM[2:]}]}}],
    "heights": [feature("Polygon", [[[*p, 3.0] for p in ROOM]])],
    "beside points": [feature("Point", [3, 3], name="plant"), feature("Polygon", [ROOM]), feature("LineString", [[1, 1], [2, 2]], kind="desk")],
}  # fmt: skip


@pytest.mark.parametrize("content", FORMS.values(), ids=FORMS)
def test_one_room_in_many_forms(content):
    assert same(read(content).walls, ROOM)


@pytest.mark.parametrize("content", FORMS.values(), ids=FORMS)
def test_a_wall_of_two_rooms_is_one(content):
    assert len(read(content).walls) == 4
    assert len(read([feature("Polygon", [ROOM]), feature("Polygon", [NEXT])]).walls) == 7


def test_what_is_no_wall_is_counted():
    plan = read(FORMS["beside points"])
    assert plan.notes == ("w.geojson: no walls, left out: 1 Point, 1 desk",)
    assert read(FORMS["polygon"]).notes == ()


def test_holes_and_the_visited_area():
    hole = [[2, 2], [4, 2], [4, 4], [2, 4], [2, 2]]
    plan = read(
        [feature("Polygon", [ROOM, hole]), feature("Polygon", [ROOM, hole], kind="visited")]
    )
    assert same(plan.walls, ROOM, hole)
    assert plan.area_m2 == pytest.approx(72 - 4)


DOORS = {
    "a line": feature("LineString", [[12, 2], [12, 3]], kind="door"),
    "a line beside the wall": feature("LineString", [[12.2, 2], [12.2, 3]], category="opening"),
    "an opening of IMDF": {**feature("LineString", [[12, 2], [12, 3]], category="pedestrian"), "feature_type": "opening"},
    "a door of OpenStreetMap": feature("Point", [12, 2.5], door="hinged", width="1"),
    "an area": feature("Polygon", [[[11.9, 2.02], [12.1, 2.02], [12.1, 2.98], [11.9, 2.98], [11.9, 2.02]]], kind="door"),
}  # fmt: skip


@pytest.mark.parametrize("door", DOORS.values(), ids=DOORS)
def test_doors_open_the_walls_of_both_rooms(door):
    plan = read([feature("Polygon", [ROOM]), feature("Polygon", [NEXT]), door])
    left = outline(plan.walls)
    gap = shapely.LineString([[12, 2], [12, 3]])
    assert left.intersection(gap).length < 1e-6
    whole = shapely.union_all([shapely.LineString(ROOM), shapely.LineString(NEXT)])
    assert left.length == pytest.approx(whole.length - 1)
    sees = in_sight(np.array([[20, 2.5], [20, 5.5]]), np.array([[4, 2.5]]), plan.walls)
    assert sees[:, 0].tolist() == [True, False]
    assert plan.notes == ("w.geojson: 1 doors, 1 of them cut out of the walls",)


def test_a_door_of_no_stated_width_is_said_and_one_off_the_walls_is_counted():
    here, off = feature("Point", [6, 0], door="yes"), feature("Point", [6, 3], door="yes")
    plan = read([feature("Polygon", [ROOM]), here, off])
    (note,) = plan.notes
    assert "2 doors, 1 of them cut out of the walls; 2 of no stated width are 0.9 m wide" in note
    assert outline(plan.walls).length == pytest.approx(36 - 0.9)
    leaf = feature("LineString", [[6, 0], [6, 0.9]], kind="door")  # the leaf of an open door
    assert outline(read([feature("Polygon", [ROOM]), leaf]).walls).length == pytest.approx(36)


def test_any_doors_leave_what_shapely_leaves(rng):
    """Against plain intervals on random axis-parallel walls."""
    for _ in range(50):
        walls, doors, left = [], [], 0.0
        for k in range(5):
            a, b = np.sort(rng.uniform(0, 10, 2)), np.sort(rng.uniform(-2, 12, 2))
            walls.append([[a[0], 5.0 * k], [a[1], 5.0 * k]])
            doors.append(Door(np.array([[b[0], 5.0 * k + 0.1], [b[1], 5.0 * k + 0.1]])))
            left += np.ptp(a) - max(0.0, min(a[1], b[1]) - max(a[0], b[0]))
        found, unused = cut(np.array(walls), doors)
        assert np.linalg.norm(found[:, 1] - found[:, 0], axis=1).sum() == pytest.approx(left)
        assert unused == sum(
            d.points[1, 0] <= w[0][0] or d.points[0, 0] >= w[1][0] for w, d in zip(walls, doors)
        )


def test_a_door_that_only_touches_a_wall_opens_none():
    wall = np.array([[[0.0, 0.0], [10.0, 0.0]]])
    found, unused = cut(wall, [Door(np.array([[10.0, 0.0], [11.0, 0.0]]))])
    assert unused == 1
    np.testing.assert_array_equal(found, wall)
    found, unused = cut(wall, [Door(np.array([[-1.0, 0.0], [11.0, 0.0]]))])
    assert (len(found), unused) == (0, 0)


def test_walls_without_doors_keep_their_bits_and_order(rng):
    walls = rng.normal(size=(40, 2, 2)) * 30
    door = Door(walls[17])
    found, unused = cut(walls, [door])
    assert unused == 0
    rest = [w for w in walls.tolist() if w in found.tolist()]
    assert rest == [w for w in found.tolist() if w in walls.tolist()]
    assert len(rest) >= 30
    assert walls[17].tolist() not in found.tolist()
    assert cut(walls, [])[0] is walls


def test_levels_are_noted_and_layers_chosen():
    floors = [feature("Polygon", [ROOM], level="0"), feature("Polygon", [NEXT], level="1")]
    assert read(floors).notes == ("w.geojson: the levels 0, 1 are read as one floor",)
    desk = [
        feature("Polygon", [ROOM], category="room"),
        feature("LineString", [[1, 1], [2, 2]], category="desk"),
    ]
    assert same(read(desk, Frame(layers=["Room"])).walls, ROOM)
    assert read(desk, Frame(layers=["room"])).notes == ("w.geojson: no walls, left out: 1 desk",)
    with pytest.raises(
        BadValue, match="at least one wall, or null for none; it has 1 desk, 1 room"
    ):
        read(desk, Frame(layers=["walls"]))


def degrees(points, origin):
    lat, lon, _ = origin.geodetic(np.column_stack([points, np.zeros(len(points))])).T
    return np.stack([lon, lat], axis=-1).tolist()


def test_degrees_become_metres():
    origin = Origin(60.0, 24.0)
    ring, door = degrees(ROOM, origin), degrees([[12, 2], [12, 3]], origin)
    content = [
        feature("Polygon", [ring]),
        feature("LineString", door, kind="door"),
        feature("Polygon", [ring], kind="visited"),
    ]
    plan = read(content, Frame(crs="wgs84", origin=origin))
    assert plan.geodetic
    assert (
        outline(plan.walls).hausdorff_distance(
            outline(
                read(
                    [
                        feature("Polygon", [ROOM]),
                        feature("LineString", [[12, 2], [12, 3]], kind="door"),
                    ]
                ).walls
            )
        )
        < 1e-6
    )
    assert plan.area_m2 == pytest.approx(72)
    stated = {
        "type": "FeatureCollection",
        "features": content,
        "crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}},
    }
    np.testing.assert_array_equal(read(stated, Frame(origin=origin)).walls, plan.walls)
    for frame, words in (
        (Frame(crs="wgs84"), r"origin_deg=None .*\[60.00002"),
        (Frame(crs="wgs84", unit="mm", origin=origin), "walls_unit='mm' .*null"),
        (Frame(crs="wgs84", origin=Origin(24, 60)), "exchanged"),
        (Frame(), "looks like degrees of longitude and latitude: scenario.walls_crs=wgs84"),
    ):
        with pytest.raises(BadValue, match=words):
            read(content, frame)


def test_degrees_near_a_known_origin_are_degrees():
    origin = Origin(60.0, 24.0)
    content = [feature("Polygon", [degrees(ROOM, origin)])]
    plan = read(content, Frame(origin=origin))
    assert plan.geodetic
    np.testing.assert_array_equal(
        plan.walls, read(content, Frame(crs="wgs84", origin=origin)).walls
    )
    swapped = [feature("Polygon", [[p[::-1] for p in degrees(ROOM, origin)]])]
    with pytest.raises(BadValue, match="looks like degrees"):
        read(swapped, Frame(origin=origin))
    with pytest.raises(BadValue, match="exchanged"):
        read(swapped, Frame(crs="wgs84", origin=origin))


def test_tables_and_encodings():
    rows = "x0_m;y0_m;x1_m;y1_m\n" + "".join(
        f"{a},5;{b};{c},5;{d}\n" for (a, b), (c, d) in pairwise(ROOM)
    )
    Path("w.txt").write_text(rows)
    plan = read_plan("walls", Path("w.txt"))
    np.testing.assert_array_equal(plan.walls, np.array(list(pairwise(ROOM))) + [0.5, 0])
    Path("w.geojson").write_text(json.dumps(FORMS["one geometry"]), encoding="utf-16")
    assert same(read_plan("walls", Path("w.geojson")).walls, ROOM)
    Path("w.geojson").write_bytes(b"{\x00}")
    with pytest.raises(BadValue, match="UTF-8"):
        read_plan("walls", Path("w.geojson"))


def test_sight_through_doors_is_what_shapely_finds(rng):
    """Rooms on a grid with doors in random places: a line is clear if it meets no wall that shapely
    leaves of the rooms' boundary.
    """
    rooms = [shapely.box(4 * i, 3 * k, 4 * i + 4, 3 * k + 3) for i in range(4) for k in range(3)]
    places = [(4.0 * i, 3 * k + rng.uniform(0.5, 2.5), 0) for i in range(5) for k in range(3)]
    places += [(4 * i + rng.uniform(0.5, 3.5), 3.0 * k, 1) for i in range(4) for k in range(4)]
    ends = [
        ([x - 0.45 * d, y - 0.45 * (1 - d)], [x + 0.45 * d, y + 0.45 * (1 - d)])
        for x, y, d in places
    ]
    content = [feature("Polygon", [list(map(list, room.exterior.coords))]) for room in rooms]
    content += [feature("LineString", list(pair), category="door") for pair in ends]
    walls = shapely.union_all([room.exterior for room in rooms])
    left = shapely.difference(
        walls, shapely.union_all([shapely.LineString(p).buffer(1e-9) for p in ends])
    )
    anchors, points = (rng.uniform(0, [16, 9], (n, 2)) for n in (9, 300))
    lines = shapely.linestrings(
        np.stack(np.broadcast_arrays(points[:, None], anchors[None]), axis=2)
    )
    clear = ~shapely.intersects(lines, left)
    assert 0.1 < clear.mean() < 0.6
    np.testing.assert_array_equal(in_sight(points, anchors, read(content).walls), clear)


def test_hostile_files_end_in_one_line():
    for text in (
        "[" * 200_000,
        '{"type":"GeometryCollection","geometries":[' * 900,
        '{"type": "Polygon", "coordinates": ' + "[" * 500 + "]" * 500 + "}",
    ):
        Path("w.geojson").write_text(text)
        with pytest.raises(BadValue) as error:
            read_plan("walls", Path("w.geojson"))
        assert len(str(error.value)) < 300
    way = np.cumsum(np.tile([[0.001, 0.0], [0.0, 0.001]], (250_000, 1)), axis=0)
    assert len(read({"type": "LineString", "coordinates": way.tolist()}).walls) == len(way) - 1


def test_projected_plans():
    pyproj = pytest.importorskip("pyproj")
    to = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:3067", always_xy=True)
    origin = Origin(60.17, 24.94)
    plane = np.stack(to.transform(*np.array(degrees(ROOM, origin)).T), axis=-1).tolist()
    plan = read([feature("Polygon", [plane])], Frame(crs="EPSG:3067", origin=origin))
    assert outline(plan.walls).hausdorff_distance(shapely.LineString(ROOM)) < 1e-4


# --- DXF ------------------------------------------------------------------------------------------


def drawing(unit=4, size=1000.0):
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new()
    document.header["$INSUNITS"] = unit
    for name in ("WALLS", "FURNITURE", "A-DOOR", "OLD"):
        document.layers.add(name)
    document.layers.get("OLD").off()
    space = document.modelspace()
    scaled = [(x * size, y * size) for x, y in ROOM[:-1]]
    space.add_lwpolyline(scaled, close=True, dxfattribs={"layer": "WALLS"})
    space.add_line((6 * size, 0), (7 * size, 0), dxfattribs={"layer": "A-DOOR"})
    space.add_circle((3 * size, 3 * size), size, dxfattribs={"layer": "FURNITURE"})
    space.add_line((0, 0), (5 * size, 5 * size), dxfattribs={"layer": "OLD"})
    space.add_text("office", dxfattribs={"layer": "WALLS"})
    block = document.blocks.new("STUB")
    block.add_line((0, 0), (0, size))  # in layer 0, which is that of the insert
    outer = document.blocks.new("OUTER")
    outer.add_blockref("STUB", (0, 0), dxfattribs={"xscale": 2, "yscale": 2})
    space.add_blockref("OUTER", (9 * size, size), dxfattribs={"layer": "WALLS"})
    document.saveas("w.dxf")


GAP = ([[7, 0], [12, 0], [12, 6], [0, 6], [0, 0], [6, 0]], [[9, 1], [9, 3]])


def test_walls_of_a_drawing_in_mm():
    drawing()
    plan = read_plan("walls", Path("w.dxf"), Frame(layers=["walls"]))
    assert outline(plan.walls).hausdorff_distance(shapely.MultiLineString(GAP)) < 1e-9
    assert plan.unit == "mm"
    text = " ".join(plan.notes)
    for word in (
        "1 doors, 1 of them",
        "1 TEXT",
        "1 lines of the layer OLD",
        "1 lines of the layer FURNITURE",
        "read in mm",
    ):
        assert word in text, text


def test_all_layers_and_curves():
    drawing(unit=6, size=1.0)
    plan = read_plan("walls", Path("w.dxf"))
    assert "walls of the layers A-DOOR, FURNITURE, WALLS" in " ".join(plan.notes)
    round_ = shapely.Point(3, 3).buffer(1, quad_segs=200).exterior
    inside = outline(plan.walls).intersection(shapely.Point(3, 3).buffer(1.5))
    assert inside.hausdorff_distance(round_) < 0.0101
    drawing(unit=4, size=1.0)  # states mm, is in m
    declared = read_plan("walls", Path("w.dxf"), Frame(unit="m"))
    again = outline(declared.walls).intersection(shapely.Point(3, 3).buffer(1.5))
    assert again.hausdorff_distance(round_) < 0.0101
    assert "read in m, as declared; the drawing states mm" in " ".join(declared.notes)
    drawing(unit=6, size=1.0)
    declared = read_plan("walls", Path("w.dxf"), Frame(unit="mm"))
    assert declared.walls.max() == pytest.approx(0.012)
    assert "read in mm, as declared; the drawing states m" in " ".join(declared.notes)


def test_a_block_within_itself_ends():
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new()
    block = document.blocks.new("LOOP")
    block.add_line((0, 0), (1, 1))
    block.add_blockref("LOOP", (1, 0))
    document.modelspace().add_blockref("LOOP", (0, 0))
    document.saveas("w.dxf")
    with pytest.raises(BadValue, match="nested at most 20 deep"):
        read_plan("walls", Path("w.dxf"))


def test_broken_drawings_give_one_line(monkeypatch):
    drawing()
    with pytest.raises(BadValue, match=r"layers wall; it has 0, .*WALLS"):
        read_plan("walls", Path("w.dxf"), Frame(layers=["wall"]))
    for content in (
        b"",
        b"0\nSECTION\n",
        b"hello" * 1000,
        bytes(range(256)) * 10,
        Path("w.dxf").read_bytes()[:9000],
    ):
        Path("bad.dxf").write_bytes(content)
        with pytest.raises(BadValue, match=r"walls='bad\.dxf'") as error:
            read_plan("walls", Path("bad.dxf"))
        assert len(str(error.value)) < 300


def test_without_ezdxf_the_extra_is_named(monkeypatch):
    import sys

    Path("w.dxf").write_text("0\nEOF\n")
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    with pytest.raises(BadValue, match=r"aoabench\[dxf\]"):
        read_plan("walls", Path("w.dxf"))
