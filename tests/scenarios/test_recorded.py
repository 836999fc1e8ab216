"""Recordings: conventions in closed form, real recordings, a round trip, and every mistake in one
clear line.
"""

import csv
import json
import math
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

import aoabench
from aoabench.cli.main import main
from aoabench.config.compose import compose_cells
from aoabench.config.plugins import construct
from aoabench.engine import runner
from aoabench.engine.replay import replay
from aoabench.engine.replay_files import write
from aoabench.errors import UserError
from aoabench.maths.geometry import euler, euler_of, in_frames, to_azel
from aoabench.report import campaign, plots
from aoabench.resources import shipped
from aoabench.scenarios.recorded import Recorded
from aoabench.store.fixes import fixes

REAL = Path(__file__).parents[3] / "shared" / "data"
needs_real = pytest.mark.skipif(
    not REAL.is_dir(), reason="the real recordings lie beside the repository, not in it"
)

ANCHORS = "id,x_m,y_m,z_m,facing_deg\na1,0,0,2,0\na2,6,0,2,90\na3,6,6,2,-135\n"
LOG = """fix,anchor,azimuth_deg,elevation_deg,rssi_dbm,x_m,y_m,z_m
1,a1,45,-10,-60,3,3,1
1,a2,20,-12,-61,3,3,1
2,a1,30,-9,-62,3,2,1
2,a3,-20,,-63,3,2,1
"""


