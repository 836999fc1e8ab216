"""Recordings of others in the folder AOABENCH_DATA, read as a user reads them; skipped without it.

roh_ired  a mobile sees four landmarks by a rotating infrared detector [Roh 2010]
wsr_wifi  a robot sees up to three Wi-Fi transmitters by a synthetic aperture [Harvard-REACT 2021]

Only what stands in names of files and in JSON is written into tables; `Recorded` converts angles.
"""

import csv
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from aoabench.errors import Unfit
from aoabench.estimators.lines import LineLeastSquares
from aoabench.estimators.robust import RobustLikelihood
from aoabench.roles import Noise
from aoabench.scenarios.recorded import Recorded
from aoabench.types import Batch, Outcome, Reason

DATA = Path(os.environ.get("AOABENCH_DATA", "/nowhere"))
pytestmark = pytest.mark.skipif(
    not (DATA / "roh_ired").is_dir(), reason="AOABENCH_DATA has no recordings"
)
COMMON = {"measured_by": "mobile", "elevation_kind": "none"}


def table(file, head, rows):
    with file.open("w", newline="", encoding="utf-8") as into:
        csv.writer(into).writerows([head, *rows])
    return str(file)


def scenario(folder, anchors, rows, **conventions):
    """The scenario of rows (fix, anchor, azimuth in deg, x, y) and of anchors (id, x, y, z)."""
    log = table(folder / "log.csv", ["fix", "anchor", "azimuth_deg", "x_m", "y_m"], rows)
    site = table(folder / "anchors.csv", ["id", "x_m", "y_m", "z_m"], anchors)
    return Recorded("recording", log, site, **COMMON, **conventions)


def solved(place, estimator):
    """Horizontal errors (T,) m, NaN without a fix, and the estimates."""
    m = place.recorded
    batch = Batch(m.azimuth[None], m.elevation[None], place.true_anchors)
    found = estimator(batch, place, None)
    truth = place.truth(None)
    return np.linalg.norm((found.position[0] - truth)[:, :2], axis=-1), found


def rms(errors):
    return np.sqrt(np.mean(errors**2))


def test_infrared_landmarks(tmp_path):
    """1800 fixes of four bearings: robust_ml has at most 1.15 times the error of the lines."""
    rows, fix = [], 0
    for file in sorted((DATA / "roh_ired").glob("X*.csv")):
        x, y = re.fullmatch(r"X([\d.]+)_Y([\d.]+)", file.stem).groups()
        for bearings in csv.reader(file.open(encoding="utf-8")):
            rows += [[fix, j + 1, one, x, y] for j, one in enumerate(bearings)]
            fix += 1
    landmarks = np.loadtxt(DATA / "roh_ired" / "landmark.csv", delimiter=",")
    anchors = [[j + 1, *row, 0] for j, row in enumerate(landmarks)]
    place = scenario(tmp_path, anchors, rows, frame="own", heading_deg=90.0)
    lines, _ = solved(place, LineLeastSquares())
    assert len(lines) == fix == 1800
    assert lines.mean() == pytest.approx(0.120, abs=0.005)
    assert rms(lines) == pytest.approx(0.141, abs=0.005)
    for engine in ("auto", "numpy"):
        robust, found = solved(place, RobustLikelihood(engine=engine))
        assert np.all(found.outcome == Outcome.OK)
        assert rms(robust) <= 1.15 * rms(lines)


def wifi(folder, name):
    """The scenario of one set with true displacements; the azimuths are in the global frame."""
    file = DATA / "wsr_wifi" / f"{name}_using_groundtruth_displacement.json"
    rows, anchors = [], {}
    for fix, (_, seen) in enumerate(sorted(json.loads(file.read_text()).items())):
        for one in seen:
            sender, robot = one["a_INFO_Transmitting_robot"], one["b_INFO_Receiving_robot"]
            peak = one["d_INFO_AOA_profile"]["Top_N_peaks"]["1"]["estimated_azimuth"]
            at, site = robot["groundtruth_start_position"], sender["groundtruth_position"]
            rows.append([fix, sender["Name"], peak, at["x"], at["y"]])
            anchors[sender["Name"]] = [sender["Name"], site["x"], site["y"], site["z"]]
    return scenario(folder, sorted(anchors.values()), rows, frame="global")


@pytest.mark.parametrize(("name", "median"), [("LOS_Set_A", 0.36), ("LOS_Set_B", 0.42)])
def test_wifi_in_line_of_sight(tmp_path, name, median):
    place = wifi(tmp_path, name)
    lines, _ = solved(place, LineLeastSquares())
    robust, _ = solved(place, RobustLikelihood())
    assert np.median(lines) == pytest.approx(median, abs=0.01)
    assert np.median(robust) <= np.median(lines) + 1e-9


@pytest.mark.parametrize("name", ["NLOS_Set_A", "NLOS_Set_B"])
def test_wifi_without_line_of_sight(tmp_path, name):
    """Three azimuths alone are no redundancy: the rule gives the lines' point."""
    place = wifi(tmp_path, name)
    lines, _ = solved(place, LineLeastSquares())
    robust, _ = solved(place, RobustLikelihood())
    for statistic in (np.median, rms):
        assert statistic(robust) <= 1.05 * statistic(lines)


def test_one_transmitter_at_a_time_is_no_fix(tmp_path):
    place = wifi(tmp_path, "NLOS_Set_C")
    _, found = solved(place, RobustLikelihood())
    assert np.all(found.outcome == Outcome.FAILED)
    assert np.all(found.reason == Reason.TOO_FEW_ANCHORS)
    with pytest.raises(Unfit, match="two or more anchors"):
        RobustLikelihood().check(place, Noise())
