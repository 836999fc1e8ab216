"""`aoabench locate` as a command."""

import io
import signal
import subprocess
import sys
import time
from subprocess import PIPE

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


@pytest.mark.parametrize("method", [["--estimator", "robust_ml"], ["--filter", "ekf_vmf"]])
def test_a_stream_as_a_command(call, here, log, method):  # noqa: F811
    """The rows come while the log goes on, and are those of the file."""
    rows = rows_of(POINTS.repeat(3, axis=0), "T1")
    log(rows, "time_s,tag,anchor,azimuth_deg,elevation_deg")
    words = ["--anchors", "anchors.csv", "scenario.window_s=0.1", *method]
    status, _, err = call("locate", "log.csv", *words, "-o", "file.csv")
    assert status == 0, err
    command = [sys.executable, "-m", "aoabench.cli", "locate", "-", *words]
    with subprocess.Popen(
        command, stdin=PIPE, stdout=PIPE, stderr=PIPE, text=True, bufsize=1
    ) as run:
        lines = (here / "log.csv").read_text().splitlines(keepends=True)
        run.stdin.writelines(lines[:-4])
        run.stdin.flush()
        first = [run.stdout.readline() for _ in range(12)]
        assert run.poll() is None
        run.stdin.writelines(lines[-4:])
        run.stdin.close()
        rest, said = run.stdout.read(), run.stderr.read()
    assert run.returncode == 0, said
    assert said.splitlines()[-1].endswith("12 fixes, 12 with a position (100 %)")
    found = pd.read_csv(io.StringIO("".join(first) + rest))
    pd.testing.assert_frame_equal(found, pd.read_csv("file.csv"), atol=2e-6)


def test_an_interrupted_stream_gives_what_it_has(here, log):  # noqa: F811
    rows = rows_of(POINTS[:1], "T1")
    path = log(rows, "time_s,tag,anchor,azimuth_deg,elevation_deg")
    words = ["locate", "-", "--anchors", "anchors.csv", "scenario.window_s=100", "-o", "out.csv"]
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    code += f"from aoabench.cli.main import main; main({words!r})"
    with subprocess.Popen([sys.executable, "-c", code], stdin=PIPE, stderr=PIPE, text=True) as run:
        run.stdin.write(path.read_text())
        run.stdin.flush()
        while not (here / "out.csv").exists():
            assert run.poll() is None
            time.sleep(0.05)
        time.sleep(1)
        run.send_signal(signal.SIGINT)
        said = run.stderr.read()
    assert run.returncode == 130, said
    assert "Traceback" not in said
    assert len(pd.read_csv("out.csv")) == 1


SENDING = """
import os, signal, sys, time
from aoabench.estimators.robust import RobustLikelihood
usual = RobustLikelihood.__call__
def call(self, *given):
    os.kill(os.getpid(), signal.{name})
    time.sleep(0.05)
    return usual(self, *given)
RobustLikelihood.__call__ = call
signal.signal(signal.SIGINT, signal.default_int_handler)
from aoabench.cli.main import main
main({words!r})
"""


@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_signal_while_fixes_are_computed_loses_none(here, log, name, status):  # noqa: F811
    rows = rows_of(POINTS, "T1")
    path = log(rows, "time_s,tag,anchor,azimuth_deg,elevation_deg")
    words = ["locate", "-", "--anchors", "anchors.csv", "scenario.window_s=0.1", "-o", "out.csv",
             "estimator.robust_ml.engine=numpy"]  # fmt: skip
    command = [sys.executable, "-c", SENDING.format(name=name, words=words)]
    with subprocess.Popen(command, stdin=PIPE, stdout=PIPE, stderr=PIPE, text=True) as run:
        run.stdin.write(path.read_text())
        run.stdin.flush()  # the stream goes on
        run.wait(60)
        said = run.stderr.read()
    assert run.returncode == status, said
    assert said.splitlines()[-1].endswith("4 fixes, 4 with a position (100 %)")
    assert (pd.read_csv("out.csv")["outcome"] == "ok").all()


@pytest.mark.parametrize(("words", "expected"), [
    (["--plan", "walls.geojson"], "--plan=walls.geojson is not allowed with LOG=-"),
    (["--truth", "log.csv"], "--truth=log.csv is not allowed with LOG=-"),
    (["-o", "out.parquet"], "ends in .csv"),
])  # fmt: skip
def test_mistakes_with_a_stream(call, here, words, expected):
    status, out, err = call("locate", "-", "--anchors", "anchors.csv", *words)
    assert (status, out) == (2, "")
    assert expected in err
