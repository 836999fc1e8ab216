"""`aoabench locate` as a command."""

import pandas as pd
import pytest

from tests.deployment.conftest import POINTS, log, room, rows_of  # noqa: F401


@pytest.fixture
def here(room, monkeypatch):  # noqa: F811
    monkeypatch.chdir(room)
    return room


def test_a_log_becomes_a_table_and_a_map(call, here, log):  # noqa: F811
    log(rows_of(POINTS))
    status, out, err = call(
        "locate", "log.csv", "--anchors", "anchors.csv", "--plan", "walls.geojson"
    )
    assert status == 0, err
    assert "robust_ml: 4 fixes, 4 with a position (100 %)" in out
    assert "nan" not in out
    frame = pd.read_csv(here / "log-fixes.csv")
    assert len(frame) == 4
    assert (here / "log-fixes.png").stat().st_size > 10_000
    assert not (here / "log-fixes-errors.png").exists()


def test_truth_adds_the_errors(call, here, log):  # noqa: F811
    rows = [
        f"{row},{x},{y},{z}" for row, (x, y, z) in zip(rows_of(POINTS), POINTS.repeat(4, axis=0))
    ]
    log(rows, "fix,anchor,azimuth_deg,elevation_deg,x_m,y_m,z_m")
    words = ["log.csv", "--anchors", "anchors.csv", "-o", "out.parquet", "--max-sigma", "3"]
    status, out, err = call("locate", *words)
    assert status == 0, err
    assert "P(<= 1 m) 100 %" in out
    assert (here / "out-errors.png").exists()
    assert pd.read_parquet("out.parquet")["error_xy_m"].max() < 1e-3


@pytest.mark.parametrize(("words", "expected"), [
    ([], "LOG is missing"),
    (["log.csv"], "--anchors is missing"),
    (["log.csv", "--anchors", "no.csv"], "scenario.anchors='no.csv'"),
    (["log.csv", "--anchors", "anchors.csv", "--max-sigma", "-1"], "--max-sigma=-1"),
    (["log.csv", "--anchors", "anchors.csv", "-o", "out.xls"], ".csv, .parquet, .geojson"),
    (["log.csv", "--anchors", "anchors.csv", "--plan", "log.csv"], "--plan='log.csv'"),
    (["log.csv", "--anchors", "anchors.csv", "--estimator", "rssi_anchor"], "needs"),
])  # fmt: skip
def test_mistakes(call, here, log, words, expected):  # noqa: F811
    log(rows_of(POINTS))
    status, out, err = call("locate", *words)
    assert (status, out) == (2, "")
    assert expected in err
    assert err.count("\n") == 1
