"""One schema for files of anchors, whichever scenario reads them."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aoabench.devices.anchors import COLUMNS, read_anchors
from aoabench.errors import UserError
from aoabench.models.motion import ConstantAcceleration
from aoabench.scenarios.indoor_map import IndoorMap
from aoabench.scenarios.recorded import Recorded


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("fix,anchor,azimuth_deg\n1,1,10\n")
    return tmp_path


@pytest.mark.parametrize(("scale", "said"), [(1.0, False), (1000.0, True)])
def test_anchors_far_apart_are_doubted(scale, said, here):
    Path("a.csv").write_text(f"x_m,y_m\n0,0\n{12 * scale},{6 * scale}\n")
    line = "a.csv: x_m and y_m span 12000 and are read in m; are they in mm or cm?"
    assert read_anchors("anchors", "a.csv").notes == ((line,) if said else ())


def by_map(path):
    return IndoorMap("own", path, [[0, 0], [3, 0]], ConstantAcceleration(1.0), None)


def by_log(path):
    return Recorded("own", "log.csv", path, unknown_anchors="ignore")


def turned(axis, deg):
    """The matrix of a turn about a coordinate axis, counter-clockwise seen from its tip."""
    c, s = np.cos(np.deg2rad(deg)), np.sin(np.deg2rad(deg))
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


GOOD = {
    "x and y alone": ("x_m,y_m\n1,2\n5,6\n", [0, 0], [[0, 0, 0]] * 2),
    "a plan's": ("x_m,y_m,z_m,facing_deg\n1,2,3,90\n5,6,3,-45.5\n", [3, 3], [[90, 0, 0], [-45.5, 0, 0]]),
    "all columns, in another order": (
        "roll_deg,facing_deg,floor,y_m,x_m,id,pitch_deg,z_m\n20,110,EG,2,1,1,-35,3\n180,0,OG,6,5,b,0,2.8\n",
        [3, 2.8], [[110, -35, 20], [0, 0, 180]]),
    "semicolons and decimal commas": ("x_m;y_m;z_m\n1,0;2;3\n5;6;2,5\n", [3, 2.5], [[0, 0, 0]] * 2),
    "other case and marks": ("X (m),Y (m),Z [m],Facing (\u00b0)\n1,2,3,90\n5,6,3,-45.5\n", [3, 3], [[90, 0, 0], [-45.5, 0, 0]]),
    "compass": ("x_m,y_m,bearing_deg\n1,2,0\n5,6,135\n", [0, 0], [[90, 0, 0], [-45, 0, 0]]),
    "pitch without facing": ("id,x_m,y_m,pitch_deg\n1,1,2,30\nb,5,6,0\n", [0, 0], [[0, 30, 0], [0, 0, 0]]),
}  # fmt: skip


@pytest.mark.parametrize(("text", "z", "turns"), GOOD.values(), ids=GOOD)
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_both_scenarios_read_the_same_anchors(text, z, turns, kind, here):
    Path("a.csv").write_text(text)
    if kind == "parquet":
        marks = {"sep": ";", "decimal": ","} if ";" in text else {}
        pd.read_csv("a.csv", dtype={"id": str}, **marks).to_parquet("a.parquet")
    for anchors in (by_map(f"a.{kind}").true_anchors, by_log(f"a.{kind}").true_anchors):
        np.testing.assert_array_equal(anchors.position[0, 0], [[1, 2, z[0]], [5, 6, z[1]]])
        for R, (facing, pitch, roll) in zip(anchors.rotation[0, 0], turns):
            axes = turned(2, facing) @ turned(1, pitch) @ turned(0, roll)  # columns: local x, y, z
            np.testing.assert_allclose(R, axes.T, atol=1e-14)


def test_a_file_without_ids_has_numbers_from_1(here):
    Path("a.csv").write_text("x_m,y_m\n1,2\n5,6\n")
    Path("log.csv").write_text("fix,anchor,azimuth_deg\n1,2,10\n")
    measured = by_log("a.csv").recorded.azimuth
    np.testing.assert_allclose(np.rad2deg(measured), [[np.nan, 10]])
    assert read_anchors("anchors", "a.csv").ids == ["1", "2"]
    Path("log.csv").write_text("fix,anchor,azimuth_deg\n1,b,10\n")
    with pytest.raises(UserError, match=r"one of 1, 2 .*='b'; a.csv has no column id"):
        Recorded("own", "log.csv", "a.csv")


def test_the_shipped_anchors_are_a_file_like_any_other(here):
    from aoabench.resources import shipped

    shutil.copy(shipped("configs") / "plans" / "indoor_map_anchors.csv", "a.csv")
    assert by_log("a.csv").true_anchors.count == by_map("a.csv").true_anchors.count == 107


BAD = {
    "no y": ("x_m,z_m\n1,2\n", ["it has x_m, z_m", ", ".join(COLUMNS[-5:-1])]),
    "misspelt": ("x_m,ym\n1,2\n", ["did you mean 'ym'"]),
    "twice": ("x_m,y_m,z_m,z_m\n1,2,3,3\n", ["each once"]),
    "empty": ("", ["line 1 is empty"]),
    "no rows": ("x_m,y_m\n", ["at least one row"]),
    "same id": ("id,x_m,y_m\na,1,2\na,3,4\n", ["each id once", "line 3"]),
    "empty cell": ("x_m,y_m,z_m\n1,2,\n", ["line 2 has z_m=nan"]),
    "text": ("x_m,y_m,facing_deg\n1,2,north\n", ["line 2 has facing_deg='north'"]),
    "far round": ("x_m,y_m,facing_deg\n1,2,3600\n", ["line 2 has facing_deg=3600", "+-360"]),
    "two directions": ("x_m,y_m,facing_deg,bearing_deg\n1,2,3,4\n", ["either facing_deg or bearing_deg"]),
    "bearing": ("x_m,y_m,bearing\n1,2,3\n", ["call it facing_deg if it is that (bearing_deg if clockwise"]),
    "facing": ("x_m,y_m,facing\n1,2,90\n", ["'facing'", "call it facing_deg"]),
    "yaw": ("x_m,y_m,yaw_deg\n1,2,90\n", ["'yaw_deg'", "call it facing_deg"]),
    "tilt": ("x_m,y_m,Tilt (deg)\n1,2,90\n", ["'Tilt (deg)'", "call it pitch_deg"]),
    "height": ("x_m,y_m,height_m\n1,2,3\n", ["'height_m'", "call it z_m"]),
    "roll in rad": ("x_m,y_m,roll_rad\n1,2,3\n", ["'roll_rad'", "call it roll_deg"]),
    "half of the degrees": ("lat,x_m\n60,24\n", ["it has lat, x_m", "lat_deg and lon_deg"]),
    "far north": ("lat,lon\n160,24\n", ["latitudes within +-90", "160"]),
    "exchanged": ("lat,lon\n-123,45\n", ["latitudes and longitudes are exchanged?"]),
    "two heights": ("lat,lon,z_m,alt\n60,24,1,2\n", ["one column of heights", "alt and z_m"]),
    "clocks": ("x_m,y_m,clock_offset_s\n1,2,late\n", ["line 2 has clock_offset_s='late'"]),
}  # fmt: skip


@pytest.mark.parametrize(("text", "words"), BAD.values(), ids=BAD)
@pytest.mark.parametrize("read", [by_map, by_log])
def test_both_scenarios_refuse_the_same_files(text, words, read, here):
    Path("a.csv").write_text(text)
    with pytest.raises(UserError) as error:
        read("a.csv")
    assert "\n" not in str(error.value)
    for word in ("anchors=", "a.csv", *words):
        assert word in str(error.value), str(error.value)


def test_facings_in_rad_are_doubted(here):
    for facings, doubted in (
        ((0, 1.5708, 3.1416, -1.5708), True),
        ((0.785, 2.356), True),
        ((0, 0, 0), False),
        ((0, 90, 180), False),
        ((1.2, -3.4), False),
        ((0, 1, 2), False),
    ):
        rows = "".join(f"{i},{i},{facing}\n" for i, facing in enumerate(facings))
        Path("a.csv").write_text("x_m,y_m,facing_deg\n" + rows)
        for scenario in (by_map("a.csv"), by_log("a.csv")):
            assert any("not in rad" in line for line in scenario.notes) == doubted, facings


def test_heights_in_mm_are_doubted(here):
    for z, doubted in ((2500, True), (2.5, False), (99, False), (-3000, True)):
        Path("a.csv").write_text(f"x_m,y_m,z_m\n0,0,{z}\n12,6,{z}\n")
        for scenario in (by_map("a.csv"), by_log("a.csv")):
            assert any("read in m" in line for line in scenario.notes) == doubted, z
    Path("a.csv").write_text("x_m,y_m,z_m\n0,0,2500\n")
    assert by_map("a.csv").notes == ()
