"""Small logs, anchors and plans as people in the field have them give their right answers.

The folders of `tests/corpus/logs` are made up: a room of 12 x 6 m with an antenna board on each
wall; the tag stands at the points P, one after the other.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

LOGS = Path(__file__).parents[1] / "corpus" / "logs"
P = np.array([(3, 2, 1.1), (9, 4, 1.1), (5, 3, 1.1), (7, 2, 1.1)])
ROUTE = "scenario.route=[[1,1],[11,1],[11,5],[1,5]]"


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def located(call):
    """The function (case, log, settings) -> table of fixes and what was printed."""

    def run(case, log, *settings, anchors="anchors.csv"):
        folder = LOGS / case
        words = "locate", folder / log, "--anchors", folder / anchors, "-o", "fixes.csv", *settings
        status, out, err = call(*words)
        assert status == 0, err
        return pd.read_csv("fixes.csv"), out + err

    return run


def xyz(frame):
    return frame[["x_m", "y_m", "z_m"]].to_numpy()


def one_line(error):
    return len(error.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("case", "log", "settings", "tolerance_m"),
    [
        ("ublox_lines", "capture.log", (), 0.15),
        ("ublox_lines", "capture.log", ("--format", "ublox"), 0.15),
        ("silabs_mqtt", "mqtt.txt", (), 0.01),
        ("silabs_mqtt", "mqtt.txt", ("--format", "silabs"), 0.01),
        ("semicolon_decimal_comma", "log.csv", (), 0.01),
        ("wide_table", "log.csv", (), 0.01),
        ("epoch_milliseconds", "log.csv", ("scenario.time_unit=ms", "scenario.window_s=0.1"), 0.01),
        ("many_packets_at_a_point", "log.csv", ("scenario.combine=mean",), 0.4),
        ("many_packets_at_a_point", "log.csv", ("scenario.combine=median",), 0.4),
        ("many_packets_at_a_point", "log.csv", ("scenario.combine=each",), 0.4),
    ],
)
def test_positions(located, case, log, settings, tolerance_m):
    frame, _ = located(case, log, *settings)
    assert len(frame) == 4
    assert (frame.outcome == "ok").all()
    np.testing.assert_allclose(np.linalg.norm(xyz(frame) - P, axis=1), 0, atol=tolerance_m)


def test_a_tag_of_ublox_lines_is_named(located):
    frame, _ = located("ublox_lines", "capture.log")
    assert set(frame.tag) == {"C0FFEE000000"}


def test_ranges_from_signal_strengths_are_noted_and_not_used(located):
    _, said = located("silabs_mqtt", "mqtt.txt")
    assert any("range" in line and "not used" in line for line in said.splitlines()), said


def test_anchors_of_a_positioning_config(located):
    frame, _ = located("silabs_config", "log.csv", anchors="positioning_config.json")
    np.testing.assert_allclose(xyz(frame), P, atol=0.01)


def test_two_tags_with_anchors_of_their_own(located):
    frame, _ = located("two_tags_disjoint", "log.csv")
    assert (frame.anchors_used == 2).all()
    expected = {"T1": P[[0, 1, 2, 3]], "T2": P[[1, 2, 3, 0]]}
    for tag, rows in frame.groupby("tag"):
        near = np.linalg.norm(xyz(rows)[:, None] - P, axis=2).min(axis=1)
        np.testing.assert_allclose(near, 0, atol=0.01)
        np.testing.assert_allclose(xyz(rows)[0], expected[tag][0], atol=0.01)
    assert sorted(frame.tag) == ["T1"] * 4 + ["T2"] * 4


def test_two_tags_with_the_same_anchors(located):
    frame, said = located("two_tags_shared", "log.csv")
    assert sorted(frame.tag) == ["T1"] * 4 + ["T2"] * 4
    expected = {"T1": P, "T2": P[[1, 2, 3, 0]]}
    for tag, rows in frame.groupby("tag"):
        np.testing.assert_allclose(xyz(rows), expected[tag], atol=0.01)
    assert "first" not in said
    assert "last" not in said


def test_milliseconds_under_the_default_unit_are_told(call):
    folder = LOGS / "epoch_milliseconds"
    words = "locate", folder / "log.csv", "--anchors", folder / "anchors.csv"
    status, _, err = call(*words, "scenario.window_s=0.1")
    assert status == 2
    assert one_line(err)
    assert "time_unit=ms" in err


@pytest.mark.parametrize(
    ("case", "truth"), [("moving_truth", ()), ("truth_in_a_file", ("--truth", "truth.csv"))]
)
def test_truth_that_moves_or_lies_in_a_file(located, case, truth):
    given = [LOGS / case / word if word.endswith(".csv") else word for word in truth]
    frame, _ = located(case, "log.csv", "scenario.window_s=0.1", *given)
    assert len(frame) == 4
    assert (frame.error_3d_m < 0.02).all()
    true = frame[["true_x_m", "true_y_m", "true_z_m"]].to_numpy()
    np.testing.assert_allclose(true, P, atol=0.015)


def test_a_wrong_sense_shows_in_the_residuals(located):
    _, said = located("wrong_sense", "log.csv", "scenario.azimuth_sense=clockwise")
    assert "residual" in said.lower()
    assert "sense" in said


def test_a_wrong_facing_shows_at_its_anchor(located):
    """The loss `student` keeps some of the pull of an anchor that is 90 deg off, `truncated` none."""
    frame, said = located("yaw_off_by_90", "log.csv", "estimator.robust_ml.loss=truncated")
    (line,) = (one for one in said.splitlines() if "A2" in one and "residual" in one.lower())
    assert any(f"{turn}" in line for turn in (88, 89, 90, 91)), line
    np.testing.assert_allclose(np.linalg.norm(xyz(frame) - P, axis=1), 0, atol=0.2)


@pytest.mark.parametrize("method", ["ls", "ls_lines", "ml_kcorr", "vmf_ml"])
def test_beneath_an_anchor(located, method):
    height = ("estimator.vmf_ml.height_m=1",) if method == "vmf_ml" else ()
    frame, _ = located("under_an_anchor", "log.csv", "--estimator", method, *height)
    assert (frame.outcome == "ok").all()
    assert (frame.error_xy_m < 0.1).all()


@pytest.mark.parametrize("method", ["ls", "ml_kcorr", "ls_lines"])
def test_lines_that_cross_behind_the_anchors(located, method):
    frame, _ = located("behind_the_anchors", "log.csv", "--estimator", method)
    assert frame.outcome[0] in ("diverged", "failed")
    assert frame.outcome[1] == "ok"
    np.testing.assert_allclose(frame.loc[1, ["x_m", "y_m"]].astype(float), (1, 5.67), atol=0.01)


def plan(case, *settings):
    folder = LOGS / case
    files = f"scenario.anchors={folder / 'an.csv'}", f"scenario.walls={folder / 'walls.geojson'}"
    noise = "noise=ae_normal", "noise.sigma_deg=3"
    return ("run", "scenario=indoor_map", *files, *noise, "filter=[ekf_aoa]", "reps=2",
            "runner.n_jobs=1", "runner.out=out", "store.steps=true", "scenario.corner_radius_m=0.3",
            *settings)  # fmt: skip


def steps():
    import aoabench

    return aoabench.load("out"), pd.read_parquet("out/steps.parquet")


def test_rooms_as_polygons(call):
    status, _, err = call(*plan("plan_polygons", ROUTE))
    assert status == 0, err
    frame, table = steps()
    assert (frame.n_unmeasured == 0).all()
    assert (table.anchors_used == 4).all()
    status, _, err = call(*plan("plan_polygons", "scenario.route=[[13,1],[23,1],[23,5]]"))
    assert status == 2
    assert one_line(err)


def test_a_plan_in_degrees(call):
    status, _, err = call(*plan("plan_degrees", ROUTE))
    assert status == 2
    assert one_line(err)
    assert "degrees" in err
    status, _, err = call(*plan("plan_degrees", ROUTE, "scenario.walls_crs=wgs84"))
    assert status == 2
    assert one_line(err)
    assert "origin_deg" in err
    origin = "scenario.walls_crs=wgs84", "scenario.origin_deg=[60.0,24.0]"
    status, _, err = call(*plan("plan_degrees", ROUTE, *origin))
    assert status == 0, err
    assert (steps()[1].anchors_used == 4).all()


def test_anchors_on_walls(call):
    status, _, err = call(*plan("anchors_on_walls", ROUTE, "reps=5"))
    assert status == 0, err
    frame, table = steps()
    assert (frame.n_unmeasured == 0).all()
    assert (table.anchors_used == 4).all()
    assert np.sqrt((frame.rmse_3d_m**2).mean()) < 0.3


def test_every_folder_is_used():
    text = Path(__file__).read_text(encoding="utf-8")
    assert all(f'"{folder.name}"' in text for folder in LOGS.iterdir() if folder.is_dir())
    assert json.loads((LOGS / "silabs_config" / "positioning_config.json").read_text())
