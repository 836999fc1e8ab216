"""Silicon Labs' positioning_config.json as anchors."""

import json
from pathlib import Path

import numpy as np
import pytest

from aoabench.devices.anchors import read_anchors
from aoabench.errors import BadValue


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def locator(name, place=(1, 2, 3), turn=(0, 0, 0), **config):
    return {"id": name, "config": config, "coordinate": dict(zip("xyz", place)), "orientation": dict(zip("xyz", turn))}  # fmt: skip


def read(content):
    Path("c.json").write_text(content if isinstance(content, str) else json.dumps(content))
    return read_anchors("anchors", "c.json")


def about(axis, deg):
    """The matrix of a turn about x, y or z, by Rodrigues' formula."""
    k = np.eye(3)["xyz".index(axis)]
    K = np.cross(np.eye(3), k)
    a = np.deg2rad(deg)
    return np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * K @ K


def test_directions_turn_as_in_the_makers_own_plot(rng):
    """world = Rz(z) Ry(y) Rx(x) u + coordinate."""
    turns = rng.uniform(-180, 180, (8, 3))
    places = rng.uniform(-9, 9, (8, 3))
    rows = [
        locator(f"ble-pd-{k:012X}", p, t)
        for k, (p, t) in enumerate(zip(places.tolist(), turns.tolist()))
    ]
    found = read({"version": 1, "id": "p", "locators": rows})
    assert found.ids == [row["id"] for row in rows]
    assert not found.numbered
    np.testing.assert_array_equal(found.anchors.position[0, 0], places)
    for R, (x, y, z) in zip(found.anchors.rotation[0, 0], turns):
        u = rng.normal(size=3)
        np.testing.assert_allclose(
            R @ (about("z", z) @ about("y", y) @ about("x", x) @ u), u, atol=1e-12
        )


def test_locators_face_along_their_z_axis():
    wall = read({"locators": [locator("a", turn=(0, 90, 0)), locator("b", turn=(0, 90, 90)), locator("c", turn=(90, 0, 0))]})  # fmt: skip
    np.testing.assert_allclose(np.rad2deg(wall.facing), [0, 90, -90], atol=1e-9)
    assert read({"locators": [locator("a", turn=(0, 180, 30)), locator("b", turn=(0, 90, 0))]}).facing is None  # fmt: skip


def test_other_json_is_a_table():
    found = read([{"id": "a", "x_m": 1, "y_m": 2}, {"id": "b", "x_m": 3, "y_m": 4}])
    assert found.ids == ["a", "b"]
    np.testing.assert_array_equal(found.anchors.position[0, 0], [[1, 2, 0], [3, 4, 0]])


def test_masks_are_noted():
    assert read({"locators": [locator("a", azimuthMask=[])]}).notes == ()
    (note,) = read(
        {"locators": [locator("a", azimuthMask=[{"min": 0, "max": 9}]), locator("b")]}
    ).notes
    assert "1 locators exclude" in note


BAD = {
    "torn": ('{"locators": [', "not JSON"),
    "no JSON": ("{", "JSON"),
    "another list": ('{"locators": {}}', "a list locators"),
    "none": ({"locators": []}, "a list locators"),
    "no id": ({"locators": [{}]}, "locator 0 has the id None"),
    "twice": ({"locators": [locator("a"), locator("a")]}, "locator 1 has the id 'a'"),
    "no place": ({"locators": [{"id": "a"}]}, "locator a has coordinate=None"),
    "text": ({"locators": [locator("a", ("1", 2, 3))]}, "locator a has coordinate="),
    "huge": ({"locators": [locator("a", (10**400, 2, 3))]}, "locator a has coordinate="),
    "infinite": ('{"locators": [{"id": "a", "coordinate": {"x": Infinity, "y": 1, "z": 1}}]}', "coordinate="),
    "far round": ({"locators": [locator("a", turn=(0, 0, 720))]}, "within +-360; locator a has orientation"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "words"), BAD.values(), ids=BAD)
def test_bad_files_give_one_line(content, words):
    with pytest.raises(BadValue, match=r"anchors='c\.json'") as error:
        read(content)
    assert words in str(error.value)
    assert "\n" not in str(error.value)