def preset(**changes):
    node = yaml.safe_load((shipped("configs") / "scenario" / "recorded.yaml").read_text())
    columns = {"_target_": "aoabench.scenarios.recorded.Columns", **changes.pop("columns", {})}
    return construct({**node, **changes, "columns": columns}, "scenario")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The working folder, with anchors.csv and log.csv."""
    monkeypatch.chdir(tmp_path)
    Path("anchors.csv").write_text(ANCHORS)
    Path("log.csv").write_text(LOG)
    return tmp_path


def read(log=None, anchors="anchors.csv", path="log.csv", **changes):
    if log is not None:
        Path(path).write_text(log)
    return preset(path=path, anchors=anchors, **changes)


# --- what is read ---------------------------------------------------------------------------------


def test_a_long_table_becomes_fixes_by_anchors(here):
    s = read()
    nan = math.nan
    m = s.recorded
    np.testing.assert_allclose(np.rad2deg(m.azimuth), [[45, 20, nan], [30, nan, -20]])
    np.testing.assert_allclose(np.rad2deg(m.elevation), [[-10, -12, nan], [-9, nan, nan]])
    np.testing.assert_allclose(m.rssi, [[-60, -61, nan], [-62, nan, -63]])
    assert m.azimuth_sigma is None
    assert m.elevation_sigma is None
    np.testing.assert_allclose(s.truth(None), [[3, 3, 1], [3, 2, 1]])
    assert s.height_m is None  # the truth moves no position
    assert [file.path.name for file in s.files] == ["anchors.csv", "log.csv"]
    assert s.notes == ("log.csv: 2 fixes, 2 with ground truth; 4 rows of 3 anchors",)


def test_names_of_columns_and_formats_do_not_matter(here):
    frame = pd.read_csv("log.csv").rename(
        columns={
            "fix": "n",
            "anchor": "Anchor ID",
            "azimuth_deg": "az",
            "elevation_deg": "el",
            "x_m": "px",
        }
    )
    frame.to_parquet("log.parquet")
    Path("spaced.csv").write_text(
        "\ufeff" + frame.to_csv(index=False).replace(",", ", ").replace("\n", "\r\n\r\n")
    )
    columns = {"fix": "n", "anchor": "Anchor ID", "azimuth": "az", "elevation": "el", "x": "px"}
    for path in ("log.parquet", "spaced.csv"):
        s = preset(path=path, anchors="anchors.csv", columns=columns)
        for name in ("azimuth", "elevation", "rssi"):
            np.testing.assert_array_equal(getattr(s.recorded, name), getattr(read().recorded, name))


@pytest.mark.parametrize(
    "names",
    [
        "FIX,ANCHOR,AZIMUTH_DEG,ELEVATION_DEG,RSSI_DBM,X_M,Y_M,Z_M",
        "Fix,Anchor,Azimuth (deg),Elevation [\u00b0],RSSI/dBm,x (m),y (m),z (m)",
    ],
)
def test_default_names_in_other_case_and_with_other_marks(names, here):
    own, rows = Path("log.csv").read_text().split("\n", 1)
    assert own.count(",") == names.count(",")
    found = read(f"{names}\n{rows}", path="other.csv")
    for name in ("azimuth", "elevation", "rssi"):
        np.testing.assert_array_equal(getattr(found.recorded, name), getattr(read().recorded, name))
    np.testing.assert_array_equal(found.truth(None), read().truth(None))


def test_names_that_differ_in_case_alone_are_not_chosen_among(here):
    log = "Fix,fix,Azimuth_deg,AZIMUTH_DEG,anchor\n1,7,5,6,a1\n"
    with pytest.raises(UserError, match=r"columns\.azimuth=None .*did you mean"):
        read(log)
    found = read(log.replace("AZIMUTH_DEG", "other"))
    assert list(found.tracks.fix) == ["7"]


def test_ids_are_texts(here):
    Path("anchors.csv").write_text("id,x_m,y_m\n007,0,0\n1E5,1,0\n7,2,0\n")
    s = read("fix,anchor,azimuth_deg\n1,007,1\n1, 1E5 ,2\n1,7,3\n")
    np.testing.assert_allclose(np.rad2deg(s.recorded.azimuth), [[1, 2, 3]])
    pd.DataFrame({"fix": [1.0, 1.0], "anchor": [7.0, 7.0], "azimuth_deg": [3.0, 3.0]}).to_parquet(
        "log.parquet"
    )
    assert np.rad2deg(read(path="log.parquet").recorded.azimuth[0, 2]) == pytest.approx(3)


def test_a_layout_has_numbers_or_ids(here):
    layout = {
        "_target_": "aoabench.scenarios.layout.AnchorLayout",
        "position_m": [[0, 0, 2], [6, 0, 2]],
    }
    log = "fix,anchor,azimuth_deg\n1,{},30\n"
    for ids, word in ((None, "2"), (["p", "q"], "q")):
        s = read(log.format(word), anchors=layout, anchor_ids=ids)
        np.testing.assert_allclose(np.rad2deg(s.recorded.azimuth), [[math.nan, 30]])
    with pytest.raises(UserError, match="anchor_ids"):
        read(anchors=layout, anchor_ids=["p"])


def test_rows_within_the_window_make_a_fix_in_order_of_time(here):
    log = "time_s,anchor,azimuth_deg\n9.0,a1,1\n5.0,a1,2\n5.2,a2,3\n5.5,a3,4\n9.0,a2,5\n"
    nan = math.nan
    for window, expected in (
        (0, [[2, nan, nan], [nan, 3, nan], [nan, nan, 4], [1, 5, nan]]),
        (0.2, [[2, 3, nan], [nan, nan, 4], [1, 5, nan]]),
        (0.6, [[2, 3, 4], [1, 5, nan]]),
    ):
        s = read(log, window_s=window)
        np.testing.assert_allclose(np.rad2deg(s.recorded.azimuth), expected)
    ms = read(log.replace("time_s", "time_ms"), time_unit="ms", window_s=6e-4)
    assert len(ms.recorded.azimuth) == 2


def test_times_may_be_dates_and_a_fix_goes_before_them(here):
    log = "time_s,anchor,azimuth_deg\n2024-05-01T12:00:00.5Z,a1,1\n2024-05-01T14:00:00.6+02:00,a2,2\n2024-05-01 12:00:01Z,a1,3\n"
    s = read(log, window_s=0.2)
    np.testing.assert_allclose(
        np.rad2deg(s.recorded.azimuth), [[1, 2, math.nan], [3, math.nan, math.nan]]
    )
    boots = "time_s,anchor,azimuth_deg,fix\n900,a1,1,x\n5,a2,2,x\n,a1,3,w\n6,a2,4,w\n"
    s = read(boots)
    np.testing.assert_allclose(np.rad2deg(s.recorded.azimuth), [[1, 2, math.nan], [3, 4, math.nan]])


# --- conventions in closed form -------------------------------------------------------------------


def bearing_of(s):
    """Global directions (T, B, 3) that the recording says, unit vectors from each anchor."""
    m, a = s.recorded, s.true_anchors
    e = np.where(np.isfinite(m.elevation), m.elevation, 0.0)
    u = np.stack([np.cos(m.azimuth) * np.cos(e), np.sin(m.azimuth) * np.cos(e), np.sin(e)], axis=-1)
    return (u[..., None, :] @ a.rotation[0])[..., 0, :]


def degrees(u):
    return np.rad2deg(np.arctan2(u[..., 1], u[..., 0])), np.rad2deg(np.arcsin(u[..., 2]))


@pytest.mark.parametrize(("facing", "azimuth", "declared", "expected"), [
    # u-blox: negative is left, seen from the antenna
    (90, -30, {"azimuth_sense": "clockwise"}, 120),
    (90, 30, {"azimuth_sense": "clockwise"}, 60),
    (-135, 16, {"azimuth_sense": "clockwise"}, -151),
    (90, 30, {}, 120),  # house
    (90, 30, {"frame": "global"}, 30),
    # a compass
    (0, 30, {"frame": "global", "azimuth_sense": "clockwise", "azimuth_zero_deg": 90}, 60),
    (40, 350, {"frame": "global"}, -10),
    (0, 0.5, {"azimuth_unit": "rad", "columns": {"azimuth": "azimuth_deg"}}, math.degrees(0.5)),
    (10, 30, {"azimuth_zero_deg": -20}, 20),
    (90, 30, {"measured_by": "mobile", "frame": "global"}, -150),
    (90, 30, {"measured_by": "mobile", "heading_deg": 90}, -60),
    (0, 30, {"measured_by": "mobile", "heading_deg": 90, "azimuth_sense": "clockwise"}, -120),
])  # fmt: skip
def test_azimuths(here, facing, azimuth, declared, expected):
    Path("anchors.csv").write_text(f"id,x_m,y_m,facing_deg\na1,0,0,{facing}\n")
    s = read(f"fix,anchor,azimuth_deg\n1,a1,{azimuth}\n", **declared)
    assert degrees(bearing_of(s))[0][0, 0] == pytest.approx(expected)
    assert -np.pi < s.recorded.azimuth[0, 0] <= np.pi


@pytest.mark.parametrize(("value", "declared", "expected"), [
    (20, {}, 20),
    (20, {"elevation_kind": "depression"}, -20),
    (80, {"elevation_kind": "zenith"}, 10),
    (130, {"elevation_kind": "zenith"}, -40),
    (0.2, {"elevation_unit": "rad", "columns": {"elevation": "elevation_deg"}}, math.degrees(0.2)),
    (1.2, {"elevation_unit": "rad", "elevation_kind": "zenith", "columns": {"elevation": "elevation_deg"}}, 90 - math.degrees(1.2)),
    (20, {"measured_by": "mobile", "frame": "global"}, -20),
    (80, {"elevation_kind": "zenith", "measured_by": "mobile", "heading_deg": 5}, -10),
    (-100, {"elevation_limit_deg": 180}, -100),
])  # fmt: skip
def test_elevations(here, value, declared, expected):
    s = read(f"fix,anchor,azimuth_deg,elevation_deg\n1,a1,10,{value}\n", **declared)
    assert np.rad2deg(s.recorded.elevation[0, 0]) == pytest.approx(expected)


def test_no_elevation_is_not_measured(here):
    assert np.isnan(read(elevation_kind="none").recorded.elevation).all()
    assert np.isnan(read("fix,anchor,azimuth_deg\n1,a1,3\n").recorded.elevation).all()


def test_an_array_turned_by_euler_angles(here):
    """Silicon Labs: world = Rz(oz) Ry(oy) Rx(ox) u, the boresight is the local +z."""
    ox, oy, oz = 20, -35, 110
    Path("anchors.csv").write_text(
        f"id,x_m,y_m,z_m,facing_deg,pitch_deg,roll_deg\na1,0,0,3,{oz},{oy},{ox}\n"
    )
    s = read("fix,anchor,azimuth_deg,elevation_deg\n1,a1,40,60\n")
    a, e = np.deg2rad([40, 60])
    u = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    cx, cy, cz = np.cos(np.deg2rad([ox, oy, oz]))
    sx, sy, sz = np.sin(np.deg2rad([ox, oy, oz]))
    world = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]]) @ np.array(
        [[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]
    )
    world = world @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]) @ u
    np.testing.assert_allclose(bearing_of(s)[0, 0], world, atol=1e-12)
    Path("anchors.csv").write_text(
        "id,x_m,y_m,z_m,roll_deg\na1,0,0,3,180\n"
    )  # at the ceiling, looking down
    s = read("fix,anchor,azimuth_deg,elevation_deg\n1,a1,0,90\n")
    np.testing.assert_allclose(bearing_of(s)[0, 0], [0, 0, -1], atol=1e-12)


def test_a_pitched_antenna_looks_down(here):
    Path("anchors.csv").write_text("id,x_m,y_m,z_m,facing_deg,pitch_deg\na1,0,0,3,90,30\n")
    s = read("fix,anchor,azimuth_deg,elevation_deg\n1,a1,0,0\n")
    np.testing.assert_allclose(degrees(bearing_of(s)), [[[90]], [[-30]]], atol=1e-12)


def test_euler_angles_of_a_rotation(rng):
    for angles in (
        *rng.uniform(-3, 3, (200, 3)),
        [0.3, np.pi / 2, 0],
        [0, -np.pi / 2, 2.0],
        [0, 0, np.pi],
    ):
        np.testing.assert_allclose(euler(euler_of(euler(angles))), euler(angles), atol=1e-12)


def test_heading_from_a_column(here):
    log = "fix,anchor,azimuth_deg,heading_deg\n1,a1,30,90\n2,a1,30,0\n"
    s = read(log, measured_by="mobile")
    np.testing.assert_allclose(degrees(bearing_of(s))[0][:, 0], [-60, -150])
    for bad in (LOG, log.replace("30,0", "30,")):
        with pytest.raises(UserError, match="heading"):
            read(bad, measured_by="mobile")


RSSI = """fix,anchor,azimuth_deg,elevation_deg,rssi_dbm,x_m,y_m,z_m
1,a1,45,-10,{},3,3,1
1,a2,20,-12,{},3,3,1
"""


@pytest.mark.parametrize(("given", "declared", "expected"), [
    ((-60, 127), {}, (-60, math.nan)),
    ((-128, -90), {}, (math.nan, -90)),
    ((127.0, ""), {}, None),
    ((0, -90), {}, (0, -90)),
    ((0, -90), {"rssi_absent": [127, -128, 0]}, (math.nan, -90)),
    ((127, -90), {"rssi_absent": []}, (127, -90)),
    ((20, 255), {"rssi_absent": [255]}, (20, math.nan)),
])  # fmt: skip
def test_signal_strengths_that_mean_not_available(here, given, declared, expected):
    s = read(RSSI.format(*given), **declared)
    if expected is None:
        assert s.recorded.rssi is None
        assert "rssi" not in s.offers()
    else:
        np.testing.assert_array_equal(s.recorded.rssi, [[*expected, math.nan]])
    absent = sum(x in declared.get("rssi_absent", (127, -128)) for x in given)
    told = [line for line in s.notes if "not available" in line]
    assert len(told) == (absent > 0)
    numbers = sum(x != "" for x in given)
    assert all(f"{absent} of {numbers} rssi_dbm mean not available" in line for line in told)
    assert any("far below 20 dBm" in line for line in s.notes) == (given == (127, -90))


def test_the_strongest_anchor_is_one_that_has_a_strength(here):
    from aoabench.engine.draws import Draws
    from aoabench.engine.tiles import estimate_tile
    from aoabench.types import Outcome

    Path("log.csv").write_text(RSSI.format(-60, 127) + "2,a1,45,-10,127,3,3,1\n")
    words = ["scenario=recorded", "scenario.path=log.csv", "scenario.anchors=anchors.csv"]
    words += ["scenario.height_m=1", "estimator=[rssi_anchor,single_anchor_1]"]
    cell = compose_cells(words)[0]
    draws = Draws(cell.scenario, cell.noise, 1)
    best, first = (estimate_tile(draws, e, 0)[1] for e in cell.estimators.values())
    np.testing.assert_array_equal(best.position[0, 0], first.position[0, 0])
    assert best.outcome[0, 1] in (Outcome.FAILED, Outcome.REJECTED)  # no strength, no choice


@pytest.mark.parametrize("value", [5, "127", ["a"], [math.nan], [True]])
def test_sentinels_are_numbers(here, value):
    with pytest.raises(UserError, match=r"scenario\.rssi_absent"):
        read(rssi_absent=value)


def test_an_anchor_measures_alone_or_with_others(here):
    assert "several_anchors" in read().offers()
    assert (
        "several_anchors" not in read(LOG.replace("1,a2", "3,a2").replace("2,a3", "4,a3")).offers()
    )


def test_deviations(here):
    log = "fix,anchor,azimuth_deg,azimuth_sigma_deg,elevation_deg,elevation_sigma_deg\n1,a1,10,3,,\n1,a2,20,-5,7,2\n"
    with pytest.raises(UserError, match="line 3 has azimuth_sigma_deg=-5"):
        read(log)
    s = read(log, negative_sigma="absent")
    np.testing.assert_allclose(np.rad2deg(s.recorded.azimuth), [[10, math.nan, math.nan]])
    np.testing.assert_allclose(np.rad2deg(s.recorded.elevation), [[math.nan, 7, math.nan]])
    np.testing.assert_allclose(np.rad2deg(s.recorded.azimuth_sigma), [[3, math.nan, math.nan]])
    s = read(log, negative_sigma="absolute")
    np.testing.assert_allclose(np.rad2deg(s.recorded.azimuth_sigma), [[3, 5, math.nan]])
    np.testing.assert_allclose(np.rad2deg(s.recorded.elevation_sigma), [[math.nan, 2, math.nan]])


# --- mistakes -------------------------------------------------------------------------------------

HEAD = "fix,anchor,azimuth_deg,elevation_deg,x_m,y_m\n"
MISTAKES = {
    "missing column": (LOG.replace("azimuth_deg", "azimut_deg"), {}, ["scenario.columns.azimuth=None", "azimuth_deg", "azimut_deg", "elevation_deg", "did you mean 'azimut_deg'"]),
    "mapped column missing": (LOG, {"columns": {"rssi": "rsi"}}, ["scenario.columns.rssi='rsi'", "log.csv", "rssi_dbm", "x_m"]),
    "missing columns": (LOG.replace("_deg", "").replace("anchor", "ap"), {}, ["'scenario.columns={azimuth:NAME,anchor:NAME}' reads columns of other names"]),
    "unit of another column": (LOG, {"azimuth_unit": "rad"}, ["scenario.columns.azimuth", "azimuth_rad", "did you mean 'azimuth_deg'"]),
    "column twice": (LOG.replace("rssi_dbm", "anchor"), {}, ["scenario.columns.anchor='anchor'", "2 times"]),
    "neither fix nor time": (LOG.replace("fix,", "nr,"), {}, ["scenario.columns.time=None", "time_s", "or scenario.columns.fix", "nr, anchor"]),
    "x without y": (LOG.replace("y_m", "yy"), {}, ["scenario.columns.y=None", "y_m", "yy"]),
    "unknown anchor": (LOG + "3,a4,1,1,1,3,3,1\n", {}, ["scenario.path='log.csv'", "line 6 has anchor='a4'", "a1, a2, a3"]),
    "only unknown anchors": (HEAD + "1,b,1,1,1,1\n", {"unknown_anchors": "ignore"}, ["known anchor", "a1, a2, a3"]),
    "too large in deg": (HEAD + "1,a1,1,1,1,1\n1,a2,361,1,1,1\n", {}, ["line 3 has azimuth_deg=361", "+-360", "azimuth_unit=deg"]),
    "deg declared rad": (HEAD + "1,a1,1,1,1,1\n1,a2,45,1,1,1\n", {"azimuth_unit": "rad", "columns": {"azimuth": "azimuth_deg"}}, ["line 3 has azimuth_deg=45", "6.28319", "azimuth_unit=rad"]),
    "elevation": (HEAD + "\n\n1,a1,1,-91,1,1\n", {}, ["line 4 has elevation_deg=-91", "-90 to 90", "elevation_kind=elevation", "elevation_unit=deg"]),
    "zenith": (HEAD + "1,a1,1,-1,1,1\n", {"elevation_kind": "zenith"}, ["line 2 has elevation_deg=-1", "0 to 180", "elevation_kind=zenith"]),
    "no fix": (HEAD + "1,a1,1,1,1,1\n,a1,1,1,1,1\n", {}, ["line 3 has fix=nan", "every row"]),
    "no anchor": (HEAD + "1,a1,1,1,1,1\n2, ,1,1,1,1\n", {}, ["line 3 has anchor=", "every row"]),
    "no time": ("time_s,anchor,azimuth_deg\n1,a1,1\n,a2,1\n", {}, ["line 3 has time_s=nan", "every row"]),
    "no date": ("time_s,anchor,azimuth_deg\n2024-05-01,a1,1\nsoon,a2,1\n", {}, ["line 3 has time_s='soon'", "ISO 8601"]),
    "no number": (HEAD + "1,a1,1,1,1,1\n1,a2,12;5,1,1,1\n", {}, ["line 3 has azimuth_deg='12;5'", "finite numbers in azimuth_deg"]),
    "decimal comma": (HEAD + "1,a1,1,1,1,1\n" * 60 + '1,a2,"12,5",1,1,1\n', {}, ["line 62 has azimuth_deg='12,5'", "scenario.decimal=','"]),
    "truth values": (HEAD + "1,a1,True,1,1,1\n1,a2,False,1,1,1\n", {}, ["line 2 has azimuth_deg=True"]),
    "infinite": (HEAD + "1,a1,inf,1,1,1\n", {}, ["line 2 has azimuth_deg=inf"]),
    "decimal commas": (HEAD + "1,a1,1,1,1,1\n1,a2,12,5,1,1,1\n", {}, ["6 cells", "line 3 has more"]),
    "decimal commas first": (HEAD + "1,a1,12,5,1,1,1\n1,a2,1,1,1,1\n", {}, ["6 cells"]),
    "conflicting duplicates": (HEAD + "1,a1,1,1,1,1\n1,a2,7,1,1,1\n1,a1,2,1,1,1\n", {}, ["line 2", "line 4", "azimuth_deg=1", "azimuth_deg=2", "anchor='a1'", "scenario.combine=median, mean or each"]),
    "header alone": (HEAD, {}, ["scenario.path='log.csv'", "at least one row"]),
    "empty": ("", {}, ["scenario.path='log.csv'", "empty"]),
    "open quote": (HEAD + '1,a1,1,1,1,"1\n', {}, ["scenario.path='log.csv'", "readable"]),
    "window": (LOG, {"window_s": -1}, ["scenario.window_s=-1", ">= 0"]),
    "sense": (LOG, {"azimuth_sense": "left"}, ["scenario.azimuth_sense='left'", "counterclockwise, clockwise"]),
    "heading of anchors": (LOG, {"heading_deg": 90}, ["scenario.heading_deg=90", "measured_by=mobile"]),
    "no heading": (LOG, {"measured_by": "mobile"}, ["scenario.columns.heading", "heading_deg"]),
    "bounds": (LOG, {"bounds_m": [[1, 1], [0, 2]]}, ["scenario.bounds_m", "lower corner"]),
    "unknown key of columns": (LOG, {"columns": {"azimut": "az"}}, ["scenario.columns.azimut", "did you mean 'scenario.columns.azimuth'"]),
    "name of a column": (LOG, {"columns": {"azimuth": 7}}, ["scenario.columns.azimuth=7", "name of a column"]),
}  # fmt: skip


@pytest.mark.parametrize(("log", "changes", "words"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_have_one_line_with_key_value_and_allowed(here, log, changes, words):
    with pytest.raises(UserError) as error:
        read(log, **changes)
    for word in words:
        assert word in str(error.value), (word, str(error.value))


def test_a_misspelt_file_is_told_from_its_neighbour(here):
    for key, name, near in (("path", "log.cvs", "log.csv"), ("anchors", "no/anchors.csv", "")):
        with pytest.raises(UserError, match=f"scenario.{key}='{name}'") as error:
            read(**{"path": "log.csv", "anchors": "anchors.csv", key: name})
        assert str(error.value).endswith(f"; did you mean '{near}'?") == bool(near)


@pytest.mark.parametrize(("content", "words"), [
    ("id,x_m,y\na1,1,2\n", ["columns x_m, y_m and", "it has id, x_m, y"]),
    ("id,x_m,y_m\na1,1,2\na1,3,4\n", ["each id once", "line 3 has id='a1'"]),
    ("id,x_m,y_m\na1,1,\n", ["line 2 has y_m=nan", "every row"]),
    ("id,x_m,y_m,facing_deg\na1,1,2,north\n", ["line 2 has facing_deg='north'"]),
])  # fmt: skip
def test_mistakes_in_the_anchors(here, content, words):
    Path("anchors.csv").write_text(content)
    with pytest.raises(UserError) as error:
        read()
    for word in ("scenario.anchors='anchors.csv'", *words):
        assert word in str(error.value), (word, str(error.value))


def test_files_that_are_none(here):
    Path("folder.csv").mkdir()
    Path("torn.parquet").write_bytes(b"PAR1 and then nothing")
    Path("latin.csv").write_bytes(LOG.replace("rssi", "stärke").encode("latin-1"))
    Path("zeros.csv").write_bytes(LOG.encode() + b"\0")
    Path("log.json").write_text("{}")
    for path, words in (
        ("nowhere.csv", ["existing", ".csv", ".parquet"]),
        ("folder.csv", ["existing", "this is a folder"]),
        ("torn.parquet", ["readable"]),
        ("latin.csv", ["UTF-8"]),
        ("zeros.csv", ["is 0, as in binary files"]),
        ("log.json", [".csv", ".parquet"]),
        (None, ["existing"]),
        ("a\0b", ["existing"]),
    ):
        for key, given in (
            ("path", {"path": path, "anchors": "anchors.csv"}),
            ("anchors", {"path": "log.csv", "anchors": path}),
        ):
            with pytest.raises(UserError) as error:
                preset(**given)
            for word in (f"scenario.{key}={path!r}", *words):
                assert word in str(error.value), (word, str(error.value))
            assert "\n" not in str(error.value)
            assert str(error.value).count("not allowed") == 1


def test_rows_of_parquet_are_counted_from_1(here):
    frame = pd.read_csv("log.csv")
    frame.loc[2, "azimuth_deg"] = 400.0
    frame.to_parquet("log.parquet")
    with pytest.raises(UserError, match="row 3 has azimuth_deg=400"):
        read(path="log.parquet")
    frame.assign(azimuth_deg=[[1]] * 4).to_parquet("log.parquet")
    with pytest.raises(UserError, match="'azimuth_deg' has the type list<element: int64>"):
        read(path="log.parquet")


def test_a_misspelt_anchor_is_guessed(here):
    Path("anchors.csv").write_text("id,x_m,y_m\n6C1DEBA09949,0,0\n6C1DEBA09950,1,0\n")
    with pytest.raises(
        UserError, match=r"line 2 has anchor='6C1DEBA0994'.*did you mean '6C1DEBA09949'"
    ):
        read("fix,anchor,azimuth_deg\n1,6C1DEBA0994,3\n")


def test_duplicates(here):
    same = HEAD + "1,a1,1,,1,1\n1,a1,1,,1,1\n1,a2,3,,1,1\n"
    s = read(same)
    assert s.notes[-1] == (
        "log.csv: 1 of 3 rows not used: further rows of an anchor in a fix (scenario.combine)"
    )
    differ = same.replace("1,a1,1,,1,1\n1,a2", "1,a1,2,,1,1\n1,a2")
    for which, value in (("first", 1), ("last", 2)):
        s = read(differ, combine=which)
        np.testing.assert_allclose(np.rad2deg(s.recorded.azimuth), [[value, 3, math.nan]])


def test_unknown_anchors_may_be_ignored(here):
    s = read(LOG + "2,a9,1,1,1,3,2,1\n", unknown_anchors="ignore")
    assert s.recorded.azimuth.shape == (2, 3)
    assert s.notes[1] == "log.csv: 1 rows of unknown anchors left out"


def test_rad_declared_as_deg_is_doubted(here):
    rows = "".join(f"{i},a1,{0.1 * i}\n" for i in range(30))
    assert "azimuth_unit=rad" in read("fix,anchor,azimuth_deg\n" + rows).notes[-1]
    whole = "".join(f"{i},a1,{i % 6}\n" for i in range(30))
    for log in (
        "fix,anchor,azimuth_deg\n" + whole,
        "fix,anchor,azimuth_deg\n" + rows + "31,a1,50\n",
    ):
        assert len(read(log).notes) == 1


def test_a_million_rows(here):
    T, rng = 250_000, np.random.default_rng(1)
    frame = pd.DataFrame(
        {"time_s": np.repeat(np.arange(T) / 10, 4), "anchor": np.tile(["a1", "a2", "a3", "a4"], T)}
    )
    frame["azimuth_deg"] = rng.uniform(-180, 180, 4 * T)
    frame["x_m"], frame["y_m"] = (np.repeat(rng.uniform(0, 9, T), 4) for _ in range(2))
    frame.to_parquet("log.parquet")
    Path("anchors.csv").write_text("id,x_m,y_m\na1,0,0\na2,9,0\na3,9,9\na4,0,9\n")
    s = read(path="log.parquet")
    np.testing.assert_allclose(
        np.rad2deg(s.recorded.azimuth).ravel(), frame["azimuth_deg"], atol=1e-12
    )


# --- runs -----------------------------------------------------------------------------------------


def run(capsys, *overrides):
    with pytest.raises(SystemExit) as stop:
        main(
            [
                "run",
                "scenario=recorded",
                "scenario.path=log.csv",
                "scenario.anchors=anchors.csv",
                "runner.n_jobs=1",
                "runner.out=out",
                *overrides,
            ]
        )
    return stop.value.code, *capsys.readouterr()


WORDS = "estimator=[ls_lines,anchor_mean]", "scenario.height_m=1"


def test_a_run_is_one_replication_of_no_noise(here, capsys):
    code, out, err = run(capsys, *WORDS)
    assert code == 0, err
    assert "2 fixes" in err
    assert "reps" not in err
    frame = aoabench.load("out")
    assert list(frame["replication"]) == [0, 0]
    assert set(frame["noise"]) == {"recorded"}
    cell = frame["cell"].iloc[0]
    for kind in ("cdf", "median_map"):
        assert f"out/figures/{cell}-{kind}.png" in out
        assert Path(f"out/figures/{cell}-{kind}.png").stat().st_size > 5000
    code, out, err = run(capsys, *WORDS, "reps=50", "noise=ae_flip")
    assert "0 replications x estimators computed, 2 reused" in out
    assert "reps=50 is taken as 1" in err
    assert "noise is not used" in err
    Path("log.csv").write_text(LOG.replace("1,a1,45", "1,a1,44"))
    assert "2 replications x estimators computed" in run(capsys, *WORDS)[1]


def test_columns_on_the_command_line(here, capsys):
    Path("log.csv").write_text(LOG.replace("azimuth_deg", "az of it").replace("anchor", "who"))
    code, out, err = run(
        capsys, "estimator=[ls_lines]", 'scenario.columns={azimuth:"az of it",anchor:who}'
    )
    assert code == 0, err
    code, out, err = run(capsys, "estimator=[ls_lines]", "scenario.columns={azimuth:az,anchor:who}")
    assert (code, len(err.splitlines())) == (2, 1)
    assert "scenario.columns.azimuth='az'" in err
    code, out, err = run(capsys, "estimator=[ls_lines]", "scenario.columns={azimut:az}")
    assert (code, len(err.splitlines())) == (2, 1)
    assert "azimut" in err


def test_without_ground_truth_positions_are_the_product(here, capsys):
    log = pd.read_csv("log.csv").drop(columns=["x_m", "y_m", "z_m"])
    log.to_csv("log.csv", index=False)
    code, out, err = run(capsys, "estimator=[anchor_mean]")
    assert code == 2
    assert "height_m" in err  # methods in the plane need to know the plane
    code, out, err = run(capsys, "estimator=[best_anchor]", "scenario.height_m=1")
    assert code == 2
    assert "true positions are known" in err
    some = "estimator=[ls_lines,anchor_mean,ls,ml_kcorr]"
    code, out, err = run(capsys, some, "scenario.height_m=1", "store.steps=true")
    assert code == 0, err
    assert "RMSE" not in out, "no error without a truth"
    assert "median score" in out
    assert [file.name[12:] for file in Path("out/figures").iterdir()] == ["-positions.png"]
    frame = aoabench.load("out").set_index("estimator")
    assert frame[["rmse_3d_m", "rmse_xy_m", "rmse_z_m"]].isna().all(axis=None)
    # in the second fix, a3's azimuth meets a1's ray behind a3
    assert frame.loc[["ls_lines", "anchor_mean"], "n_ok"].tolist() == [1, 2]
    assert frame.loc["ls_lines", ["n_diverged", "reason"]].tolist() == [1, "behind"]
    steps = pd.concat(pd.read_parquet(f) for f in Path("out/steps.parquet").glob("*.parquet"))
    lines = steps[steps["estimator"] == "ls_lines"]
    assert np.isfinite(lines[["x_m", "y_m"]]).all(axis=None)
    assert lines["error_xy_m"].isna().all()
    with pytest.raises(SystemExit) as stop:
        main(["compare", "out"])
    assert stop.value.code == 0


def test_errors_are_those_of_fixes_whose_truth_is_known(here, capsys):
    Path("log.csv").write_text(LOG.replace("3,2,1", ",,"))
    assert run(capsys, "estimator=[ls_lines]")[0] == 0
    row = aoabench.load("out").iloc[0]
    errors = fixes("out", row["cell"], "ls_lines").error_xy_m[0]
    assert np.isnan(errors).tolist() == [False, True]
    assert row["rmse_xy_m"] == pytest.approx(errors[0], rel=1e-6)
    assert row["n_fixes"] == 2
    s = preset(path="log.csv", anchors="anchors.csv")
    np.testing.assert_array_equal(s.truth(None), [[3, 3, 1], [math.nan] * 3])


@pytest.mark.parametrize(("scenario", "kind", "estimators"), [
    ("ble_room", "csv", ["ls_lines", "ml_kcorr", "anchor_mean"]),
    ("ble_room", "parquet", ["ls_lines"]),
    ("square_track", "csv", ["ls", "ls_lines"]),  # anchors that lie on their sides
])  # fmt: skip
def test_an_exported_replication_gives_the_same_errors(scenario, kind, estimators, here, capsys):
    some = [f"estimator=[{','.join(estimators)}]", "store.steps=true", "runner.n_jobs=1"]
    few = ["scenario.packets=5"] if scenario == "ble_room" else []
    done = runner.run(
        compose_cells(
            [f"scenario={scenario}", "noise=ae_normal", "reps=2", "runner.out=first", *few, *some]
        )
    )
    text = write(replay(done.out, 1, "ls_lines"), kind)
    words = shlex.split(text.splitlines()[-1].removeprefix("read the log: aoabench run "))
    again = runner.run(compose_cells([*words, *some, "runner.out=again"]))
    steps = [
        pd.concat(pd.read_parquet(f) for f in (d.out / "steps.parquet").glob("*.parquet"))
        for d in (done, again)
    ]
    for name in estimators:
        first, second = (frame[frame["estimator"] == name] for frame in steps)
        first = first[first["replication"] == 1]
        for column in ("x_m", "y_m", "z_m", "error_3d_m", "error_xy_m"):
            np.testing.assert_allclose(second[column], first[column], atol=1e-9, rtol=0)
        assert list(second["outcome"]) == list(first["outcome"])


# --- real recordings ------------------------------------------------------------------------------


@pytest.fixture
def infrared(here):
    rows = [["fix", "anchor", "azimuth_deg", "x_m", "y_m"]]
    for file in sorted((REAL / "roh_ired").glob("X*.csv")):
        x, y = (part[1:] for part in file.stem.split("_"))
        for i, line in enumerate(csv.reader(file.open())):
            rows += [[f"{file.stem}-{i}", j + 1, value, x, y] for j, value in enumerate(line)]
    with Path("log.csv").open("w") as file:
        csv.writer(file).writerows(rows)
    marks = [
        f"{j + 1},{line.strip()}"
        for j, line in enumerate((REAL / "roh_ired" / "landmark.csv").read_text().split("\n"))
        if line.strip()
    ]
    Path("anchors.csv").write_text("id,x_m,y_m\n" + "\n".join(marks))


def errors_of(*declared):
    overrides = [
        "scenario=recorded",
        "scenario.path=log.csv",
        "scenario.anchors=anchors.csv",
        "estimator=[ls_lines]",
        "runner.n_jobs=1",
    ]
    done = runner.run(
        compose_cells([*overrides, *declared, f"runner.out=out{len(list(Path().glob('out*')))}"]),
        progress=False,
    )
    (cell,) = pd.read_parquet(done.out / "cells.parquet")["cell"]
    return fixes(done.out, cell, "ls_lines").error_xy_m[0]


@needs_real
def test_infrared_landmarks_seen_by_a_robot(infrared):
    declared = ["scenario.measured_by=mobile", "scenario.heading_deg=90"]
    errors = errors_of(*declared)
    assert len(errors) > 1700
    assert np.isfinite(errors).all()
    right = np.sqrt(np.mean(errors**2))
    assert 0.05 < right < 0.2
    wrong = (
        ["scenario.measured_by=mobile", "scenario.heading_deg=80"],
        [*declared, "scenario.azimuth_sense=clockwise"],
        [*declared, "scenario.azimuth_zero_deg=10"],
        ["scenario.measured_by=anchor"],
    )
    for other in wrong:
        assert np.sqrt(np.nanmean(errors_of(*other) ** 2)) > 3 * right, other


@pytest.fixture
def wifi(here):
    rows, anchors = [["fix", "anchor", "azimuth_deg", "zenith_deg", "x_m", "y_m", "z_m"]], {}
    for file in sorted((REAL / "wsr_wifi").glob("LOS_Set_*_using_groundtruth_displacement.json")):
        for place, runs in json.loads(file.read_text()).items():
            for seen in runs:
                sender, receiver = (
                    seen["a_INFO_Transmitting_robot"],
                    seen["b_INFO_Receiving_robot"]["groundtruth_start_position"],
                )
                at = sender["groundtruth_position"]
                # they were moved between the sets
                name = f"{sender['Name']} {at['x']:.3f} {at['y']:.3f}"
                anchors[name] = [name, at["x"], at["y"], at["z"]]
                peak = seen["d_INFO_AOA_profile"]["Top_N_peaks"]["1"]
                angles = [peak["estimated_azimuth"], sender["groundtruth_elevation"]]
                rows.append([f"{file.stem}-{place}", name, *angles, *(receiver[a] for a in "xyz")])
    for path, table in (
        ("log.csv", rows),
        ("anchors.csv", [["id", "x_m", "y_m", "z_m"], *anchors.values()]),
    ):
        with Path(path).open("w", newline="") as file:
            csv.writer(file).writerows(table)


@needs_real
def test_wifi_transmitters_seen_by_a_robot(wifi):
    declared = ["scenario.measured_by=mobile", "scenario.frame=global"]
    errors = errors_of(*declared)
    assert len(errors) > 15
    right = np.nanmedian(errors)
    assert 0.1 < right < 0.6
    for wrong in ("scenario.azimuth_sense=clockwise", "scenario.azimuth_zero_deg=60"):
        assert np.nanmedian(errors_of(*declared, wrong)) > 2 * right, wrong


@needs_real
def test_the_true_zenith_angles_are_read_as_such(wifi):
    s = preset(
        path="log.csv", anchors="anchors.csv", measured_by="mobile", frame="global",
        elevation_kind="zenith", columns={"elevation": "zenith_deg"},
    )  # fmt: skip
    a, e = to_azel(
        *in_frames(s.truth(None)[None], s.true_anchors.position, s.true_anchors.rotation)
    )
    seen = np.isfinite(s.recorded.elevation)
    assert np.abs(s.recorded.elevation - e[0])[seen].max() < np.deg2rad(0.1)
    off = np.rad2deg(np.abs(np.angle(np.exp(1j * (s.recorded.azimuth - a[0]))))[seen])
    assert np.median(off) < 10


# --- figures --------------------------------------------------------------------------------------


def test_figures_of_a_campaign(rng, tmp_path):
    errors = {
        f"method_{i}": np.where(rng.random(300) < 0.1 * i, np.nan, rng.gamma(2, 0.3, 300))
        for i in range(4)
    }
    errors["none"] = np.full(300, np.nan)
    band = (np.array([0.0, 1, 2]), np.array([0.0, 0.5, 0.8]), np.array([0.1, 0.7, 0.9]))
    points, anchors = rng.uniform(0, 5, (12, 2)), np.array([[0, 0], [5.0, 5]])
    medians = {name: e[:12] for name, e in errors.items()}
    made = {
        "cdf": lambda: campaign.cdf(errors, {"method_0": band}),
        "map": lambda: campaign.median_maps(points, medians, anchors, np.array([[0, 0], [5, 6]])),
        "one": lambda: campaign.median_maps(points[:1], {"a": np.array([0.3])}, anchors),
        "track": lambda: campaign.track_maps(
            np.cumsum(rng.normal(size=(300, 2)), axis=0), errors, anchors
        ),
    }
    for name, make in made.items():
        assert plots.save(make, tmp_path / f"{name}.png").stat().st_size > 5000
    figure = campaign.cdf(errors)
    labels = [t.get_text() for t in figure.axes[0].get_legend().get_texts()]
    assert labels[0].endswith("100.0% of 300 fixes")
    assert labels[-1] == "none: 0.0% of 300 fixes"
    top = [line.get_ydata()[-1] for line in figure.axes[0].lines]
    np.testing.assert_allclose(top, [np.isfinite(e).mean() for e in errors.values()])


def test_the_axis_of_errors_holds_them_all_or_counts_those_beyond():
    figure = campaign.cdf({"few": np.linspace(0.1, 1, 10)})
    (axis,) = figure.axes
    assert 1.0 < axis.get_xlim()[1] < 1.1
    assert "beyond" not in axis.get_legend().get_texts()[0].get_text()
    (axis,) = campaign.cdf({"far": np.r_[np.full(100, 1.0), 50, 60]}).axes
    assert axis.get_xlim()[1] == pytest.approx(1.02 * 1.5)
    assert axis.get_legend().get_texts()[0].get_text().endswith("fixes, 2 beyond the axis")


def test_a_recording_is_pickled_for_workers(here):
    import pickle

    s = read()
    again = pickle.loads(pickle.dumps(s))
    assert isinstance(again, Recorded)
    np.testing.assert_array_equal(again.recorded.azimuth, s.recorded.azimuth)


def test_places_that_a_target_was_at(rng):
    spots = np.array([[0, 0], [1, 0], [1, 1.0]])
    which = rng.integers(0, 3, 500)
    points, place = campaign.places(spots[which] + rng.uniform(-0.02, 0.02, (500, 2)))
    assert len(points) == 3
    assert np.hypot(*(points[place] - spots[which]).T).max() < 0.1
    assert (
        len(campaign.places(np.stack([np.arange(5000) / 10, np.zeros(5000)], axis=-1), most=20)[0])
        == 21
    )
