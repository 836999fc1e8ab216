"""Receivers that move: a pose in each row of a log. Oracles are fixed anchors in the same poses, the
place of the transmitter, and laws: a shift and a rotation of the whole scene.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aoabench.config.compose import compose_cells
from aoabench.deployment.figures import _paths
from aoabench.deployment.request import Request
from aoabench.deployment.solving import solve
from aoabench.devices.geodesy import Origin
from aoabench.devices.longtable import as_tables
from aoabench.engine.draws import Draws
from aoabench.errors import UserError
from aoabench.maths.geometry import wrap
from aoabench.noise.recorded import Recorded as RecordedNoise
from aoabench.scenarios.recorded import Columns, Recorded

TARGET = np.array([30.0, 20.0])
METHODS = ["estimator=[robust_ml]", "estimator=[ls_lines]", "estimator=[ls]"]
FILTERS = ["filter=[ekf_vmf]", "filter=[ekf_ae_nominal]", "filter=[ekf_vmf_smoother]"]


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """The working folder."""
    monkeypatch.chdir(tmp_path)


def drive(count=24, target=TARGET, turned=0.0, shift=(0.0, 0.0)):
    """A drive around a transmitter with exact bearings; the scene is turned, then shifted."""
    k = np.arange(count)
    place = np.stack([60 * np.cos(k / 4), 50 * np.sin(k / 4)], axis=-1)
    c, s = np.cos(turned), np.sin(turned)
    R = np.array([[c, -s], [s, c]])
    place, target = place @ R.T + shift, R @ target + shift
    facing = np.degrees(wrap(k * 0.7 + turned))
    azimuth = np.arctan2(*(target - place).T[::-1]) - np.radians(facing)
    return pd.DataFrame(
        {
            "fix": 0, "time_s": k, "azimuth_deg": np.degrees(wrap(azimuth)),
            "anchor_x_m": place[:, 0], "anchor_y_m": place[:, 1], "anchor_facing_deg": facing,
        }
    )  # fmt: skip


def two_anchors(count=12, moving=True):
    """A walk heard by two anchors that stand still, with or without their poses in each row."""
    rows, rng = [], np.random.default_rng(1)
    for k in range(count):
        point = np.array([3 + 0.2 * k, 2 + 0.1 * k, 1.0])
        for name, (x, y, z, facing) in ANCHORS.items():
            d = point - (x, y, z)
            azimuth = np.degrees(np.arctan2(d[1], d[0])) - facing + rng.normal(0, 3)
            elevation = np.degrees(np.arctan2(d[2], np.hypot(*d[:2]))) + rng.normal(0, 3)
            rows.append(
                [k, name, wrap(np.radians(azimuth)) * 180 / np.pi, elevation, x, y, z, facing]
            )
    names = ["time_s", "anchor", "azimuth_deg", "elevation_deg"]
    poses = ["anchor_x_m", "anchor_y_m", "anchor_z_m", "anchor_facing_deg"]
    frame = pd.DataFrame(rows, columns=names + poses)
    return frame if moving else frame[names]


ANCHORS = {"a1": (0, 0, 2.5, 30), "a2": (8, 1, 2.25, 150)}


def read(log, anchors=None, name="log.csv", **changes):
    log.to_csv(name, index=False)
    return Recorded("recorded", name, anchors, **changes)


def method_of(word):
    (cell,) = compose_cells([word, "scenario=square_track_upright", "noise=vmf"])
    return next(iter(cell.estimators.values()))


def estimates(scenario, word, **changes):
    method = replace(method_of(word), **changes)
    return solve(scenario, RecordedNoise(), method, scenario.tracks.counts).estimates


@pytest.mark.parametrize("word", METHODS[:2])
@pytest.mark.parametrize("engine", ["auto", "numpy"])
def test_a_drive_around_a_transmitter_gives_its_place(word, engine):
    scenario = read(drive(), combine="each")
    assert scenario.tracks.measured.azimuth.shape == (1, 24)
    found = estimates(scenario, word, engine=engine)
    np.testing.assert_allclose(found.position[0, 0, :2], TARGET, atol=1e-6)
    assert found.outcome[0, 0] == 0


def test_windows_of_a_drive_give_the_place_each():
    frame = drive(48).drop(columns="fix")
    scenario = read(frame, combine="each", window_s=11.5)
    found = estimates(scenario, "estimator=[ls_lines]")
    assert found.position.shape == (1, 4, 3)
    np.testing.assert_allclose(found.position[0, :, :2], TARGET[None].repeat(4, 0), atol=1e-6)


@pytest.mark.parametrize("word", METHODS[:2])
def test_a_pose_per_row_equals_as_many_fixed_anchors(word):
    frame = drive(9)
    frame["azimuth_deg"] += np.random.default_rng(2).normal(0, 2, 9)
    moving = estimates(read(frame, combine="each"), word)
    file = frame.iloc[:, 3:].set_axis(["x_m", "y_m", "facing_deg"], axis=1)
    file.to_csv("anchors.csv", index=False)
    still = estimates(read(frame.assign(anchor=range(1, 10)).drop(columns=frame.columns[3:]), "anchors.csv", name="fixed.csv"), word)  # fmt: skip
    np.testing.assert_array_equal(moving.position, still.position)
    np.testing.assert_array_equal(moving.covariance, still.covariance)
    np.testing.assert_array_equal(moving.anchors_used, still.anchors_used)


@pytest.mark.parametrize("word", [*METHODS, *FILTERS])
@pytest.mark.parametrize("combine", ["error", "each", "mean", "median"])
def test_poses_that_stay_equal_fixed_anchors(word, combine):
    lines = [f"{name},{','.join(map(str, pose))}" for name, pose in ANCHORS.items()]
    Path("anchors.csv").write_text("\n".join(["id,x_m,y_m,z_m,facing_deg", *lines]))
    motion = "random_walk"
    moving = read(two_anchors(), motion=motion, combine=combine)
    still = read(two_anchors(moving=False), "anchors.csv", "still.csv", motion=motion, combine=combine)  # fmt: skip
    found, wanted = estimates(moving, word), estimates(still, word)
    np.testing.assert_allclose(found.position, wanted.position, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.covariance, wanted.covariance, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(found.outcome, wanted.outcome)
    known, other = moving.true_anchors, still.true_anchors
    np.testing.assert_array_equal(*np.broadcast_arrays(known.position, other.position))
    np.testing.assert_array_equal(*np.broadcast_arrays(known.rotation, other.rotation))


def test_shift_and_rotation_of_the_scene():
    shift, turned = np.array([100.0, -50.0]), 0.8
    c, s = np.cos(turned), np.sin(turned)
    noise = np.random.default_rng(3).normal(0, 2, 12)
    first, second = drive(12), drive(12, turned=turned, shift=shift)
    for frame in (first, second):
        frame["azimuth_deg"] += noise
    one, two = (
        estimates(read(frame, combine="each", name=f"{i}.csv"), "estimator=[robust_ml]").position
        for i, frame in enumerate((first, second))
    )
    moved = np.array([[c, -s], [s, c]]) @ one[0, 0, :2] + shift
    np.testing.assert_allclose(two[0, 0, :2], moved, atol=1e-5)


def test_degrees_and_bearings_equal_metres_and_facings():
    """As of a direction finder on a car: compass bearings, latitude and longitude in each row."""
    frame, origin = drive(12), Origin(60.17, 24.94)
    wanted = read(frame, combine="each").tracks
    place = np.column_stack([frame["anchor_x_m"], frame["anchor_y_m"], np.zeros(12)])
    lat, lon, height = origin.geodetic(place).T
    heading = 90 - frame["anchor_facing_deg"]
    log = frame.iloc[:, :3].assign(anchor_lat_deg=lat, anchor_lon_deg=lon, anchor_z_m=height)
    log["anchor_bearing_deg"] = heading
    at = [origin.lat_deg, origin.lon_deg]
    found = read(log, name="geo.csv", combine="each", origin_deg=at).tracks
    np.testing.assert_allclose(found.poses.position, wanted.poses.position, atol=1e-6)
    np.testing.assert_allclose(found.poses.rotation, wanted.poses.rotation, atol=1e-12)
    compass = (90 - frame["anchor_facing_deg"] - frame["azimuth_deg"]) % 360
    log = log.drop(columns="anchor_bearing_deg").assign(azimuth_deg=compass)
    north = {"frame": "global", "azimuth_sense": "clockwise", "azimuth_zero_deg": 90}
    scenario = read(log, name="compass.csv", combine="each", origin_deg=at, **north)
    np.testing.assert_allclose(
        estimates(scenario, METHODS[0]).position[0, 0, :2], TARGET, atol=1e-5
    )
    centred = read(log, name="compass.csv", combine="each", **north)
    assert any("centroid" in note for note in centred.notes)


def test_the_mean_pose_of_a_fix_and_a_note():
    frame = drive(4)
    frame["anchor_facing_deg"] = [170.0, -170.0, 175.0, -175.0]
    scenario = read(frame, combine="mean")
    poses, mean = scenario.tracks.poses, frame.mean()
    at = [mean["anchor_x_m"], mean["anchor_y_m"], 0]
    np.testing.assert_allclose(poses.position[0, 0, 0], at, atol=1e-12)
    np.testing.assert_allclose(poses.rotation[0, 0, 0, 0], [-1, 0, 0], atol=1e-12)
    assert any("receivers move by up to" in note for note in scenario.notes)
    frame["azimuth_deg"] = [np.nan, *frame["azimuth_deg"][1:]]
    used = read(frame, combine="mean").tracks.poses.position[0, 0, 0, 0]
    np.testing.assert_allclose(used, frame["anchor_x_m"][1:].mean())


def test_two_tags_and_permuted_rows():
    one = drive(12).assign(tag="p", anchor="car")
    two = drive(12, shift=(5.0, 9.0)).assign(tag="q", anchor="car")
    both = pd.concat([one, two]).sample(frac=1, random_state=1)
    found = read(both, name="both.csv", combine="each")
    for i, frame in enumerate((one, two)):
        alone = read(frame, combine="each")
        a = Draws(found, RecordedNoise(), 0).drawn(i, 1).whole
        b = Draws(alone, RecordedNoise(), 0).drawn(0, 1).whole
        for array, other in ((a.azimuth, b.azimuth), (a.anchors.position, b.anchors.position)):
            np.testing.assert_array_equal(array, other)


def test_an_anchor_that_was_not_heard_is_where_its_tag_has_it_before_or_else_after():
    rows = [("p", 0, "a"), ("p", 1, "b"), ("p", 2, "b"), ("p", 3, "a"), ("q", 0, "b"), ("q", 1, "a"), ("q", 1, "b")]  # fmt: skip
    frame = pd.DataFrame(rows, columns=["tag", "time_s", "anchor"]).assign(azimuth_deg=1.0)
    frame["anchor_x_m"] = np.arange(7.0)
    frame["anchor_y_m"] = -frame["anchor_x_m"]
    position = read(frame).tracks.poses.position[0]
    np.testing.assert_array_equal(position[:, 0, 0], [0, 0, 0, 3, 5, 5])
    np.testing.assert_array_equal(position[:, 1, 0], [1, 1, 2, 2, 4, 6])
    np.testing.assert_array_equal(position[..., 1], -position[..., 0])


def test_rows_without_a_pose():
    frame = drive(12)
    frame.loc[[2, 5], ["anchor_x_m", "anchor_y_m"]] = np.nan
    scenario = read(frame, combine="each")
    assert scenario.tracks.packets.tolist() == [10]
    assert any("2 rows without the pose" in note for note in scenario.notes)
    Path("anchors.csv").write_text("id,x_m,y_m,facing_deg,pitch_deg\ncar,7,8,0,20\n")
    scenario = read(frame.assign(anchor="car"), "anchors.csv", combine="each")
    assert scenario.tracks.packets.tolist() == [12]
    np.testing.assert_array_equal(scenario.tracks.poses.position[0, 0, 2], [7, 8, 0])
    tilt = scenario.tracks.poses.rotation[0, 0] @ [0, 0, 1]
    np.testing.assert_allclose(tilt, [[-np.sin(np.radians(20)), 0, np.cos(np.radians(20))]] * 12, atol=1e-12)  # fmt: skip


def test_packets_from_one_place_count_once():
    frame = drive(12)
    frame["anchor_x_m"], frame["anchor_y_m"] = 1.0 + 0.01 * np.arange(12), 2.0
    found = estimates(read(frame, combine="each"), METHODS[0])
    assert found.anchors_used[0, 0] == 1
    assert estimates(read(drive(12), combine="each"), METHODS[0]).anchors_used[0, 0] == 12


def test_the_exported_log_reads_back():
    scenario = read(drive(6), combine="each")
    batch = Draws(scenario, RecordedNoise(), 0).drawn(0, 1).whole
    tracks = scenario.tracks
    log, known = as_tables(batch, tracks.truth, None, tracks.fix)
    known.to_csv("known.csv", index=False)
    again = read(log, "known.csv", "again.csv", combine="each").tracks
    assert again.time[0] == tracks.time[0]
    order, wanted = (np.argsort(one.measured.azimuth[0]) for one in (again, tracks))
    for name, array in again.poses.arrays.items():
        expected = tracks.poses.arrays[name][0, 0, wanted]
        np.testing.assert_allclose(array[0, 0, order], expected, atol=1e-9)


def test_the_path_on_the_map():
    frame = drive(6)
    path = _paths(read(frame, combine="each").tracks, 1)[0]
    np.testing.assert_allclose(path, frame[["anchor_x_m", "anchor_y_m"]])
    assert not _paths(read(two_anchors()).tracks, 2)


@pytest.mark.parametrize(("change", "words"), [
    ({"anchor_y_m": None}, ["scenario.columns.anchor_y", "anchor_x_m"]),
    ({"anchor_x_m": None, "anchor_y_m": None}, ["--anchors is missing", "anchor_lat_deg"]),
    ({"anchor_bearing_deg": 1.0}, ["anchor_facing_deg and anchor_bearing_deg"]),
    ({"anchor_facing_deg": 4000.0}, ["anchor_facing_deg within +-360"]),
])  # fmt: skip
def test_mistakes_are_one_line(change, words):
    frame = drive(6)
    for name, value in change.items():
        frame = frame.drop(columns=name) if value is None else frame.assign(**{name: value})
    frame.to_csv("log.csv", index=False)
    with pytest.raises(UserError) as error:
        Request("log.csv", settings=("scenario.combine=each",)).asked()
    text = str(error.value)
    assert "\n" not in text
    for word in words:
        assert word in text


def test_a_wide_table_with_the_poses_of_each_anchor_equals_the_long_one():
    long = two_anchors()
    long["anchor_x_m"] += 0.1 * long["time_s"]
    wide = long.pivot(index="time_s", columns="anchor")
    wide.columns = [f"{name}_{anchor}" for name, anchor in wide.columns]
    wide.loc[3, ["azimuth_deg_a1", "elevation_deg_a1"]] = np.nan  # its pose is no measurement
    unheard = (long["time_s"] == 3) & (long["anchor"] == "a1")
    one, other = read(long[~unheard]), read(wide.reset_index(), name="wide.csv")
    assert one.tracks.poses is not None
    assert other.notes[0].removeprefix("wide") == one.notes[0].removeprefix("log")
    np.testing.assert_array_equal(other.recorded.azimuth, one.recorded.azimuth)
    np.testing.assert_array_equal(other.true_anchors.position, one.true_anchors.position)
    np.testing.assert_array_equal(other.true_anchors.rotation, one.true_anchors.rotation)


def test_other_names_of_columns():
    frame = drive(6).rename(columns={"anchor_x_m": "east", "anchor_y_m": "north"})
    names = Columns(anchor_x="east", anchor_y="north")
    found = read(frame, combine="each", columns=names).tracks
    np.testing.assert_array_equal(found.poses.position[0, 0, :, 0], frame["east"])
